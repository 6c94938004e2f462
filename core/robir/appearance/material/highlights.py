# SPDX-License-Identifier: Apache-2.0
"""What highlights say of the roughness of each patch of dielectric, and patches of each other.

Views near a sun's mirror direction are exact where the mesh is right. Where it is a few degrees
off, a narrow highlight is predicted beside the true one, but as bright. So the brightest views of a
patch are also compared with the brightest predicted, wherever they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]

LEVELS = (0.12, 0.2, 0.3, 0.42, 0.56, 0.72, 0.9)  # roughnesses that are tried, rising
_ROUGH_SHARE = 0.66  # share of the highlight at the last of these that is left at roughness 1
# how many of them have a highlight so narrow that an error of the mesh may put it anywhere
_NARROW = 4
_LEAST_ROUGHNESS = 0.1  # that paint may have
# roughnesses are whole multiples of this: finer differences are below the errors of the readings,
# and every one of them has its own pass over its samples
STEP = 0.02
_FEWEST_VIEWS = 30  # near a sun's mirror direction, that a patch must have to be read
# views at which what they say counts half: neighbouring samples and views err alike
_HALF_BELIEVED = 300
# power of an error ratio that is its likelihood: as if so many views erred each in its own way,
# however many there are
_STEEPNESS = 12.0
# deviation of the log of a peak that is seen from the one predicted at the true roughness
_PEAK_ERROR = 0.25
_UNSEEN_CODES = 0.3  # errors, codes, below which their ratios mean nothing
_PEAK_CODES = 1.0  # the same of the heights of peaks (codes)
# brightest views of a patch, as a share: all but few are beside a narrow highlight
_TOP_SHARE = 0.03
# samples of a patch, as a share, that speak for it. The others' views err most where no highlight
# is: the mesh has an outline or a shadow in the wrong place there.
_STEADY_SHARE = 0.8
UNKNOWN = 0.5  # roughness given to what the views say nothing about
_READING_ERROR = 0.05  # error of the best of readings
_SPREAD = 0.3  # how far paints differ in roughness, within one scene and from scene to scene
# distance of patches, in log albedo and place in the unit frame, over which they tell of each other
_ALIKE = 1.0


def grid_of() -> Reals:
    """Roughnesses (G,) whose likelihood is estimated: all that a dielectric may have."""
    return np.linspace(_LEAST_ROUGHNESS, 1.0, round((1.0 - _LEAST_ROUGHNESS) / STEP) + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Highlights:
    """Samples in the views near a sun's mirror direction, N of them, and in the M others."""

    error: Floats  # (U, L) display error, summed over the near views, at every level
    plain: Floats  # (U,) the same without any highlight
    count: Floats  # (U,) number of near views
    sample: Rows  # (N,) sample of each near view
    seen: Floats  # (N, L) what it shows beyond the light that is no sun's highlight, display, 0..1
    predicted: Floats  # (N, L) the sun's highlight in it
    other: Rows  # (M,) sample of each other view
    noise: Floats  # (M, L) what these show beyond what is predicted

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
    """Roughness of those patches whose highlights say something."""

    patch: Rows  # (R,) their numbers
    roughness: Reals  # (R,)
    variance: Reals  # (R,) of the error of each

    def weighted_mean(self, unknown: float) -> float:
        """The one roughness that fits all readings best; `UNKNOWN` where there is none."""
        weight = 1 / self.variance
        return float(weight @ self.roughness / weight.sum()) if len(weight) else unknown


def read(highlights: Highlights, patch: Rows, num_patches: int) -> Readings:
    """Roughness of every patch (U,), below `num_patches`, by its own highlights alone.

    The prior is taken out again, so that patches that say little weigh little.
    """
    steady, grid = _steady(highlights, patch, _STEADY_SHARE), grid_of()
    highlights, patch = highlights.of(steady), patch[steady]
    count = np.bincount(patch, highlights.count, num_patches)
    known = np.flatnonzero(count >= _FEWEST_VIEWS)
    fit = fit_of(*_costs(highlights, patch, known, count, _NARROW))
    peaks = -0.5 * (_peak_ratios(highlights, patch, known) / _PEAK_ERROR) ** 2
    believed = count[known] / (count[known] + _HALF_BELIEVED)
    log = (fit + _on_grid(peaks)) * believed[:, None]
    likelihood = np.exp(log - log.max(1, keepdims=True))
    likelihood /= likelihood.sum(1, keepdims=True)
    mean = likelihood @ grid
    variance = (likelihood * (grid - mean[:, None]) ** 2).sum(1)
    anyhow = float(grid.var())
    precision = 1 / variance - 1 / anyhow
    says = precision > 0.5
    mean, variance, precision = mean[says], variance[says], precision[says]
    own = (mean / variance - grid.mean() / anyhow) / precision
    variance = 1 / precision + _READING_ERROR**2
    return Readings(known[says], own.clip(grid[0], grid[-1]), variance)


