# SPDX-License-Identifier: Apache-2.0
"""Flattening of the ground under the object, in the distance field."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, binary_opening, distance_transform_edt, label
from torch import Tensor

from robir.geometry.ground.columns import Columns
from robir.geometry.ground.photo_consistency import feet_agree
from robir.geometry.ground.plane import SupportPlane, project_outline, within
from robir.geometry.hull import HullCarver
from robir.geometry.lattice import Lattice
from robir.geometry.rays import Photo

Array = NDArray[np.float64]


_HIGHEST = 0.6  # height above the plane up to which columns are searched for a surface (unit frame)
# height from which columns are objects whatever their foot would look like (unit frame)
_STANDING = 0.13
_HIGHEST_LENS = 0.3  # height up to which the hull of bare ground is searched (unit frame)
_LENS_SLACK = 0.6  # height over that hull up to which masks hold no evidence of anything (cells)
_FLAT = 0.8  # distance from the plane up to which a column's surface is the plane (cells)
_SPECK = 9  # columns of the largest doubtful piece that joins the ground enclosing it
_RIM = 0.93  # size of the part of the outline, towards its middle, that must prove to be ground
# how far below the plane half of a ground may lie once a level is fitted; more is a plate (cells)
_DEEPEST = 0.2


def lens_heights(columns: Columns, photos: list[Photo], lattice: Lattice, highest: float) -> Array:
    """Height, up to `highest`, to which the hull of the bare ground bulges over each column."""
    cameras = [photo.camera for photo in photos]
    bare = [project_outline(columns.plane, c).astype(np.float32) for c in cameras]
    shown = [k for k, area in enumerate(bare) if area.any()]
    carver = HullCarver([cameras[k] for k in shown], [bare[k] for k in shown])
    nodes = lattice.nodes()
    local = columns.plane.local(nodes.numpy().astype(np.float64))
    near = np.abs(local[:, 2]) < highest + 2.0 * lattice.cell
    value = torch.full((lattice.count,), 1.0)
    value[torch.from_numpy(near)] = carver(nodes[torch.from_numpy(near)])
    return columns.tops(lattice, value, highest)


class Ground:
    """Decides which columns are bare ground and flattens them.

    Ground begins at the outline of the plane, which the masks prove, and spreads over columns
    that are low and whose feet the photographs agree on. A column whose hull is no higher than
    the hull of bare ground counts as low from the start: the masks hold no evidence of anything.

    Args:
        plane: The support plane.
        photos: Photographs.
        lattice: Lattice of the hull.
        hull: (N,) signed distance of the visual hull.

    Attributes:
        columns: Columns over the plane.
        tops: Height of the hull over each column, -inf where it has none.
        start: Columns that are bare ground for certain.
    """

    def __init__(
        self,
        plane: SupportPlane,
        photos: list[Photo],
        lattice: Lattice,
        hull: Tensor,
    ) -> None:
        self.columns = Columns(plane, lattice.cell)
        self._photos = photos
        lens = lens_heights(self.columns, photos, lattice, _HIGHEST_LENS)
        self.tops = top = self.heights(lattice, hull)
        self._bare = self.columns.inside & (top <= lens + _LENS_SLACK * lattice.cell)
        inner = within(plane.outline * _RIM, self.columns.feet).reshape(self.columns.shape)
        self._rim = self._bare & ~inner
        tops = np.where(self._bare, 0.0, top)
        agree = self._feet_agree(self._bare, tops)
        self.start = self._spread(self._bare & agree)

    def above(self, points: Array) -> Array:
        """Height of points (P, 3) of the unit frame above the ground."""
        return self.columns.plane.local(points)[:, 2]

    def _feet_agree(self, wanted: NDArray[np.bool_], tops: Array) -> NDArray[np.bool_]:
        return feet_agree(self.columns, wanted, tops, self._photos)

    def _spread(self, passable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Ground that spreads from the rim over passable columns, specks it encloses included."""
        ground = self.joined(passable)
        rest, _ = label(~ground)
        is_speck = np.bincount(rest.ravel())[rest] <= _SPECK
        return ground | (self.columns.inside & is_speck)

    def joined(self, passable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Passable columns joined to the rim by ways no narrower than three, and the rim."""
        open_ways = binary_opening(passable | self._rim, np.ones((3, 3), bool)) | self._rim
        piece, _ = label(open_ways)
        return np.isin(piece, np.unique(piece[self._rim])) & open_ways

    def heights(self, lattice: Lattice, sdf: Tensor) -> Array:
        """Height of a surface (N,) over each column, -inf where it has none."""
        return self.columns.tops(lattice, sdf, _HIGHEST)

    def settled(self, top: Array, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Columns that are ground given the present surface.

        Args:
            top: Its height over each column.
            known: Columns at whose feet the picture of the ground is known. Elsewhere photographs
                that agree on the colour of a foot may see the border of a board.

        Returns:
            The columns' shape.
        """
        low = self.columns.inside & (top < _STANDING)
        flat = low & (np.abs(top) < _FLAT * self.columns.spacing)
        agree = self._feet_agree(low & ~flat & known, top)
        return self._spread((self.start & known & low) | flat | agree)

    def nearly(self, top: Array, settled: NDArray[np.bool_], height: float) -> NDArray[np.bool_]:
        """Columns that are ground if what is no further than `height` from the plane is.

        Args:
            top: Height of the surface over each column.
            settled: Result of `settled` for it.
            height: Unit frame.
        """
        return self._spread(settled | (self.columns.inside & (np.abs(top) < height)))

    def is_flat(self, cell: float, top: Array, settled: NDArray[np.bool_]) -> bool:
        """Whether the present surface follows the plane, rather than lying in a bowl below it.

        The rim of a plate is as flat as that of a ground, and no mask shows the bowl within. The
        fit digs it, though, wherever the photographs differ at the height of the plane.

        Args:
            cell: Of the surface's lattice.
            top: Height of the surface over each column.
            settled: Result of `settled` for it.
        """
        return bool(np.median(top[settled]) > -_DEEPEST * cell)

    def flatten(self, lattice: Lattice, sdf: Tensor, ground: NDArray[np.bool_]) -> Tensor:
        """Cut away what stands above the ground over its columns, and fill pits below it.

        What hangs over them higher than columns are searched stays. Below things that ground
        encloses there is ground too: pits are dug beside the feet of what hangs over them.

        Args:
            lattice: Nodes.
            sdf: (N,) signed distances.
            ground: Which columns are ground.

        Returns:
            The new signed distances (N,).
        """
        columns = self.columns
        nodes = lattice.nodes().numpy().astype(np.float64)
        local = columns.plane.local(nodes)
        reach, below = (
            columns.sample(_depth_inside(area) * columns.spacing, local)
            for area in (ground, binary_fill_holes(ground))
        )
        height = self.above(nodes)
        before = sdf.detach().cpu().numpy()
        searched = np.minimum(height, _HIGHEST - height)
        cut = np.maximum(before, np.minimum(searched, reach))
        # pits are filled, but the rim itself is left to the masks
        inner = columns.spacing * 2.0 - below
        slab = np.maximum(np.maximum(height, inner), -height - 1.5 * lattice.cell)
        return torch.from_numpy(np.minimum(cut, slab).astype(np.float32)).to(sdf.device)


def _depth_inside(area: NDArray[np.bool_]) -> Array:
    """Distance from the border of an area of columns, in columns; negative outside."""
    return distance_transform_edt(area) - distance_transform_edt(~area)
