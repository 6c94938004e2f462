# SPDX-License-Identifier: Apache-2.0
"""Colours of object and background as smoothed histograms.

The object has the same colours in all photographs, so all of them share its histogram; what lies
behind it changes, so that every photograph has a background of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robir.capture.masks.sight import Layer, Picture

BINS = (20, 28, 28)  # steps of L*, a* and b*
LOWEST = np.array([0.0, -70.0, -70.0], dtype=np.float32)
HIGHEST = np.array([100.0, 70.0, 70.0], dtype=np.float32)

SMOOTH = 0.8  # width of the smoothing, steps
FLOOR = 2e-5  # likelihood of a colour never seen
SURE = 4.0  # greatest evidence of one pixel's colour, natural logarithm of a ratio
SHARED = 0.3  # share of all photographs' background in the background of one


class Palette:
    """Tells object from background by colour.

    Args:
        pictures: Photographs.
        beliefs: Belief in the object at each pixel, (H, W) in [0, 1].
    """

    def __init__(self, pictures: Sequence[Picture], beliefs: Sequence[Layer]) -> None:
        self._steps = [_steps(picture.lab) for picture in pictures]
        # doubtful pixels teach neither side
        weights = [np.clip(2 * belief.ravel() - 1, 0, 1) for belief in beliefs]
        against = [np.clip(1 - 2 * belief.ravel(), 0, 1) for belief in beliefs]
        own = [_counts(*pair) for pair in zip(self._steps, weights, strict=True)]
        rest = [_counts(*pair) for pair in zip(self._steps, against, strict=True)]
        self._counts = list(zip(own, rest, strict=True))
        self._all_own, self._all_rest = np.sum(own, axis=0), np.sum(rest, axis=0)
        behind = _likelihood(self._all_rest)
        self._object = _likelihood(_without(self._all_own, behind))
        self._rest = [
            (1 - SHARED) * _likelihood(counts) + SHARED * behind if counts.any() else behind
            for counts in rest
        ]

    def evidence(self, index: int, shape: tuple[int, ...]) -> Layer:
        """Log ratio of object to background at the pixels of a photograph, (H, W)."""
        ratio = np.log(self._object / self._rest[index]).astype(np.float32)
        return np.clip(ratio[self._steps[index]], -SURE, SURE).reshape(shape)

    def evidence_of_others(self, index: int, shape: tuple[int, ...]) -> Layer:
        """The same, (H, W), learnt from all photographs but this one: a fair judge of it."""
        own, rest = self._counts[index]
        behind = _likelihood(self._all_rest - rest)
        front = _likelihood(_without(self._all_own - own, behind))
        return np.log(front / behind).astype(np.float32)[self._steps[index]].reshape(shape)


def _steps(lab: Layer) -> NDArray[np.int32]:
    """Number of each pixel's cell of the histogram, (H * W,)."""
    share = (lab.reshape(-1, 3) - LOWEST) / (HIGHEST - LOWEST)
    bins = np.array(BINS)
    index = np.clip((share * bins).astype(np.int32), 0, bins - 1)
    return np.asarray(np.ravel_multi_index(tuple(index.T), BINS), dtype=np.int32)


def _counts(steps: NDArray[np.int32], weights: Layer) -> NDArray[np.float64]:
    return np.bincount(steps, weights, minlength=int(np.prod(BINS))).astype(np.float64)


def _likelihood(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Likelihood of each colour, (prod(BINS),)."""
    smooth = ndimage.gaussian_filter(counts.reshape(BINS), SMOOTH, truncate=2.5, mode="nearest")
    return smooth.ravel() / max(float(smooth.sum()), 1e-9) + FLOOR


def _without(counts: NDArray[np.float64], behind: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts of what should be object, less the background that is typically among them.

    How much of the background strayed in is told by its usual colours: the weighted median of
    the ratio of their counts.
    """
    ratio = counts / behind
    order = np.argsort(ratio)
    mass = np.cumsum(behind[order])
    strayed = ratio[order][np.searchsorted(mass, 0.5 * mass[-1])]
    return np.maximum(counts - strayed * behind, 0.0)
