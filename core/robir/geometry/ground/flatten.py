# SPDX-License-Identifier: Apache-2.0
"""Ground that masks include: columns of it told from what stands on it, and made flat.

The foot of bare ground shows one colour to all cameras that see it. Where something stands, even
something low, its outline appears shifted at the height of the plane, and the photographs disagree
all along that outline (after Kutulakos and Seitz 2000, "A theory of shape by space carving").

Batch letters: V photographs, K columns, P points.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_fill_holes,
    binary_opening,
    distance_transform_edt,
    label,
    map_coordinates,
    minimum_filter,
)
from torch import Tensor

from robir.geometry.ground.plane import SupportPlane, project_outline, within
from robir.geometry.hull import HullCarver
from robir.geometry.lattice import Lattice
from robir.geometry.rays import ReducedPhoto

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
_LEAST_VIEWS = 4  # photographs that must see a spot before it is judged
SAME_COLOUR = 0.06  # mean difference of display colours up to which they count as the same
# by how much less photographs must differ, display, about a surface than about the foot below it
# for the surface to be believed: a plate's rim is, what is left before bare ground not
_LEAD = 0.01
# by how much what hides a spot must be higher than the surface over the spot's own column, in
# steps between columns. A plate's rim hides the ground beside it, and a lump left beside the rim
# must not be asked by photographs that see the rim; but lumps do not speak for each other.
_TALLER = 2.0
# room between bumpy ground and what hangs over it from which the two are apart (cells)
_LEAST_ROOM = 2.0
_LINE_STEPS = 40  # steps of the line from a spot to a camera that may be hidden
_LEAST_COVERAGE = 0.9  # above which a mask holds a spot


class Columns:
    """A grid of columns, `spacing` apart, over the plane's outline, for heights above the plane.

    `feet` (K, 2) are coordinates within the plane, `shape` the columns along its two directions,
    and `inside`, of that shape, those that stand on the outline's inside.
    """

    def __init__(self, plane: SupportPlane, spacing: float) -> None:
        self.plane, self.spacing = plane, spacing
        self.low = plane.outline.min(0) - 2.0 * spacing
        high = plane.outline.max(0) + 2.0 * spacing
        count = np.ceil((high - self.low) / spacing).astype(int) + 1
        self.shape = (int(count[0]), int(count[1]))
        self.feet = self.low + spacing * np.argwhere(np.ones(self.shape))
        self.inside = within(plane.outline, self.feet).reshape(self.shape)

    def tops(self, lattice: Lattice, sdf: Tensor, highest: float) -> Array:
        """Height of the uppermost surface of each column up to `highest`; -inf where none."""
        top = np.full(len(self.feet), -np.inf)
        above = np.full(len(self.feet), np.inf)
        for height in self._heights(highest)[::-1]:
            value = self._distances(lattice, sdf, height)
            crosses = (value < 0) & np.isneginf(top)
            with np.errstate(invalid="ignore"):
                part = np.where(np.isfinite(above), -value / np.maximum(above - value, 1e-9), 0.0)
            top[crosses] = height + 0.5 * self.spacing * part[crosses]
            above = value
        return top.reshape(self.shape)

    def overhung(self, lattice: Lattice, sdf: Tensor, highest: float) -> Array:
        """Height half way between bumps of the ground and what hangs over them, of each column.

        -inf where nothing hangs over it below `highest`, or what rises from it is no bump.
        """
        floor = np.full(len(self.feet), -np.inf)
        ceiling = np.full(len(self.feet), np.inf)
        below = np.full(len(self.feet), np.inf)
        for height in self._heights(highest):
            value = self._distances(lattice, sdf, height)
            is_open = np.isfinite(floor)
            floor[~is_open & (below < 0) & (value >= 0)] = height
            ceiling[is_open & (value < 0) & np.isinf(ceiling)] = height
            below = value
        is_room = np.isfinite(ceiling) & (ceiling > floor + _LEAST_ROOM * self.spacing)
        is_room &= floor < _STANDING
        middle = np.full(len(self.feet), -np.inf)
        middle[is_room] = 0.5 * (floor[is_room] + ceiling[is_room])
        return middle.reshape(self.shape)

    def _heights(self, highest: float) -> Array:
        """Heights above the plane at which columns are looked at, from just below it."""
        return np.arange(-2.0 * self.spacing, highest, 0.5 * self.spacing)

    def _distances(self, lattice: Lattice, sdf: Tensor, height: float) -> Array:
        """Signed distance (K,) of a surface at one height of all columns."""
        spots = np.concatenate([self.feet, np.full((len(self.feet), 1), height)], axis=1)
        points = torch.from_numpy(self.plane.world(spots)).float()
        return lattice.trilinear(sdf.cpu(), points).numpy().astype(np.float64)

    def sample(self, values: Array, local: Array) -> Array:
        """Values of the columns (bilinear) at points (P, 3) of the plane's frame."""
        at = (local[:, :2] - self.low) / self.spacing
        return map_coordinates(values, at.T, order=1, mode="nearest")


