# SPDX-License-Identifier: Apache-2.0
"""How photographs of the same points were exposed and lit, under a plain tone curve.

Gains count by how far points of some orientations give the same as points of the others: an
exposure changes all alike, highlights do not. A falloff towards the corners is tested on held-out
photographs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.held_out_test import HeldOutTest, fitted_views
from robir.appearance.photometry.exposure import (
    LEAST_COSINE,
    LEAST_VIEWS,
    NO_FALLOFF,
    ExposureModel,
    Falloff,
    comparable,
    log_radiance,
    solve_falloff,
)
from robir.appearance.photometry.gains import LEAST_POINTS, orientations, real_share, solve_gains
from robir.appearance.photometry.own_light import have_own_lights
from robir.capture.capture import Capture, View
from robir.capture.images.loading import resize_views
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.steps import Step
from robir.transport.baked import Transport
from robir.transport.observe import Observations, observe
from robir.transport.surfels import Surfels

Array = NDArray[np.float64]

# stops by which a photograph must be brighter or darker than the rest: more than highlights make it
LEAST_STOPS = 0.5
# how much of that its points must differ among each other: more than in one exposed otherwise
LEAST_SPREAD = 0.3
# median difference beyond which the rest do not agree themselves: metal, of which all photographs
# differ, comes to 0.35, and so does a light that moves with the camera (log radiance)
_MOST_COMMON_SPREAD = 0.25
_MOST_VIEWS = 0.25  # share of photographs beyond which there is no common light to differ from
_LEAST_POINTS = 20  # points that a photograph must show to be judged


def unlike(log: Array, points: Array) -> NDArray[np.bool_]:
    """Photographs (V,) that show points much brighter or darker, not by one factor.

    So it is where a lamp was covered; such photographs say nothing about the light of the rest. Of
    log radiance (P, V, 3), NaN where not shown, and of the points (P, 3) under the common light.
    """
    return _is_unlike(*_compared(log, points, _LEAST_POINTS))


def find_unlike(log: Array, gains: Array) -> tuple[NDArray[np.bool_], Array]:
    """Photographs (V,) under another light than most, and the points' log radiance (P, 3).

    None where the rest do not agree or are too few. `gains` (V, 3) are from `gains.solve_gains`.
    """
    points = np.nanmedian(log - gains, axis=1) + np.median(gains, axis=0)
    gain, left = _compared(log, points, _LEAST_POINTS)
    odd = _is_unlike(gain, left)
    if odd.mean() > _MOST_VIEWS or not np.nanmedian(left[~odd]) < _MOST_COMMON_SPREAD:
        odd = np.zeros_like(odd)
    return odd, points


def _is_unlike(gain: Array, left: Array) -> NDArray[np.bool_]:
    """Which photographs (V,) are much brighter or darker, and not by one factor."""
    is_far = np.abs(gain) > LEAST_STOPS * np.log(2)
    return is_far & (left > LEAST_SPREAD * np.abs(gain))


def _compared(log: Array, points: Array, least: int) -> tuple[Array, Array]:
    """How much brighter photographs are (V,) and how much their points differ in that (V,)."""
    apart = (log - points[:, None]).mean(2)
    apart[:, np.isfinite(apart).sum(0) < least] = 0.0
    gain = np.nanmedian(apart, axis=0)
    return gain, np.nanmedian(np.abs(apart - gain), axis=0)


Floats = NDArray[np.float32]

_NUM_POINTS = 1500  # surface points that are compared
_IMAGE_SIDE = 200  # longest side that photographs are read at (pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoComparison:
    """Photographs of the same points, and how these were lit and exposed."""

    capture: Capture  # all views, the held-out ones included: those need a gain to be compared with
    points: Surfels  # surface points that are compared
    observations: Observations  # of them in the training views under the common light
    log: Array  # as from `comparable`, under a plain tone curve: the true one is not known yet
    kept: NDArray[np.bool_]  # which points that is of
    observed: Callable[[Sequence[View]], Observations]  # reads the points in any views
    # names of the photographs taken under another light than most, held-out ones included
    other_light: frozenset[str] = frozenset()
    # of all photographs towards their corners, under a plain tone curve
    falloff: Falloff = NO_FALLOFF
    gain_share: float = 0.0  # how much of the gains between photographs is exposure, 0..1
    # whether each is in a light of its own, its gain being part of that
    has_own_lights: bool = False

    @classmethod
    def of(
        cls, transport: Transport, tracer: EmbreeTracer, capture: Capture, seed: int
    ) -> PhotoComparison:
        """Some points, drawn by `seed`, as enough views show them."""
        surfels, seen = transport.surfels, transport.observations
        is_frontal = seen.weight > LEAST_COSINE
        usable = np.flatnonzero(is_frontal.sum(1) >= LEAST_VIEWS)
        count = min(_NUM_POINTS, len(usable))
        rng = np.random.default_rng(seed)
        chosen = np.sort(rng.choice(usable, count, replace=False))
        keep = np.zeros(len(surfels), bool)
        keep[chosen] = True
        points = surfels.subset(keep)

        def observed(views: Sequence[View]) -> Observations:
            small = resize_views(views, _IMAGE_SIDE)
            offset = transport.visibility.offset
            return observe(tracer, points.position, points.normal, small, offset)

        few = seen.subset(keep)
        log, kept = comparable(few, _plain())
        return cls(
            capture=capture,
            points=points,
            observations=few,
            log=log,
            kept=kept,
            observed=observed,
        )

    @property
    def exposures(self) -> ExposureModel | None:
        """What tells how photographs were exposed; None where they were exposed alike."""
        if not (self.gain_share or self.has_own_lights or self.falloff.strength):
            return None
        return ExposureModel(
            observations=self.observed(self.capture.without(self.other_light).views),
            normals=self.points.normal,
            gain_share=1.0 if self.has_own_lights else self.gain_share,
            has_falloff=self.falloff.strength > 0,
            has_own_lights=self.has_own_lights,
        )

    @property
    def tells(self) -> bool:
        """Whether enough is seen in common to tell anything."""
        return len(self.log) >= LEAST_POINTS

    @property
    def normals(self) -> Floats:
        """(N, 3) of the points that are kept."""
        return self.points.normal[self.kept]

    @property
    def off_axis(self) -> NDArray[np.uint8]:
        """(N, V) of the points that are kept, as in `Observations.off_axis`."""
        return self.observations.off_axis[self.kept]


def _plain() -> AbstractToneCurve:
    return curve_from_name("standard")


def _leave_out_other_light(state: PhotoComparison) -> PhotoComparison:
    if not state.tells:
        return state
    few = state.observations
    gains = solve_gains(state.log, state.normals)
    odd, common = find_unlike(state.log, gains)
    other = {few.views[index] for index in np.flatnonzero(odd)}
    if not other:
        return state
    if aside := state.capture.held_out:
        apart = log_radiance(state.observed(aside), _plain())[state.kept]
        is_odd = unlike(apart, common)
        other |= {aside[index].name for index in np.flatnonzero(is_odd)}
    few = few.of_views(~odd)
    log, kept = comparable(few, _plain())
    return replace(state, other_light=frozenset(other), observations=few, log=log, kept=kept)


def _find_falloff(state: PhotoComparison) -> PhotoComparison:
    if not state.tells:
        return state
    falloff = find_falloff(state.log, state.normals, state.off_axis)
    return replace(state, falloff=falloff)


def _find_gains(state: PhotoComparison) -> PhotoComparison:
    if not state.tells:
        return state
    dimming = state.falloff.log(state.off_axis)[..., None]
    share = real_share(state.log - dimming, state.normals)
    return replace(state, gain_share=share) if share else state


def _find_own_lights(state: PhotoComparison) -> PhotoComparison:
    if not state.tells:
        return state
    log = state.log - state.falloff.log(state.off_axis)[..., None]
    places = state.points.position[state.kept], state.observations.positions
    has_own_lights = have_own_lights(log, state.normals, places)
    return replace(state, has_own_lights=has_own_lights)


# what is asked of photographs of the same points, in this order
COMPARISON: tuple[Step[PhotoComparison], ...] = (
    Step(
        name="other-light",
        purpose="leaves out photographs taken under another light than most",
        source="ours: outliers that no gain explains",
        run=_leave_out_other_light,
    ),
    Step(
        name="vignetting",
        purpose="finds how much darker the corners of all photographs are",
        source="cos^4 law to first order, proven by photographs that had no part",
        run=_find_falloff,
    ),
    Step(
        name="exposure",
        purpose="finds how much of what photographs differ by is exposure and white balance",
        source="log-linear gains by robust least squares, shrunk by what two halves of the points "
        "tell apart (James and Stein 1961)",
        run=_find_gains,
    ),
    Step(
        name="own-light",
        purpose="finds whether each photograph was taken in a light of its own",
        source="first-order irradiance, proven by points of other places",
        run=_find_own_lights,
    ),
)


def find_falloff(log: Array, normals: Floats, off_axis: NDArray[np.uint8]) -> Falloff:
    """The falloff under a plain tone curve, of strength 0 where it fails the held-out test.

    It must let points predict held-out views better, each at its own exposure, over views and over
    orientations. Of log radiance (P, V, 3), normals (P, 3), and `Observations.off_axis` (P, V).
    """
    is_fitted = fitted_views(log.shape[1])
    enough = np.isfinite(log[:, is_fitted, 0]).sum(1) >= LEAST_VIEWS
    if enough.sum() < LEAST_POINTS:
        return NO_FALLOFF
    log, normals, off_axis = log[enough], normals[enough], off_axis[enough]
    falloff = solve_falloff(log[:, is_fitted], normals, off_axis[:, is_fitted])
    if falloff.strength <= 0:
        return NO_FALLOFF
    point, view = np.nonzero(np.isfinite(log[:, ~is_fitted, 0]))
    # specular reflection at grazing angles, which is where the edges of photographs look, errs by
    # orientation
    orientation = orientations(normals)
    plain, rich = (
        _kept_errors(log, normals, model.log(off_axis), is_fitted)
        for model in (NO_FALLOFF, falloff)
    )
    is_passed = HeldOutTest.of(plain, rich, (view, orientation[point])).is_passed
    return solve_falloff(log, normals, off_axis) if is_passed else NO_FALLOFF


def _kept_errors(
    log: Array, normals: Floats, dimming: Array, is_fitted: NDArray[np.bool_]
) -> Array:
    """Squared display errors (M,) of held-out views by the fitted (V,); `dimming` is log (P, V)."""
    equalised = log - dimming[..., None]
    gains = solve_gains(equalised[:, is_fitted], normals)
    points = np.nanmean(equalised[:, is_fitted] - gains, axis=1)
    apart = equalised[:, ~is_fitted] - points[:, None]
    apart -= np.nanmedian(apart, axis=0)
    shown = log[:, ~is_fitted]
    known = np.isfinite(shown[..., 0])
    curve = curve_from_name("standard")
    seen, predicted = (
        curve.display_from_linear(torch.from_numpy(np.exp(values[known])))
        for values in (shown, shown - apart)
    )
    return ((seen - predicted) ** 2).mean(1).numpy()
