# SPDX-License-Identifier: Apache-2.0
"""The ground as a backdrop: where a photograph shows it, nothing stands in between.

Masks cut an object out against the far background, not against the ground it stands on; their
hull fills the room below every overhang. Once the ground's own picture is known, each photograph
tells which of its pixels show ground, and what remains is a silhouette before the ground. Hulls
of such silhouettes follow Laurentini 1994, "The visual hull concept"; that a colour is believed
where the cameras that see it agree, and doubted where they do not, follows Kutulakos and Seitz
2000, "A theory of shape by space carving".

Batch letters: V photographs, K columns, P points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    binary_opening,
    convolve,
    maximum_filter,
    minimum_filter,
    uniform_filter,
)
from scipy.spatial import cKDTree
from scipy.special import ndtri
from torch import Tensor
from torch.nn.functional import avg_pool3d

from robir.capture.capture import View
from robir.geometry.ground.flatten import SAME_COLOUR, Columns, Ground, colours_at, hidden
from robir.geometry.ground.plane import detect
from robir.geometry.hull import HULL_VIEWS, HullCarver
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.rays import ReducedPhoto, reduce_view
from robir.maths.vectors import farthest_points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_IMAGE_SIDE = 200  # longer side of the photographs that tell the ground (pixels)
_BINS = 20  # steps of a display channel in the palette of the ground
# share of the colours of certain ground that one step of the palette must have more of
_RAREST = 2e-4
_DARKEST = 0.25  # display value of the ground in deep shadow against that in light
_SHADES = 16  # shades from there to the light that the palette holds
# how far a pixel may lie outside the range of the ground's colours about its spot, display
_SPREAD = 0.05
_NOISE_WIDTH = 3.0  # how far it may in any case, in standard deviations of the photographs' noise
# above which a pixel tells of noise, for it shows nothing but what the mask encloses
_NOISE_COVERAGE = 0.99
# photographs that must show a spot of ground, and that must see through a freed point
_LEAST_VIEWS = 3
# of a spot's photographs that must show ground there; things may hide it from the rest
_LEAST_SHARE = 0.08
# share of the pixels that reach a spot and show another colour at which it is no ground
_DOUBT = 0.25
# difference of hue from the colours of certain ground beyond which a spot is no shaded ground
_HUE = 0.08
# display value against that of certain ground below which hue tells nothing: most light that
# arrives below a thing comes from it and has its hue
_DIM = 0.35
# share of certain ground that must have a hue: single columns may be certain wrongly
_LEAST_HUE = 0.02
_DARK = 0.02  # added to display colours before their hue is taken, which is noise in the dark
_VOTE_REACH = 2  # nodes to each side whose photographs decide about a node with its own
_ROUNDS = 2  # how often the picture of the ground is checked against what was freed with it
_STEP = 2  # every so many pixels are looked at where a sample will do, along rows and columns
_LEAST_COVERAGE = 0.95  # above which a pixel may show ground


def ground_palette(colours: NDArray[np.floating]) -> Mask:
    """Display colours the ground may have: (N, 3) of certain ground, and their darker shades.

    As (bins, bins, bins) bool, one step wider than the colours on every side.
    """
    step = np.clip((colours * _BINS).astype(int), 0, _BINS - 1)
    count = np.zeros((_BINS,) * 3)
    np.add.at(count, tuple(step.T), 1)
    seen = (np.argwhere(count > max(3.0, _RAREST * len(colours))) + 0.5) / _BINS
    palette = np.zeros((_BINS,) * 3, bool)
    for shade in np.linspace(_DARKEST, 1.0, _SHADES):
        palette[tuple((seen * shade * _BINS).astype(int).T)] = True
    return binary_dilation(palette, np.ones((3, 3, 3), bool))


def common_colour(colours: NDArray[np.floating], palette: Mask) -> Array:
    """The colour (K, 3) that most photographs agree on at each spot, of those the palette holds.

    Of display colours (V, K, 3), NaN where a spot is not shown; NaN where too few agree.
    """
    shown = np.isfinite(colours[..., 0])
    step = np.clip((np.nan_to_num(colours) * _BINS).astype(int), 0, _BINS - 1)
    matches = shown & palette[step[..., 0], step[..., 1], step[..., 2]]
    values = np.where(matches[..., None], colours, 9.0)
    votes = np.stack(
        [
            (np.abs(values - one).mean(-1) < SAME_COLOUR).sum(0) * is_match
            for one, is_match in zip(values, matches, strict=True)
        ]
    )
    best, spots = votes.argmax(0), np.arange(colours.shape[1])
    near = matches & (np.abs(values - values[best, spots]).mean(-1) < SAME_COLOUR)
    total = np.where(near[..., None], values, 0.0).sum(0)
    common = total / np.maximum(near.sum(0), 1)[:, None]
    enough = votes[best, spots] >= np.maximum(_LEAST_VIEWS, _LEAST_SHARE * shown.sum(0))
    return np.where(enough[:, None], common, np.nan)


def hues_held(colours: Array, certain: Array) -> Mask:
    """Whether colours (K, 3) may be those of a ground, by certain ones (N, 3): shade keeps hue."""
    if not len(certain):
        return np.zeros(len(colours), bool)
    both = (colours + _DARK, certain + _DARK)
    hues, held = (np.log(one / one.mean(-1, keepdims=True)) for one in both)
    number = int(np.ceil(_LEAST_HUE * len(held)))
    distance, _ = cKDTree(held).query(hues, k=[number], p=np.inf, distance_upper_bound=_HUE)
    dim = colours.mean(1) < _DIM * np.median(certain.mean(1))
    return dim | np.isfinite(distance[:, 0])


def pixel_noise(photos: list[ReducedPhoto]) -> float:
    """Standard deviation of what pixels differ by from their neighbours for no reason, display.

    What a second difference along both axes leaves is free of shades and of straight edges
    (Immerkaer 1996, "Fast noise variance estimation"); its lower quartile is free of texture, as
    long as a quarter of the pixels shows none.
    """
    second = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]) / 6.0
    left = []
    for photo in photos:
        inner = binary_erosion(photo.coverage > _NOISE_COVERAGE, np.ones((3, 3), bool))
        planes = np.moveaxis(photo.premultiplied_display, 2, 0)
        left += [np.abs(convolve(plane, second))[inner] for plane in planes]
    values = np.concatenate(left)
    return float(np.quantile(values, 0.25) / ndtri(0.625)) if len(values) else 0.0


class _Solid(NamedTuple):
    """What may block rays: a box that holds it, and its nodes (N,) bool."""

    lattice: Lattice
    inside: Tensor
    low: Array
    high: Array

    @classmethod
    def of(cls, lattice: Lattice, inside: Tensor) -> _Solid:
        grid = inside.view(lattice.shape).numpy()
        held = [np.flatnonzero(grid.any(axis=rest)) for rest in ((1, 2), (0, 2), (0, 1))]
        first = np.array([nodes[0] if len(nodes) else 0 for nodes in held])
        last = np.array([nodes[-1] if len(nodes) else 0 for nodes in held])
        # a node speaks for half a cell about it, one at the border for all that lies beyond
        low, high = (lattice.lower + lattice.cell * end for end in (first - 1.0, last + 1.0))
        low = np.where(first == 0, -np.inf, low)
        return cls(
            lattice, inside, low, np.where(last == np.array(lattice.shape) - 1, np.inf, high)
        )


class PixelRays:
    """Rays through a photograph's pixels P: the `column` (P,) that each meets, if it `meets` any.

    Only covered ones do. `sample` are pixels that are looked at where a sample will do.
    """

    def __init__(self, columns: Columns, photo: ReducedPhoto) -> None:
        self._origins, self._directions = photo.camera.rays(photo.camera.pixel_centres())
        start = columns.plane.local(self._origins)
        self._falling = -self._directions @ columns.plane.axes[2]
        falls = self._falling > 1e-6
        self._reach = start[:, 2] / np.where(falls, self._falling, 1.0)
        spot = columns.plane.local(self._origins + self._reach[:, None] * self._directions)
        node = np.round((spot[:, :2] - columns.low) / columns.spacing)
        on_grid = ((node >= 0) & (node < columns.shape)).all(1)
        node = np.where(on_grid[:, None], node, 0).astype(int)
        self.column = node[:, 0] * columns.shape[1] + node[:, 1]
        covered = photo.coverage.ravel() > _LEAST_COVERAGE
        self.meets = covered & falls & on_grid
        chosen = np.zeros(photo.coverage.shape, bool)
        chosen[::_STEP, ::_STEP] = True
        self.sample = np.flatnonzero(covered & chosen.ravel())

    def unblocked(self, solid: _Solid) -> NDArray[np.int64]:
        """Those of the sample whose rays touch nothing solid above the plane."""
        pixels = self.sample
        if not bool(solid.inside.any()):
            return pixels
        cell = solid.lattice.cell
        origins, directions = self._origins[pixels], self._directions[pixels]
        middle = -(origins * directions).sum(1)
        end = self._reach[pixels] - cell / np.maximum(self._falling[pixels], 1e-6)
        end[~self.meets[pixels]] = np.inf
        steps = np.arange(-1.05, 1.05, cell)
        # only steps before the ground and near what is solid, one more on either side
        inverse = 1.0 / np.where(np.abs(directions) < 1e-9, 1e-9, directions)
        one, two = (solid.low - origins) * inverse, (solid.high - origins) * inverse
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        zero = middle + steps[0]
        first = np.clip((enter - zero) / cell - 1.0, 0, len(steps)).astype(int)
        last = np.clip((np.minimum(leave, end) - zero) / cell + 2.0, 0, len(steps)).astype(int)
        count = np.maximum(last - first, 0)
        ray = np.repeat(np.arange(len(pixels)), count)
        number = np.arange(len(ray)) - np.repeat(np.cumsum(count) - count - first, count)
        distance = middle[ray] + steps[number]
        planes = [o[ray] + distance * d[ray] for o, d in zip(origins.T, directions.T, strict=True)]
        nodes = solid.lattice.nearest(torch.from_numpy(np.stack(planes)).float().T)
        touches = solid.inside.index_select(0, nodes).numpy()
        blocked = np.zeros(len(pixels), bool)
        blocked[ray[touches & (distance < end[ray])]] = True
        return pixels[~blocked]


def find_ground(
    views: Sequence[View], photos: list[ReducedPhoto], hull: Sampled, generator: torch.Generator
) -> tuple[Backdrop, Tensor] | None:
    """The flat ground under the object, and the hull (N,) without the bulge of bare ground.

    A few photographs that agree by chance are right for so many of such a size. Of more and finer
    ones a few always agree, so some far from each other are taken, small.
    """
    plane = detect(photos, *hull, generator)
    if plane is None:
        return None
    positions = np.stack([view.camera.position for view in views])
    chosen = farthest_points(positions, HULL_VIEWS)
    judges = [reduce_view(views[k], _IMAGE_SIDE) for k in chosen]
    ground = Ground(plane, judges, *hull)
    backdrop = Backdrop(ground, judges)
    return backdrop, ground.flatten(*hull, ground.start & ~backdrop.foreign)


class Backdrop:
    """Finds the picture of the ground, and frees the room in front of it.

    `picture` is its display colours at columns' feet, their shape by 3, NaN where unknown;
    `foreign` are columns at whose feet a hue is seen that the ground does not have.
    """

    def __init__(self, ground: Ground, photos: list[ReducedPhoto]) -> None:
        self.ground, self._photos = ground, photos
        columns = ground.columns
        self._rays = [PixelRays(columns, photo) for photo in photos]
        self._spread = max(_SPREAD, _NOISE_WIDTH * pixel_noise(photos))
        bare, shape = ground.start, columns.shape
        spots = np.column_stack([columns.feet, np.zeros(len(columns.feet))])
        colours = colours_at(columns, spots, photos)
        certain = np.flatnonzero(bare)
        blocks = np.where(bare | ~np.isfinite(ground.tops), -1.0, ground.tops)
        floor, plain = np.zeros(len(certain)), np.full_like(colours, np.nan)
        for number, photo in enumerate(photos):
            free = certain[~hidden(columns, blocks, floor, spots[certain], photo)]
            plain[number, free] = colours[number, free]
        known = np.isfinite(plain[..., 0])
        picture = common_colour(colours, ground_palette(plain[known]))
        proven = known.sum(0) > _LEAST_VIEWS
        picture[proven] = np.nanmedian(plain[:, proven], axis=0)
        picture[~(columns.inside.ravel() | proven)] = np.nan
        found = np.isfinite(picture[:, 0])
        self.foreign = np.zeros(shape, bool)
        self.foreign.ravel()[found] = ~hues_held(picture[found], picture[found & bare.ravel()])
        self.picture = picture.reshape(*shape, 3)
        self._keep(np.ones(shape, bool))

    @property
    def known(self) -> Mask:
        """Columns at whose feet the picture of the ground is known."""
        return np.isfinite(self.picture[..., 0])

    def _keep(self, believed: Mask) -> None:
        """Forget what is not believed and what does not hang together with the rim."""
        known = self.known & believed
        self.picture[~(self.ground.joined(known) & known)] = np.nan

    def shown(self) -> list[Mask]:
        """The pixels (H, W) of each photograph whose colour is the ground's where rays meet it."""
        known, window = self.known[..., None], (3, 3, 1)
        low = minimum_filter(np.where(known, self.picture, np.inf), window) - self._spread
        high = maximum_filter(np.where(known, self.picture, -np.inf), window) + self._spread
        low, high, known = low.reshape(-1, 3), high.reshape(-1, 3), known.ravel()
        masks = []
        for photo, own in zip(self._photos, self._rays, strict=True):
            colour = photo.premultiplied_display.reshape(-1, 3)
            fits = ((colour > low[own.column]) & (colour < high[own.column])).all(1)
            masks.append((fits & own.meets & known[own.column]).reshape(photo.coverage.shape))
        return masks

    def clear(self, lattice: Lattice, sdf: Tensor) -> Tensor:
        """Distances (N,) without the room in front of the ground, of such that hold everything."""
        near = sdf < 2.0 * lattice.cell
        height = self.ground.above(lattice.nodes()[near].double().numpy())
        near = near.masked_scatter(near, torch.from_numpy(height > -lattice.cell))
        kept = torch.zeros_like(near)
        for _ in range(_ROUNDS):
            masks = self.shown()
            free = self._freed(lattice, sdf, near & ~kept, masks)
            solid, through = _Solid.of(lattice, free < 0), []
            reached, wrong = np.zeros((2, *self.picture.shape[:2]))
            for rays, mask in zip(self._rays, masks, strict=True):
                pixels = rays.unblocked(solid)
                through.append(np.zeros(mask.size, bool))
                through[-1][pixels] = True
                pixels = pixels[rays.meets[pixels]]
                np.add.at(reached.reshape(-1), rays.column[pixels], 1.0)
                np.add.at(wrong.reshape(-1), rays.column[pixels[~mask.ravel()[pixels]]], 1.0)
            kept |= self._doubted(lattice, (sdf < 0) & (free >= 0), through, masks)
            reached, wrong = 9.0 * uniform_filter(reached, 3), 9.0 * uniform_filter(wrong, 3)
            believed = (wrong <= _DOUBT * reached) | (wrong < _LEAST_VIEWS - 0.5)
            self._keep(believed & ~self.foreign)
        return self._freed(lattice, sdf, near & ~kept, self.shown())

    def _freed(self, lattice: Lattice, sdf: Tensor, where: Tensor, masks: list[Mask]) -> Tensor:
        """Distances (N,) without what stands, at some nodes (N,) bool, before pixels of ground."""
        points = lattice.nodes()[where]
        square = np.ones((3, 3), bool)
        outlines = [(~binary_opening(mask, square)).astype(np.float32) for mask in masks]
        carver = HullCarver([photo.camera for photo in self._photos], outlines)
        outside = torch.stack(list(carver.by_view(points)))
        seen_through = outside.topk(min(_LEAST_VIEWS, len(masks)), dim=0).values[-1]
        height = torch.from_numpy(self.ground.above(points.double().numpy())).float()
        free = sdf.clone()
        free[where] = torch.maximum(sdf[where], torch.minimum(seen_through, height))
        return free

    def _doubted(
        self, lattice: Lattice, freed: Tensor, through: list[Mask], masks: list[Mask]
    ) -> Tensor:
        """Freed nodes (N,), and ones beside, through which too many photographs see no ground."""
        points = lattice.nodes()[freed].double().numpy()
        good, bad = np.zeros((2, len(points)))
        for photo, open_pixels, mask in zip(self._photos, through, masks, strict=True):
            camera = photo.camera
            image, depth = camera.project(points)
            column, row = (np.floor(image / _STEP).astype(np.int64) * _STEP).T
            held = (depth > 0) & (column >= 0) & (row >= 0)
            held &= (column < camera.width) & (row < camera.height)
            pixel = np.where(held, row * camera.width + column, 0)
            is_open, fits = held & open_pixels[pixel], mask.ravel()[pixel]
            good += is_open & fits
            bad += is_open & ~fits
        # single pixels err along silhouettes: the nodes about are asked as well
        votes = torch.zeros(2, lattice.count)
        votes[:, freed] = torch.from_numpy(np.stack([good + bad, bad])).float()
        size = 2 * _VOTE_REACH + 1
        votes = avg_pool3d(votes.view(2, *lattice.shape), size, stride=1, padding=_VOTE_REACH)
        return ((votes[1] > _DOUBT * votes[0]) & (votes[1] > 0)).reshape(-1)
