# SPDX-License-Identifier: Apache-2.0
"""Photographs of one capture that were not exposed alike, or not balanced alike.

A surface point shows every camera about the same radiance, so what differs between photographs of
the same points is the photographs' doing:

    log linear(p, v) = point(p) + gain(v) + highlight or error,

solved by robust least squares. A plane's sheen changes a whole photograph of it as a gain
would, but each orientation by another amount: every orientation has one vote, in which its
dull points count more than its glossy ones. The tone curve is not known by then. Whether gains are
needed is judged under a plain one, as any curve makes the same photographs brighter; how large they
are is solved anew under every curve that is tried.

Gains are taken only where they are larger than gloss feigns them, and explain most of what the
points differ by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.capture.capture import View
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.baked import Transport
from robir.transport.observe import Observations, observe, resize_view
from robir.transport.tracer import AbstractTracer

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

LEAST_STEPS = 0.12
"""Root mean square of the gains, steps, below which photographs count as exposed alike; gloss
of paint and plates feigns up to 0.07."""

LEAST_SHARE = 0.5
"""Share of the points' deviations between photographs that gains must explain. Polished metal alone
can feign gains of 0.5 steps, but those explain no more than 0.3."""

PRIOR_STEPS = 0.5
"""Standard deviation of gains before anything is seen, steps."""

POINTS = 1500
"""Surface points that are compared."""

SIDE = 200
"""Longest side, pixels, that photographs are read at."""

FRONTAL = 0.5
"""Cosine from which a view of a point counts: flatter views show mostly sheen."""

NORMAL_SHARPNESS = 10.0
"""Of the lobe within which normals share one vote, about 25 degrees."""

MATTE = 0.02
"""Deviation between views, log radiance, of which a photograph's noise alone is capable."""

DARKEST, BRIGHTEST = 10, 250
"""Codes between which a curve's slope is worth something in all three channels."""

FEWEST_VIEWS, FEWEST_POINTS = 4, 50
"""Views of a point, and points in all, from which photographs can be compared."""

FIRST_WIDTH, LAST_WIDTH, NARROWING = 0.4, 0.05, 0.7
"""Deviations, log radiance, from which an observation counts little (Geman-McClure): at first, in
the end, and by what this shrinks from round to round."""

ROUNDS = 20


