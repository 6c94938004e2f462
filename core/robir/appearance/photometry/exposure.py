# SPDX-License-Identifier: Apache-2.0
"""Photographs of one capture that were not exposed alike, or not balanced alike.

A surface point shows every camera about the same radiance, so what differs between photographs of
the same points is the photographs' doing:

    log linear(p, v) = point(p) + gain(v) + highlight or error,

solved by robust least squares. The tone curve is not known by then. Whether gains are needed is
judged under a plain one, as any curve makes the same photographs brighter; how large they are is
solved anew under every curve that is tried.

Gains are taken only where they are larger than gloss feigns them, and where gains from points of
some orientations let photographs predict points of the others: an exposure changes all alike, while
sheen depends on where a point faces, so that other points alone would prove that of a ground as
well. A falloff towards the corners, common to all photographs, is proven by those it was not solved
by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.photometry.gains import FEWEST_POINTS, are_uneven, orientations, solve_gains
from robir.appearance.photometry.other_light import find_unlike, unlike
from robir.appearance.photometry.vignetting import NO_FALLOFF, Falloff, solve_falloff
from robir.appearance.proof import Proof, fitted_views
from robir.capture.capture import Capture, View
from robir.capture.images.loading import resize_view
from robir.geometry.mesh.tracing import AbstractTracer
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.steps import Step
from robir.transport.baked import Transport
from robir.transport.observe import Observations, observe
from robir.transport.surfels import Surfels

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

POINTS = 1500
"""Surface points that are compared."""

SIDE = 200
"""Longest side, pixels, that photographs are read at."""

FRONTAL = 0.5
"""Cosine from which a view of a point counts: flatter views show mostly sheen."""

DARKEST, BRIGHTEST = 10, 250
"""Codes between which a curve's slope is worth something in all three channels."""

FEWEST_VIEWS = 4
"""Views of a point from which photographs can be compared."""


