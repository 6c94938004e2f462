# SPDX-License-Identifier: Apache-2.0
"""Samples anywhere on the surface whose albedos have one hue.

Neighbours do not see the shading of a smooth thing. Two samples of one hue are often of one
material and as bright as each other under the right light; hue is nearly right under a half-solved
light.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.photometry.statistics import Pairs

_DRAWS = 8  # partners of a sample: the nearest in hue of as many draws, so that they lie all over

_SHARE = 8  # a draw is one sample in so many

_FEWEST = 60  # samples of a draw at least; with fewer than twice as many in all there are no pairs

_HUE = 0.06  # difference of two log chromaticities at which a pair counts exp(-1/2)


def far_pairs(log_albedo: Tensor, whole: Tensor) -> Pairs | None:
    """Pairs of one hue among samples of log albedo (U, 3), those most alike counting most.

    Of the samples `whole` (W,), of which no channel is clipped; None with too few. Draws are
    seeded.
    """
    if len(whole) < 2 * _FEWEST:
        return None
    values, rows = log_albedo.numpy(), whole.numpy()
    hue = np.stack([values[:, 0] - values[:, 1], values[:, 2] - values[:, 1]], axis=1)[rows]
    rng, every = np.random.default_rng(0), np.arange(len(rows))
    partners = [_nearest(hue, rng) for _ in range(_DRAWS)]
    first, second = np.tile(every, _DRAWS), np.concatenate(partners)
    apart = first != second
    first, second = first[apart], second[apart]
    squared = ((hue[first] - hue[second]) ** 2).sum(1)
    weight = torch.from_numpy(np.exp(-0.5 * squared / _HUE**2).astype(np.float32))
    pairs = Pairs(
        first=torch.from_numpy(rows[first]), second=torch.from_numpy(rows[second]), weight=weight
    )
    return pairs.weighted(torch.ones_like(weight))


def _nearest(hue: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.int64]:
    """The nearest in hue (W, 2) to every sample among those drawn, (W,)."""
    drawn = rng.choice(len(hue), max(_FEWEST, len(hue) // _SHARE), replace=False)
    return drawn[cKDTree(hue[drawn]).query(hue)[1]]