@dataclass(frozen=True, slots=True)
class Gains:
    """How much brighter than at the capture's common exposure each photograph is.

    Attributes:
        by_view: Factors (3,) on linear radiance by the view's name, of geometric mean 1 in every
            channel; empty where all photographs are taken to be alike.
    """

    by_view: Mapping[str, Array]

    def of(self, views: Sequence[str]) -> Tensor:
        """Factors (V, 3) float32 of some views, 1 where nothing is known."""
        rows = [self.by_view.get(view, np.ones(3)) for view in views]
        return torch.from_numpy(np.array(rows, np.float32))

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
        if not self.by_view:
            return linear
        evened = linear / self.of(observations.views)
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
    """

    observations: Observations
    normals: Floats

    def gains(self, curve: AbstractToneCurve) -> Gains:
        """Gains of all views under a tone curve."""
        log, _ = solve_gains(*logarithms(self.observations, curve, self.normals))
        names = self.observations.views
        return Gains({name: np.exp(row) for name, row in zip(names, log, strict=True)})


def find_exposures(
    transport: Transport, tracer: AbstractTracer, views: tuple[View, ...], seed: int
) -> Exposures | None:
    """Look whether photographs were exposed alike, and gather what tells how if not.

    Args:
        transport: Baked transport with the samples' observations.
        tracer: Tracer of the mesh.
        views: All views, the held-out ones included: those need a gain to be compared with.
        seed: Of the choice of points.

    Returns:
        None where the photographs are alike or too little is seen in common.
    """
    surfels, seen = transport.surfels, transport.observations
    usable = np.flatnonzero((seen.weight > FRONTAL).sum(1) >= FEWEST_VIEWS)
    rng = np.random.default_rng(seed)
    chosen = np.sort(rng.choice(usable, min(POINTS, len(usable)), replace=False))
    keep = np.zeros(len(surfels), bool)
    keep[chosen] = True
    points = surfels.subset(keep)
    if not are_uneven(seen.subset(keep), points.normal):
        return None
    small = tuple(resize_view(view, SIDE) for view in views)
    offset = transport.visibility.offset
    observations = observe(tracer, points.position, points.normal, small, offset)
    return Exposures(observations=observations, normals=points.normal)


def are_uneven(observations: Observations, normals: Floats) -> bool:
    """Whether photographs were so unlike that gains explain most of what points differ by.

    Args:
        observations: Surface points.
        normals: (N, 3) of the points.
    """
    log, normals = logarithms(observations, curve_from_name("standard"), normals)
    if len(log) < FEWEST_POINTS:
        return False
    gains, explained = solve_gains(log, normals)
    steps = float(np.sqrt((gains**2).mean()) / np.log(2))
    return steps > LEAST_STEPS and explained > LEAST_SHARE


def logarithms(
    observations: Observations, curve: AbstractToneCurve, normals: Floats
) -> tuple[Array, Floats]:
    """Log radiance (P, V, 3) of the points that enough views show well, NaN where they do not.

    Args:
        observations: N points.
        curve: Tone curve to undo.
        normals: (N, 3) of the points.

    Returns:
        Log radiance, and the normals (P, 3) of the points that are left.
    """
    log = np.log(decoded(observations, curve).numpy().astype(np.float64).clip(1e-4))
    display = observations.display
    poor = (observations.weight < FRONTAL)[..., None] | observations.clipped
    poor = poor | (display < DARKEST) | (display > BRIGHTEST)
    log[poor.any(2)] = np.nan
    kept = np.isfinite(log[..., 0]).sum(1) >= FEWEST_VIEWS
    return log[kept], normals[kept]


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


def solve_gains(log: Array, normals: Floats) -> tuple[Array, float]:
    """Gains of views by the points they share.

    Args:
        log: (P, V, 3) natural logarithms of radiance, NaN where a view does not show a point; every
            point is shown by some view.
        normals: (P, 3) unit.

    Returns:
        Log gains (V, 3) of mean 0 in every channel, and the share of the points' median deviation
        between views that they explain.
    """
    known = np.isfinite(log[..., 0])
    values = np.nan_to_num(log)
    alike = np.exp(NORMAL_SHARPNESS * (normals @ normals.T - 1))
    dull, trust, noise = np.ones(len(log)), known.astype(np.float64), FIRST_WIDTH
    gains = np.zeros(log.shape[1:])
    for step in range(ROUNDS):
        weight = trust * (dull / (alike @ dull))[:, None]
        prior = weight[known].mean() * (noise / (PRIOR_STEPS * np.log(2))) ** 2
        gains, points = _least_squares(values, weight, prior)
        apart = np.abs(values - gains - points[:, None]).mean(2)
        width = max(LAST_WIDTH, FIRST_WIDTH * NARROWING**step)
        trust = known / (1 + (apart / width) ** 2) ** 2
        apart[~known] = np.nan
        dull = 1 / (np.nanmedian(apart, axis=1) ** 2 + MATTE**2)
        noise = 1.48 * float(np.nanmedian(apart))
    before, after = _deviation(log), _deviation(log - gains)
    return gains, 1 - after / max(before, 1e-9)


def _least_squares(values: Array, weight: Array, prior: float) -> tuple[Array, Array]:
    """Gains (V, 3) and points (P, 3) whose sums are nearest to the values.

    The points are eliminated, so that what only chains of photographs connect is solved as well as
    what single photographs do.

    Args:
        values: (P, V, 3) log radiance.
        weight: (P, V), 0 where a view does not show a point.
        prior: Weight with which every gain is drawn to 0.
    """
    mass = weight.sum(1)
    mean = np.einsum("pv,pvc->pc", weight, values) / mass[:, None]
    right = np.einsum("pv,pvc->vc", weight, values - mean[:, None])
    system = np.diag(weight.sum(0)) - weight.T @ (weight / mass[:, None])
    gains = np.linalg.solve(system + prior * np.eye(len(system)), right)
    return gains, mean - weight @ gains / mass[:, None]


def _deviation(log: Array) -> float:
    """Median deviation between views of one point."""
    by_view = np.ascontiguousarray(log.transpose(0, 2, 1))  # sorting the last axis is faster
    middle = np.nanmedian(by_view, axis=2, keepdims=True)
    return float(np.nanmedian(np.abs(by_view - middle)))
