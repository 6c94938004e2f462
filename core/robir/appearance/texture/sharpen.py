# SPDX-License-Identifier: Apache-2.0
"""Texture finer than the pixels of one photograph.

A pixel holds the mean over its square, and reading between pixels blurs once more. But the grids of
the photographs lie differently on the surface, so together they know more than each: the texels are
changed until the pixels they predict are those that were photographed (iterative back-projection,
Irani and Peleg 1991, "Improving resolution by image registration").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.transport.observe import pixels_about

Floats = NDArray[np.float32]

STEPS = 2
"""More of them sharpen the errors of the mesh instead of the texture."""

LARGEST_CHANGE = 0.7
"""Of the logarithm of a texel's radiance: most that a pixel's blur can hide."""


@dataclass(frozen=True, slots=True)
class _Pixels:
    """Where texels lie in one photograph.

    Attributes:
        count: Number of pixels.
        square: (M,) pixel that each texel lies in.
        corners: (M, 4) pixels whose centres surround it.
        shares: (M, 4) what each of them counts when the photograph is read there.
        size: (M,) how much of the picture the texel covers, in any unit.
    """

    count: int
    square: NDArray[np.int64]
    corners: NDArray[np.int64]
    shares: Floats
    size: Floats

    @classmethod
    def of(cls, camera: Camera, position: Floats, cosine: Floats) -> _Pixels:
        """Project texels (M, 3) seen under some cosine (M,) to the normal."""
        width, height = camera.width, camera.height
        place, depth = camera.project(position.astype(np.float64))
        column, row = np.clip(np.floor(place), 0, [width - 1, height - 1]).astype(int).T
        rows, columns, shares = pixels_about(camera, place)
        return cls(
            count=width * height,
            square=row * width + column,
            corners=rows * width + columns,
            shares=shares.astype(np.float32),
            size=(cosine / depth**2).astype(np.float32),
        )

    def read(self, radiance: Floats) -> Floats:
        """What the photograph would hold at the texels (M, 3) if they had this radiance (M, 3)."""
        covered = np.bincount(self.square, self.size, self.count)
        weight = covered[self.corners] * self.shares > 0
        shares = weight * self.shares
        shares /= shares.sum(1, keepdims=True)
        channels = []
        for channel in range(3):
            total = np.bincount(self.square, self.size * radiance[:, channel], self.count)
            mean = total / np.maximum(covered, 1e-20)
            channels.append((shares * mean[self.corners]).sum(1))
        return np.stack(channels, axis=1)


def sharpened(
    radiance: Floats,
    read: tuple[Floats, Floats, Floats],
    position: Floats,
    views: tuple[View, ...],
) -> Floats:
    """Radiance of texels of which the photographs' pixels would be the means.

    Args:
        radiance: (N, 3) of the texels as read from the photographs, linear Rec.709.
        read: What the views show of each texel: (N, V, 3) linear Rec.709, (N, V) what it counts in
            `radiance`, and (N, V) the cosine between normal and view, 0 where it is not shown.
        position: (N, 3) of the texels, frame of the views' cameras.
        views: The V photographs.

    Returns:
        (N, 3) linear Rec.709; as it was where no reading counts.
    """
    linear, share, cosine = read
    before = np.log(np.maximum(radiance, 1e-5))
    log = before
    for _ in range(STEPS):
        change = np.zeros_like(log)
        for index, view in enumerate(views):
            rows = np.flatnonzero(cosine[:, index] > 0)
            # anew in every step: kept for all views they would take more memory than the readings
            pixels = _Pixels.of(view.camera, position[rows], cosine[rows, index])
            predicted = pixels.read(np.exp(log[rows]))
            apart = np.log(np.maximum(linear[rows, index], 1e-5) / np.maximum(predicted, 1e-5))
            change[rows] += share[rows, index][:, None] * apart
        log = before + np.clip(log + change - before, -LARGEST_CHANGE, LARGEST_CHANGE)
    return np.exp(log).astype(np.float32)
