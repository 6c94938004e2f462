# SPDX-License-Identifier: Apache-2.0
"""What highlights say of the roughness of each patch of paint, and what patches say of each other.

Two things are read. How well a roughness predicts the views near a sun's mirror direction is exact
where the mesh is right. Where it is a few degrees off, a narrow highlight is predicted beside the
true one and counts twice, as if there were none; but it is as bright there as it would be here. So
the brightest views of a patch are compared with the brightest predicted, wherever they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.appearance.material.config import HighlightsConfig

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]


def grid_of(config: HighlightsConfig) -> Reals:
    """Roughnesses (G,) whose likelihood is told: every one that paint may have."""
    least = config.least_roughness
    return np.linspace(least, 1.0, round((1.0 - least) / config.step) + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Highlights:
    """Samples in the views near a sun's mirror direction, N of them, and in the M others.

    Attributes:
        error: (U, L) display error, summed over the near views, at every level.
        plain: (U,) the same without any highlight.
        count: (U,) number of near views.
        sample: (N,) sample of each near view.
        seen: (N, L) what it shows beyond the light that is no sun's highlight, display, 0..1; that
            light depends on the level.
        predicted: (N, L) the sun's highlight in it.
        other: (M,) sample of each other view.
        noise: (M, L) what these show beyond what is predicted.
    """

    error: Floats
    plain: Floats
    count: Floats
    sample: Rows
    seen: Floats
    predicted: Floats
    other: Rows
    noise: Floats

    def of(self, chosen: NDArray[np.bool_]) -> Highlights:
        """Some of the samples, numbered anew."""
        number = np.cumsum(chosen) - 1
        near, far = chosen[self.sample], chosen[self.other]
        return Highlights(
            error=self.error[chosen],
            plain=self.plain[chosen],
            count=self.count[chosen],
            sample=number[self.sample[near]],
            seen=self.seen[near],
            predicted=self.predicted[near],
            other=number[self.other[far]],
            noise=self.noise[far],
        )


@dataclass(frozen=True, slots=True)
class Readings:
    """Roughness of those of the patches whose highlights say something.

    Attributes:
        patch: (R,) their numbers.
        roughness: (R,).
        variance: (R,) of the error of each.
    """

    patch: Rows
    roughness: Reals
    variance: Reals

    def weighted_mean(self, unknown: float) -> float:
        """The one roughness that fits all readings best; `unknown` where there is none."""
        weight = 1 / self.variance
        return float(weight @ self.roughness / weight.sum()) if len(weight) else unknown


def read(
    highlights: Highlights, patch: Rows, num_patches: int, config: HighlightsConfig
) -> Readings:
    """Roughness of every patch by its own highlights alone.

    Args:
        highlights: Of U samples.
        patch: (U,) of each, below `num_patches`.
        num_patches: K.
        config: What highlights say.

    Returns:
        What is left of each once the roughness that is likely anyhow is taken out, so that patches
        that say little weigh little.
    """
    steady, grid = _steady(highlights, patch, config.steady_share), grid_of(config)
    highlights, patch = highlights.of(steady), patch[steady]
    count = np.bincount(patch, highlights.count, num_patches)
    known = np.flatnonzero(count >= config.fewest_views)
    fit = fit_of(*_costs(highlights, patch, known, count, config.narrow), config)
    peaks = -0.5 * (_peak_ratios(highlights, patch, known, config) / config.peak_error) ** 2
    believed = count[known] / (count[known] + config.half_believed)
    log = (fit + _on_grid(peaks, config)) * believed[:, None]
    likely = np.exp(log - log.max(1, keepdims=True))
    likely /= likely.sum(1, keepdims=True)
    mean = likely @ grid
    variance = (likely * (grid - mean[:, None]) ** 2).sum(1)
    anyhow = float(grid.var())
    precision = 1 / variance - 1 / anyhow
    says = precision > 0.5
    mean, variance, precision = mean[says], variance[says], precision[says]
    own = (mean / variance - grid.mean() / anyhow) / precision
    variance = 1 / precision + config.reading_error**2
    return Readings(known[says], own.clip(grid[0], grid[-1]), variance)


def _steady(highlights: Highlights, patch: Rows, share: float) -> NDArray[np.bool_]:
    """Those (U,) of the samples whose views away from highlights err less than others' on a patch.

    Args:
        highlights: Of U samples.
        patch: (U,) of each.
        share: Of the samples of each patch that are taken.
    """
    size = len(patch)
    total = np.bincount(highlights.other, np.abs(highlights.noise).mean(1), size)
    error = total / np.bincount(highlights.other, minlength=size).clip(1)
    order = np.lexsort((error, patch))
    members = np.bincount(patch)
    rank = np.empty(size, np.int64)
    rank[order] = np.arange(size) - (np.cumsum(members) - members)[patch[order]]
    return rank < np.ceil(share * members)[patch]


def fit_of(codes: Reals, plain: Reals, config: HighlightsConfig) -> Reals:
    """Log likelihood (R, G) of roughnesses.

    Args:
        codes: (R, L) that a near view differs by at every level.
        plain: (R,) without any highlight.
        config: What errors say.
    """
    left = 1 - config.rough_share
    rough = codes[:, -1] + left * np.maximum(plain - codes[:, -1], 0)
    likely = -config.steepness * np.log(np.c_[codes, rough] + config.unseen_codes)
    return _on_grid(likely, config)


def _on_grid(values: Reals, config: HighlightsConfig) -> Reals:
    """Values (R, G) between those (R, L + 1) at every level and at roughness 1."""
    levels, grid = [*config.levels, 1.0], grid_of(config)
    return np.array([np.interp(grid, levels, row) for row in values]).reshape(-1, len(grid))


def _costs(
    highlights: Highlights, patch: Rows, known: Rows, count: NDArray[Any], narrow: int
) -> tuple[Reals, Reals]:
    """Codes (R, L) that a near view differs by at every level, and (R,) without any highlight.

    A narrow highlight in the wrong place is worse than none. That speaks against the place, so at
    the `narrow` first levels it costs no more than none would.
    """
    columns = [*highlights.error.T, highlights.plain]
    sums = np.array([np.bincount(patch, column, len(count))[known] for column in columns])
    *errors, plain = 255 * sums / count[known]
    levels = [np.minimum(each, plain) if i < narrow else each for i, each in enumerate(errors)]
    return np.array(levels).T, plain


def _peak_ratios(
    highlights: Highlights, patch: Rows, known: Rows, config: HighlightsConfig
) -> Reals:
    """Log (R, L + 1) of the brightest near views over the brightest that are predicted.

    Errors of mesh and albedo brighten some views as well; the other views tell by how much.
    """
    near, far = patch[highlights.sample], patch[highlights.other]
    share, codes = config.top_share, config.peak_codes
    result = np.zeros((len(known), len(config.levels) + 1))
    for row, index in enumerate(known):
        seen = _brightest(highlights.seen[near == index], share)
        predicted = _brightest(highlights.predicted[near == index], share)
        noise = _brightest(highlights.noise[far == index], share)
        shown = np.append(predicted, config.rough_share * predicted[-1])
        expected = np.hypot(shown, np.append(noise, noise[-1]))
        height = np.append(seen, seen[-1]).clip(0)
        result[row] = np.log((height + codes) / (expected + codes))
    return result


def _brightest(values: Floats, share: float) -> Reals:
    """Mean codes (L,) of the brightest share of views (N, L); 0 where there are none."""
    if not len(values):
        return np.zeros(values.shape[1])
    top = max(2, int(np.ceil(share * len(values))))
    return 255 * np.partition(values, max(0, len(values) - top), axis=0)[-top:].mean(0)


def pooled(readings: Readings, features: Reals, config: HighlightsConfig) -> Reals:
    """Roughness (K,) of all patches, each from its own reading and those of patches like it.

    Kriging: patches alike in albedo and place are expected to be alike in roughness. What has no
    reading goes by what is like it, and where nothing is by the mean of the scene.

    Args:
        readings: Of some of the patches.
        features: (K, D) log albedo and place of all.
        config: How alike patches are.
    """
    unknown, grid = config.unknown, grid_of(config)
    apart = ((features[:, None] - features[None]) ** 2).sum(2)
    prior = config.spread**2 * (np.exp(-0.5 * apart / config.alike**2) + 1)
    rows = readings.patch
    seen = prior[np.ix_(rows, rows)] + np.diag(readings.variance)
    weight = np.linalg.solve(seen, readings.roughness - unknown)
    return (unknown + prior[:, rows] @ weight).clip(grid[0], grid[-1])