def lens_heights(
    columns: Columns, photos: list[ReducedPhoto], lattice: Lattice, highest: float
) -> Array:
    """Height, up to `highest`, to which the hull of the bare ground bulges over each column."""
    cameras = [photo.camera for photo in photos]
    bare = [project_outline(columns.plane, c).astype(np.float32) for c in cameras]
    shown = [k for k, area in enumerate(bare) if area.any()]
    carver = HullCarver([cameras[k] for k in shown], [bare[k] for k in shown])
    nodes = lattice.nodes()
    local = columns.plane.local(nodes.numpy().astype(np.float64))
    near = torch.from_numpy(np.abs(local[:, 2]) < highest + 2.0 * lattice.cell)
    value = torch.full((lattice.count,), 1.0)
    value[near] = carver(nodes[near])
    return columns.tops(lattice, value, highest)


class Ground:
    """Decides which columns are bare ground and flattens them, by photographs and the visual hull.

    Ground begins at the outline of the plane, which the masks prove, and spreads over columns that
    are low and whose feet the photographs agree on. A column whose hull is no higher than the hull
    of bare ground counts as low from the start: the masks hold no evidence of anything. `tops` is
    the height of the hull over each column, -inf where it has none; `start` are columns that are
    bare ground for certain.
    """

    def __init__(
        self, plane: SupportPlane, photos: list[ReducedPhoto], lattice: Lattice, hull: Tensor
    ) -> None:
        self.columns, self._photos = Columns(plane, lattice.cell), photos
        lens = lens_heights(self.columns, photos, lattice, _HIGHEST_LENS)
        self.tops = top = self.heights(lattice, hull)
        bare = self.columns.inside & (top <= lens + _LENS_SLACK * lattice.cell)
        inner = within(plane.outline * _RIM, self.columns.feet).reshape(self.columns.shape)
        self._rim = bare & ~inner
        agree = feet_agree(self.columns, bare, np.where(bare, 0.0, top), photos)
        self.start = self._spread(bare & agree)

    def above(self, points: Array) -> Array:
        """Height of points (P, 3) of the unit frame above the ground."""
        return self.columns.plane.local(points)[:, 2]

    def joined(self, passable: Mask) -> Mask:
        """Passable columns joined to the rim by ways no narrower than three, and the rim."""
        open_ways = binary_opening(passable | self._rim, np.ones((3, 3), bool)) | self._rim
        piece, _ = label(open_ways)
        return np.isin(piece, np.unique(piece[self._rim])) & open_ways

    def _spread(self, passable: Mask) -> Mask:
        """Ground that spreads from the rim over passable columns, specks it encloses included."""
        ground = self.joined(passable)
        rest, _ = label(~ground)
        is_speck = np.bincount(rest.ravel())[rest] <= _SPECK
        return ground | (self.columns.inside & is_speck)

    def heights(self, lattice: Lattice, sdf: Tensor) -> Array:
        """Height of a surface (N,) over each column, -inf where it has none."""
        return self.columns.tops(lattice, sdf, _HIGHEST)

    def settled(self, top: Array, known: Mask) -> Mask:
        """Columns that are ground given the height of the present surface over each column.

        Only columns at whose feet the picture of the ground is known are asked: elsewhere
        photographs that agree on the colour of a foot may see the border of a board.
        """
        low = self.columns.inside & (top < _STANDING)
        flat = low & (np.abs(top) < _FLAT * self.columns.spacing)
        agree = feet_agree(self.columns, low & ~flat & known, top, self._photos)
        return self._spread((self.start & known & low) | flat | agree)

    def nearly(self, top: Array, settled: Mask, height: float) -> Mask:
        """Columns that are ground if what is no further than `height` from the plane is."""
        return self._spread(settled | (self.columns.inside & (np.abs(top) < height)))

    def is_flat(self, cell: float, top: Array, settled: Mask) -> bool:
        """Whether the present surface follows the plane, rather than lying in a bowl below it.

        The rim of a plate is as flat as that of a ground, and no mask shows the bowl within. The
        fit digs it, though, wherever the photographs differ at the height of the plane. Where
        hardly a column is settled all that are low tell it.
        """
        low = self.columns.inside & (top < _STANDING)
        levels = [float(np.median(top[area])) for area in (settled, low) if area.any()]
        return max(levels, default=-np.inf) > -_DEEPEST * cell

    def overhung(self, lattice: Lattice, sdf: Tensor, ground: Mask) -> Array:
        """Height up to which columns under an overhang may be cut, beside `ground`; else -inf."""
        middle = self.columns.overhung(lattice, sdf, _HIGHEST)
        below = self.columns.inside & np.isfinite(middle) & ~ground
        return np.where(below & self.joined(ground | below), middle, -np.inf)

    def flatten(
        self, lattice: Lattice, sdf: Tensor, ground: Mask, overhung: Array | None = None
    ) -> Tensor:
        """Distances (N,), what stands above the ground over its columns cut, pits below it filled.

        What hangs over them higher than columns are searched stays, and over those of `overhung`
        what is higher than that. Below things that ground encloses there is ground too: pits are
        dug beside the feet of what hangs over them.
        """
        columns = self.columns
        local = columns.plane.local(lattice.nodes().numpy().astype(np.float64))
        middle = np.full(columns.shape, -np.inf) if overhung is None else overhung
        is_below = np.isfinite(middle)
        reach, below = (
            columns.sample(_depth_inside(area) * columns.spacing, local)
            for area in (ground | is_below, binary_fill_holes(ground))
        )
        highest = minimum_filter(np.where(is_below, middle, _HIGHEST), 3)
        height, before = local[:, 2], sdf.detach().cpu().numpy()
        room = columns.sample(highest, local) - height
        cut = np.maximum(before, np.minimum(np.minimum(height, room), reach))
        # pits are filled, but the rim itself is left to the masks
        inner = columns.spacing * 2.0 - below
        slab = np.maximum(np.maximum(height, inner), -height - 1.5 * lattice.cell)
        return torch.from_numpy(np.minimum(cut, slab).astype(np.float32)).to(sdf.device)


