# SPDX-License-Identifier: Apache-2.0
"""Pieces that samples fall into: near each other and of like hue, and clusters of features."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Reals = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]

# Ashman's distance of two halves' means, in their mean deviations, from which they are two hues.
# Hues spread evenly along a line have 3.5 when cut in the middle, a normal distribution 2.7.
_CLEAR_GAP = 4.0


def pieces(position: Reals, hue: Reals, gap: float, fewest: int) -> Rows:
    """Number (N,) of the piece of every sample: near each other and of one hue.

    Links lead across borders, where hues blend; so a touching piece is cut in two where its log
    hues (N, 3) lie in two heaps. `gap` is the distance of neighbours, `fewest` the samples of
    either side.
    """
    near = cKDTree(position).query_pairs(gap, output_type="ndarray")
    ones = np.ones(len(near))
    links = coo_matrix((ones, (near[:, 0], near[:, 1])), shape=(len(position), len(position)))
    count, touching = connected_components(links, directed=False)
    waiting = [np.flatnonzero(touching == index) for index in range(count)]
    number, done = np.zeros(len(position), np.int64), 0
    while waiting:
        rows = waiting.pop()
        is_low = _two_heaps(hue[rows], fewest, _CLEAR_GAP)
        if is_low is None:
            number[rows] = done
            done += 1
        else:
            waiting += [rows[is_low], rows[~is_low]]
    return number


def _two_heaps(hue: Reals, fewest: int, clear_gap: float) -> NDArray[np.bool_] | None:
    """Which of hues (N, 3) lie in the lower of two heaps; None if they lie in one.

    The cut that leaves the least variance (Otsu) along the axis of the greatest.
    """
    count = len(hue)
    if count < 2 * fewest:
        return None
    centred = hue - hue.mean(0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    order = np.argsort(along)
    # means are 0 together, so the sum of the lower ones tells how far apart both are
    size = np.arange(fewest, count - fewest + 1)
    lower = np.cumsum(along[order])[size - 1]
    cut = size[int((lower**2 / (size * (count - size))).argmax())]
    low, high = along[order[:cut]], along[order[cut:]]
    deviation = np.sqrt(0.5 * (low.var() + high.var()))
    if high.mean() - low.mean() <= clear_gap * max(deviation, 1e-9):
        return None
    is_low = np.zeros(count, bool)
    is_low[order[:cut]] = True
    return is_low


def clusters(features: Reals, count: int, seed: int) -> Rows:
    """k-means labels (N,)."""
    count = min(count, len(features))
    _, labels = kmeans2(
        features.astype(np.float64), count, minit="++", seed=np.random.default_rng(seed)
    )
    return labels.astype(np.int64)


def means(features: Reals, cluster: Rows) -> Reals:
    """Means (K, D) over each cluster; 0 where k-means left one empty."""
    size = np.bincount(cluster).clip(1)
    return np.stack([np.bincount(cluster, column) / size for column in features.T], axis=1)