@dataclass(frozen=True, slots=True)
class Gains:
    """How much brighter than at the capture's common exposure each photograph is, and where.

    Attributes:
        by_view: Factors (3,) on linear radiance by the view's name, of geometric mean 1 in every
            channel; empty where all photographs are taken to be alike.
        falloff: Of all photographs towards their corners.
    """

    by_view: Mapping[str, Array]
    falloff: Falloff = NO_FALLOFF

    def of(self, views: Sequence[str]) -> Tensor:
        """Factors (V, 3) float32 of some views, 1 where nothing is known."""
        rows = [self.by_view.get(view, np.ones(3)) for view in views]
        return torch.from_numpy(np.array(rows, np.float32))

    def dimmed(self, factors: Tensor, off_axis: NDArray[np.uint8]) -> Tensor:
        """Factors (..., 3) of views, where their photographs show something.

        Args:
            factors: As from `of`, of the middle of the photographs.
            off_axis: (...) as in `Observations.off_axis`.
        """
        return factors * self.falloff.factor(off_axis) if self.falloff.strength else factors

    def steps(self) -> dict[str, list[float]]:
        """Steps (log2) per channel by the view's name."""
        return {name: np.log2(gain).tolist() for name, gain in self.by_view.items()}

    def undone(self, linear: Tensor, observations: Observations) -> Tensor:
        """Radiance at the common exposure.

        What is clipped is at least as bright as the brightest that the point shows unclipped: in a
        long exposure its own bound may lie below the truth that a short one shows.

        Args:
            linear: (N, V, 3) radiance as decoded.
            observations: What it was decoded from.

        Returns:
            (N, V, 3); the very same values where all photographs are alike.
        """
        if not self.by_view and not self.falloff.strength:
            return linear
        evened = linear / self.dimmed(self.of(observations.views), observations.off_axis)
        clipped = torch.from_numpy(observations.clipped)
        hidden = clipped | torch.from_numpy(observations.weight <= 0)[..., None]
        brightest = evened.masked_fill(hidden, 0.0).amax(1, keepdim=True)
        return torch.where(clipped, torch.maximum(evened, brightest), evened)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposures:
    """What tells how photographs were exposed, whatever the tone curve.

    Attributes:
        observations: A few surface points in all views, the held-out ones included.
        normals: (N, 3) of the points.
        are_apart: Whether photographs have gains of their own.
        has_falloff: Whether they are darker towards their corners.
    """

    observations: Observations
    normals: Floats
    are_apart: bool
    has_falloff: bool

    def gains(self, curve: AbstractToneCurve) -> Gains:
        """Gains of all views, and their falloff, under a tone curve."""
        log, kept = comparable(self.observations, curve)
        normals, off_axis = self.normals[kept], self.observations.off_axis[kept]
        falloff = NO_FALLOFF
        if self.has_falloff:
            falloff = solve_falloff(log, normals, off_axis)
            log = log - falloff.log(off_axis)[..., None]
        if not self.are_apart:
            return Gains({}, falloff)
        rows = solve_gains(log, normals)
        names = self.observations.views
        by_view = {name: np.exp(row) for name, row in zip(names, rows, strict=True)}
        return Gains(by_view, falloff)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Photographs of the same points, and what these tell about how they were lit and exposed.

    Attributes:
        capture: All views, the held-out ones included: those need a gain to be compared with.
        points: Surface points that are compared.
        observations: Of them in the training views under the common light.
        log: As from `comparable`, under a plain tone curve: the true one is not known yet.
        kept: Which points that is of.
        observed: Reads the points in any views.
        other_light: Names of the photographs taken under another light than most, held-out ones
            included.
        falloff: Of all photographs towards their corners, under a plain tone curve.
        are_apart: Whether photographs have gains of their own.
    """

    capture: Capture
    points: Surfels
    observations: Observations
    log: Array
    kept: NDArray[np.bool_]
    observed: Callable[[Sequence[View]], Observations]
    other_light: frozenset[str] = frozenset()
    falloff: Falloff = NO_FALLOFF
    are_apart: bool = False

    @classmethod
    def of(
        cls, transport: Transport, tracer: AbstractTracer, capture: Capture, seed: int
    ) -> Comparison:
        """Some points that enough views show, as these show them.

        Args:
            transport: Baked transport with the samples' observations.
            tracer: Tracer of the mesh.
            capture: All views.
            seed: Of the choice of points.
        """
        surfels, seen = transport.surfels, transport.observations
        usable = np.flatnonzero((seen.weight > FRONTAL).sum(1) >= FEWEST_VIEWS)
        rng = np.random.default_rng(seed)
        chosen = np.sort(rng.choice(usable, min(POINTS, len(usable)), replace=False))
        keep = np.zeros(len(surfels), bool)
        keep[chosen] = True
        points = surfels.subset(keep)

        def observed(views: Sequence[View]) -> Observations:
            small = tuple(resize_view(view, SIDE) for view in views)
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
    def exposures(self) -> Exposures | None:
        """What tells how photographs were exposed; None where they were exposed alike."""
        if not self.are_apart and not self.falloff.strength:
            return None
        return Exposures(
            observations=self.observed(self.capture.without(self.other_light).views),
            normals=self.points.normal,
            are_apart=self.are_apart,
            has_falloff=self.falloff.strength > 0,
        )

    @property
    def tells(self) -> bool:
        """Whether enough is seen in common to tell anything."""
        return len(self.log) >= FEWEST_POINTS

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


def _leave_out_other_light(state: Comparison) -> Comparison:
    if not state.tells:
        return state
    few = state.observations
    odd, common = find_unlike(state.log, solve_gains(state.log, state.normals))
    other = {few.views[index] for index in np.flatnonzero(odd)}
    if not other:
        return state
    if aside := state.capture.held_out:
        apart = log_radiance(state.observed(aside), _plain())[state.kept]
        other |= {aside[index].name for index in np.flatnonzero(unlike(apart, common))}
    few = few.of_views(~odd)
    log, kept = comparable(few, _plain())
    return replace(state, other_light=frozenset(other), observations=few, log=log, kept=kept)


def _find_falloff(state: Comparison) -> Comparison:
    if not state.tells:
        return state
    return replace(state, falloff=find_falloff(state.log, state.normals, state.off_axis))


def _find_gains(state: Comparison) -> Comparison:
    if not state.tells:
        return state
    dimming = state.falloff.log(state.off_axis)[..., None]
    return replace(state, are_apart=are_uneven(state.log - dimming, state.normals))


COMPARISON: tuple[Step[Comparison], ...] = (
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
        purpose="finds whether photographs were exposed or balanced apart",
        source="log-linear gains by robust least squares, proven by points of other orientations",
        run=_find_gains,
    ),
)
"""What is asked of photographs of the same points, in this order."""


def find_falloff(log: Array, normals: Floats, off_axis: NDArray[np.uint8]) -> Falloff:
    """The falloff under a plain tone curve, of strength 0 where photographs do not prove it.

    Solved by the fitted views, it must let the points that these show predict the kept ones better,
    each of those at its own exposure, and not by points of a few orientations alone.

    Args:
        log: (P, V, 3) log radiance from `comparable`.
        normals: (P, 3) of the points.
        off_axis: (P, V) as in `Observations.off_axis`.
    """
    is_fitted = fitted_views(log.shape[1])
    enough = np.isfinite(log[:, is_fitted, 0]).sum(1) >= FEWEST_VIEWS
    if enough.sum() < FEWEST_POINTS:
        return NO_FALLOFF
    log, normals, off_axis = log[enough], normals[enough], off_axis[enough]
    falloff = solve_falloff(log[:, is_fitted], normals, off_axis[:, is_fitted])
    if falloff.strength <= 0:
        return NO_FALLOFF
    point, view = np.nonzero(np.isfinite(log[:, ~is_fitted, 0]))
    # sheen at grazing angles, which is where the edges of photographs look, errs by orientation
    orientation = orientations(normals)
    plain, rich = (
        _kept_errors(log, normals, model.log(off_axis), is_fitted)
        for model in (NO_FALLOFF, falloff)
    )
    is_proven = Proof.of(plain, rich, (view, orientation[point])).is_given
    return solve_falloff(log, normals, off_axis) if is_proven else NO_FALLOFF


def _kept_errors(
    log: Array, normals: Floats, dimming: Array, is_fitted: NDArray[np.bool_]
) -> Array:
    """Squared display errors (M,) of what kept views show, predicted by the fitted ones.

    Args:
        log: (P, V, 3) log radiance, NaN where a view does not show a point.
        normals: (P, 3) of the points.
        dimming: (P, V) log radiance against the middle of a photograph.
        is_fitted: (V,).
    """
    evened = log - dimming[..., None]
    gains = solve_gains(evened[:, is_fitted], normals)
    points = np.nanmean(evened[:, is_fitted] - gains, axis=1)
    apart = evened[:, ~is_fitted] - points[:, None]
    apart -= np.nanmedian(apart, axis=0)
    shown = log[:, ~is_fitted]
    known = np.isfinite(shown[..., 0])
    curve = curve_from_name("standard")
    seen, predicted = (
        curve.display_from_linear(torch.from_numpy(np.exp(values[known])))
        for values in (shown, shown - apart)
    )
    return ((seen - predicted) ** 2).mean(1).numpy()


def comparable(
    observations: Observations, curve: AbstractToneCurve
) -> tuple[Array, NDArray[np.bool_]]:
    """Log radiance (P, V, 3) of the points that enough views show well, NaN where they do not.

    Args:
        observations: N points.
        curve: Tone curve to undo.

    Returns:
        Log radiance, and which (N,) points are left.
    """
    log = log_radiance(observations, curve)
    kept = np.isfinite(log[..., 0]).sum(1) >= FEWEST_VIEWS
    return log[kept], kept


def log_radiance(observations: Observations, curve: AbstractToneCurve) -> Array:
    """Log radiance (N, V, 3) under a tone curve, NaN where a view does not show a point well."""
    log = np.log(decoded(observations, curve).numpy().astype(np.float64).clip(1e-4))
    display = observations.display
    poor = (observations.weight < FRONTAL)[..., None] | observations.clipped
    poor = poor | (display < DARKEST) | (display > BRIGHTEST)
    log[poor.any(2)] = np.nan
    return log


def decoded(observations: Observations, curve: AbstractToneCurve) -> Tensor:
    """Radiance (N, V, 3) float32, linear Rec.709, of every observation as it was exposed.

    Anything where a view does not show a point.
    """
    display = observations.display
    if not curve.mixes_channels:
        codes = (torch.arange(256) / 255)[:, None].expand(-1, 3)
        table = curve.linear_from_display(codes).float().numpy()
        return torch.from_numpy(table[display, np.arange(3)])
    seen = observations.weight > 0
    linear = torch.zeros(display.shape)
    known = torch.from_numpy(display[seen].astype(np.float32) / 255)
    linear[torch.from_numpy(seen)] = curve.linear_from_display(known).float()
    return linear
