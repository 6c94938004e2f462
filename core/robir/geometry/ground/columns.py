# SPDX-License-Identifier: Apache-2.0
"""A grid of columns that stand on the support plane."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from torch import Tensor

from robir.geometry.ground.plane import SupportPlane, within
from robir.geometry.lattice import Lattice

Array = NDArray[np.float64]


class Columns:
    """A grid of columns over the plane's outline, for heights above the plane.

    Args:
        plane: The support plane.
        spacing: Distance between columns, unit frame.
    """

    def __init__(self, plane: SupportPlane, spacing: float) -> None:
        self.plane = plane
        self.spacing = spacing
        low = plane.outline.min(0) - 2.0 * spacing
        count = np.ceil((plane.outline.max(0) + 2.0 * spacing - low) / spacing).astype(int) + 1
        self.low = low
        self.shape = (int(count[0]), int(count[1]))
        u, v = np.meshgrid(
            low[0] + spacing * np.arange(count[0]),
            low[1] + spacing * np.arange(count[1]),
            indexing="ij",
        )
        self.feet = np.stack([u.ravel(), v.ravel()], axis=1)
        self.inside = within(plane.outline, self.feet).reshape(self.shape)

    def tops(self, lattice: Lattice, sdf: Tensor, highest: float) -> Array:
        """Height of the uppermost surface of each column up to `highest`; -inf where none."""
        heights = np.arange(-2.0 * self.spacing, highest, 0.5 * self.spacing)
        top = np.full(len(self.feet), -np.inf)
        above = np.full(len(self.feet), np.inf)
        for height in heights[::-1]:
            spots = np.concatenate([self.feet, np.full((len(self.feet), 1), height)], axis=1)
            points = torch.from_numpy(self.plane.world(spots)).float()
            value = lattice.trilinear(sdf.cpu(), points).numpy().astype(np.float64)
            crosses = (value < 0) & np.isneginf(top)
            with np.errstate(invalid="ignore"):
                part = np.where(np.isfinite(above), -value / np.maximum(above - value, 1e-9), 0.0)
            top[crosses] = height + 0.5 * self.spacing * part[crosses]
            above = value
        return top.reshape(self.shape)

    def sample(self, values: Array, local: Array) -> Array:
        """Values of the columns (bilinear) at points (P, 3) of the plane's frame."""
        at = (local[:, :2] - self.low) / self.spacing
        return map_coordinates(values, at.T, order=1, mode="nearest")