def _steady(highlights: Highlights, patch: Rows, share: float) -> NDArray[np.bool_]:
    """Samples (U,) bool, `share` of each patch: those whose views off highlights err least."""
    size = len(patch)
    total = np.bincount(highlights.other, np.abs(highlights.noise).mean(1), size)
    error = total / np.bincount(highlights.other, minlength=size).clip(1)
    order = np.lexsort((error, patch))
    members = np.bincount(patch)
    rank = np.empty(size, np.int64)
    rank[order] = np.arange(size) - (np.cumsum(members) - members)[patch[order]]
    return rank < np.ceil(share * members)[patch]


def fit_of(codes: Reals, plain: Reals) -> Reals:
    """Log likelihood (R, G) of roughnesses, by codes (R, L) of error and (R,) without highlight."""
    left = 1 - _ROUGH_SHARE
    rough = codes[:, -1] + left * np.maximum(plain - codes[:, -1], 0)
    likelihood = -_STEEPNESS * np.log(np.c_[codes, rough] + _UNSEEN_CODES)
    return _on_grid(likelihood)


def _on_grid(values: Reals) -> Reals:
    """Values (R, G) between those (R, L + 1) at every level and at roughness 1."""
    levels, grid = [*LEVELS, 1.0], grid_of()
    return np.array([np.interp(grid, levels, row) for row in values]).reshape(-1, len(grid))


def _costs(
    highlights: Highlights, patch: Rows, known: Rows, count: NDArray[Any], narrow: int
) -> tuple[Reals, Reals]:
    """Codes (R, L) that a near view differs by at every level, and (R,) without any highlight."""
    # a narrow highlight in the wrong place costs no more than none: it speaks against the place
    columns = [*highlights.error.T, highlights.plain]
    sums = np.array([np.bincount(patch, column, len(count))[known] for column in columns])
    *errors, plain = 255 * sums / count[known]
    levels = [np.minimum(each, plain) if i < narrow else each for i, each in enumerate(errors)]
    return np.array(levels).T, plain


def _peak_ratios(highlights: Highlights, patch: Rows, known: Rows) -> Reals:
    """Log (R, L + 1) of the brightest near views over the brightest predicted."""
    # errors of mesh and albedo brighten views as well; by how much is seen in the other views
    near, far = patch[highlights.sample], patch[highlights.other]
    result = np.zeros((len(known), len(LEVELS) + 1))
    for row, index in enumerate(known):
        seen = _brightest(highlights.seen[near == index], _TOP_SHARE)
        predicted = _brightest(highlights.predicted[near == index], _TOP_SHARE)
        noise = _brightest(highlights.noise[far == index], _TOP_SHARE)
        shown = np.append(predicted, _ROUGH_SHARE * predicted[-1])
        expected = np.hypot(shown, np.append(noise, noise[-1]))
        height = np.append(seen, seen[-1]).clip(0)
        result[row] = np.log((height + _PEAK_CODES) / (expected + _PEAK_CODES))
    return result


def _brightest(values: Floats, share: float) -> Reals:
    """Mean codes (L,) of the brightest share of views (N, L); 0 where there are none."""
    if not len(values):
        return np.zeros(values.shape[1])
    top = max(2, int(np.ceil(share * len(values))))
    return 255 * np.partition(values, max(0, len(values) - top), axis=0)[-top:].mean(0)


def pooled(readings: Readings, features: Reals) -> Reals:
    """Roughness (K,) of all patches, from readings of them and of those like them (kriging).

    `features` (K, D) are log albedo and place; far from all readings it is the mean.
    """
    grid = grid_of()
    apart = ((features[:, None] - features[None]) ** 2).sum(2)
    prior = _SPREAD**2 * (np.exp(-0.5 * apart / _ALIKE**2) + 1)
    rows = readings.patch
    seen = prior[np.ix_(rows, rows)] + np.diag(readings.variance)
    weight = np.linalg.solve(seen, readings.roughness - UNKNOWN)
    return (UNKNOWN + prior[:, rows] @ weight).clip(grid[0], grid[-1])
