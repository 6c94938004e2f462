# SPDX-License-Identifier: Apache-2.0
"""Flattening of the ground under the object, in the distance field."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, distance_transform_edt, label, map_coordinates
from torch import Tensor

from robir.geometry.hull import HullCarver
from robir.geometry.lattice import Lattice, interpolate
from robir.geometry.plane import SupportPlane, project_outline, within
from robir.geometry.rays import Photo

Array = NDArray[np.float64]

HIGHEST = 0.6
"""Height above the plane, unit frame, up to which columns are searched for a surface."""


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
            value = interpolate(sdf.detach().cpu()[:, None], *lattice.corners(points))[:, 0]
            value = value.numpy().astype(np.float64)
            crosses = (value < 0) & np.isneginf(top)
            with np.errstate(invalid="ignore"):
                part = np.where(np.isfinite(above), -value / np.maximum(above - value, 1e-9), 0.0)
            top[crosses] = height + 0.5 * self.spacing * part[crosses]
            above = value
        return top.reshape(self.shape)

    def sample(self, values: Array, points: Array) -> Array:
        """Values of the columns (bilinear) at points (P, 3) of the unit frame."""
        at = (self.plane.local(points)[:, :2] - self.low) / self.spacing
        return map_coordinates(values, at.T, order=1, mode="nearest")


def lens_heights(columns: Columns, photos: list[Photo], lattice: Lattice) -> Array:
    """Height to which the hull of the bare ground bulges over each column."""
    cameras = [photo.camera for photo in photos]
    bare = [project_outline(columns.plane, c).astype(np.float32) for c in cameras]
    shown = [k for k, area in enumerate(bare) if area.any()]
    carver = HullCarver([cameras[k] for k in shown], [bare[k] for k in shown])
    nodes = lattice.nodes()
    local = columns.plane.local(nodes.numpy().astype(np.float64))
    near = np.abs(local[:, 2]) < 0.4
    value = torch.full((lattice.count,), 1.0)
    value[torch.from_numpy(near)] = carver(nodes[torch.from_numpy(near)])
    return columns.tops(lattice, value, 0.3)


class Ground:
    """Decides which columns are bare ground and flattens them.

    A column whose hull is no higher than the hull of bare ground is ground at once: the masks
    hold no evidence of anything there. The others join when the fit has brought their surface
    near the plane and they connect to columns that are ground.

    Args:
        plane: The support plane.
        photos: Photographs whose masks carve.
        lattice: Lattice of the hull.
        hull: (N,) signed distance of the visual hull.
    """

    def __init__(
        self, plane: SupportPlane, photos: list[Photo], lattice: Lattice, hull: Tensor
    ) -> None:
        self.columns = Columns(plane, lattice.cell)
        lens = lens_heights(self.columns, photos, lattice)
        top = self.columns.tops(lattice, hull, HIGHEST)
        self.bare = self.columns.inside & (top <= lens + 0.6 * lattice.cell)

    def settled(self, lattice: Lattice, sdf: Tensor, tolerance: float) -> NDArray[np.bool_]:
        """Columns whose surface lies on the plane, connected to those that are bare.

        Args:
            lattice: Nodes.
            sdf: (N,) signed distances.
            tolerance: Largest height above or depth below the plane, unit frame.

        Returns:
            The columns' shape.
        """
        top = self.columns.tops(lattice, sdf, HIGHEST)
        flat = self.columns.inside & ((top < tolerance) | self.bare)
        flat = binary_opening(flat, np.ones((3, 3), bool)) | self.bare
        piece, _ = label(flat)
        return np.isin(piece, np.unique(piece[self.bare])) & flat

    def flatten(self, lattice: Lattice, sdf: Tensor, ground: NDArray[np.bool_]) -> Tensor:
        """Cut away what stands above the plane over ground columns, and fill pits below it.

        Args:
            lattice: Nodes.
            sdf: (N,) signed distances.
            ground: Which columns are ground.

        Returns:
            The new signed distances (N,).
        """
        columns = self.columns
        aside = distance_transform_edt(ground) - distance_transform_edt(~ground)
        points = lattice.nodes().numpy().astype(np.float64)
        reach = columns.sample(aside * columns.spacing, points)
        height = columns.plane.local(points)[:, 2]
        before = sdf.detach().cpu().numpy()
        cut = np.maximum(before, np.minimum(height, reach))
        slab = np.maximum(np.maximum(height, -reach), -height - 3.0 * lattice.cell)
        return torch.from_numpy(np.minimum(cut, slab).astype(np.float32)).to(sdf.device)