def _depth_inside(area: Mask) -> Array:
    """Distance from the border of an area of columns, in columns; negative outside."""
    return distance_transform_edt(area) - distance_transform_edt(~area)


def feet_agree(columns: Columns, wanted: Mask, tops: Array, photos: list[ReducedPhoto]) -> Mask:
    """Whether the photographs agree on the colour at the feet of wanted columns.

    False where they agree better about the surface over the foot, whose height is `tops`.
    """
    foot = deviations(columns, wanted, np.zeros(columns.shape), tops, photos)
    agree = foot < SAME_COLOUR
    # a surface at the foot, or none at all, has nothing over it
    raised = agree & np.isfinite(tops) & (tops != 0)
    if not raised.any():
        return agree
    surface = deviations(columns, raised, tops, tops, photos)
    return agree & ~(foot > surface + _LEAD)


def deviations(
    columns: Columns, wanted: Mask, heights: Array, tops: Array, photos: list[ReducedPhoto]
) -> Array:
    """How much photographs differ on the colour of spots over wanted columns, the columns' shape.

    Mean difference from the median display colour of spots at `heights` above the plane, NaN where
    not wanted or shown by too few; what stands below `tops` hides spots.
    """
    chosen = np.flatnonzero(wanted)
    spots = np.column_stack([columns.feet[chosen], heights.ravel()[chosen]])
    over = tops.ravel()[chosen] + _TALLER * columns.spacing
    colours = colours_at(columns, spots, photos)
    for own, photo in zip(colours, photos, strict=True):
        own[hidden(columns, tops, over, spots, photo)] = np.nan
    enough = np.isfinite(colours[..., 0]).sum(axis=0) >= _LEAST_VIEWS
    found = colours[:, enough]
    result = np.full(wanted.size, np.nan)
    result[chosen[enough]] = np.nanmean(np.abs(found - np.nanmedian(found, axis=0)), axis=(0, 2))
    return result.reshape(wanted.shape)


def colours_at(columns: Columns, spots: Array, photos: list[ReducedPhoto]) -> NDArray[np.float32]:
    """Display colours (V, K, 3) at spots (K, 3) of the plane's frame, as if nothing stood before.

    NaN where a photograph does not hold the spot.
    """
    points = columns.plane.world(spots)
    colours = np.full((len(photos), len(spots), 3), np.nan, np.float32)
    for own, photo in zip(colours, photos, strict=True):
        image, depth = photo.camera.project(points)
        at = image[:, ::-1].T - 0.5
        covered = map_coordinates(photo.coverage, at, order=1, mode="constant")
        shown = (depth > 0) & (covered > _LEAST_COVERAGE)
        channels = np.moveaxis(photo.premultiplied_display, 2, 0)
        values = [map_coordinates(one, at[:, shown], order=1, mode="nearest") for one in channels]
        own[shown] = np.stack(values, axis=1)
    return colours


def hidden(columns: Columns, tops: Array, over: Array, spots: Array, photo: ReducedPhoto) -> Mask:
    """Whether lines from spots (K, 3) to a camera pass below what is higher than `over` (K,)."""
    eye = columns.plane.local(photo.camera.position)
    highest = tops.max()
    if not len(spots) or highest <= over.min():
        return np.zeros(len(spots), bool)
    across = eye - spots
    rise = np.maximum(highest - spots[:, 2], 0.0) / across[:, 2]
    share = np.linspace(0.0, 1.0, _LINE_STEPS)[:, None]
    at = spots.T[:, None] + (share * rise) * across.T[:, None]
    column = (at[:2] - columns.low[:, None, None]) / columns.spacing
    last = np.array(columns.shape)[:, None, None] - 1.0
    is_over = ((column >= 0.0) & (column <= last)).all(axis=0)
    u, v = np.floor(np.where(is_over, column, 0.0) + 0.5).astype(int)
    return (is_over & (tops[u, v] > np.maximum(at[2], over))).any(axis=0)
