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
from scipy.stats import norm
from torch import Tensor
from torch.nn.functional import avg_pool3d

from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.photo_consistency import SAME_COLOUR, colours_at, hidden, hue_of
from robir.geometry.ground.pixel_rays import SAMPLE_STEP, PixelRays, Solid, pixels_of
from robir.geometry.hull import HullCarver
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.rays import Photo

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
_VOTE_REACH = 2  # nodes to each side whose photographs decide about a node with its own
_ROUNDS = 2  # how often the picture of the ground is checked against what was freed with it


def ground_palette(colours: NDArray[np.floating]) -> Mask:
    """Display colours the ground may have, those seen and their darker shades.

    Args:
        colours: (N, 3) display colours of spots known to be ground.

    Returns:
        (bins, bins, bins) bool, one step wider than the colours on every side.
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
    """The colour that most photographs agree on at each spot, of those the palette holds.

    Args:
        colours: (V, K, 3) display colours; NaN where a photograph does not show the spot.
        palette: Result of `ground_palette`.

    Returns:
        (K, 3), NaN where too few photographs agree.
    """
    shown = np.isfinite(colours[..., 0])
    step = np.clip((np.nan_to_num(colours) * _BINS).astype(int), 0, _BINS - 1)
    likely = shown & palette[step[..., 0], step[..., 1], step[..., 2]]
    values = np.where(likely[..., None], colours, 9.0)
    votes = np.stack(
        [
            (np.abs(values - one).mean(-1) < SAME_COLOUR).sum(0) * is_likely
            for one, is_likely in zip(values, likely, strict=True)
        ]
    )
    best, spots = votes.argmax(0), np.arange(colours.shape[1])
    near = likely & (np.abs(values - values[best, spots]).mean(-1) < SAME_COLOUR)
    total = np.where(near[..., None], values, 0.0).sum(0)
    common = total / np.maximum(near.sum(0), 1)[:, None]
    enough = votes[best, spots] >= np.maximum(_LEAST_VIEWS, _LEAST_SHARE * shown.sum(0))
    return np.where(enough[:, None], common, np.nan)


def hues_held(colours: Array, certain: Array) -> Mask:
    """Whether colours may be those of a ground, lit or shaded: light shade keeps the hue, nearly.

    Args:
        colours: (K, 3) display colours, finite.
        certain: (N, 3) display colours of spots known to be ground.

    Returns:
        (K,); all False without certain ground.
    """
    if not len(certain):
        return np.zeros(len(colours), bool)
    hues, held = hue_of(colours), hue_of(certain)
    number = int(np.ceil(_LEAST_HUE * len(held)))
    distance, _ = cKDTree(held).query(hues, k=[number], p=np.inf, distance_upper_bound=_HUE)
    dim = colours.mean(1) < _DIM * np.median(certain.mean(1))
    return dim | np.isfinite(distance[:, 0])


def colours_about(picture: Array, side: int, slack: float) -> tuple[Array, Array]:
    """Range of the ground's colours about each column.

    Args:
        picture: Display colours at the feet of the columns, their shape by 3; NaN where unknown.
        side: Columns along the edge of the square that is looked at.
        slack: By how much the range is widened at either end, display.

    Returns:
        Lowest and highest colours, shape of the picture; infinite where nothing is known.
    """
    known, window = np.isfinite(picture[..., :1]), (side, side, 1)
    low = minimum_filter(np.where(known, picture, np.inf), window) - slack
    high = maximum_filter(np.where(known, picture, -np.inf), window) + slack
    return low, high


def pixel_noise(photos: list[Photo], least_coverage: float) -> float:
    """Standard deviation of what pixels differ by from their neighbours for no reason, display.

    What a second difference along both axes leaves is free of shades and of straight edges
    (Immerkaer 1996, "Fast noise variance estimation"); its lower quartile is free of texture, as
    long as a quarter of the pixels shows none.

    Args:
        photos: Photographs.
        least_coverage: Above which a pixel shows nothing but what the mask encloses.

    Returns:
        At least 0; 0 where no photograph shows nine pixels in a square.
    """
    second = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]) / 6.0
    left = []
    for photo in photos:
        inner = binary_erosion(photo.coverage > least_coverage, np.ones((3, 3), bool))
        planes = np.moveaxis(photo.premultiplied_display, 2, 0)
        left += [np.abs(convolve(plane, second))[inner] for plane in planes]
    values = np.concatenate(left)
    return float(np.quantile(values, 0.25) / norm.ppf(0.625)) if len(values) else 0.0


def ground_pixels(
    picture: Array, photos: list[Photo], rays: list[PixelRays], spread: float
) -> list[Mask]:
    """Pixels that show ground: their colour is that of the ground where their rays meet it.

    Args:
        picture: Display colours at the feet of the columns, their shape by 3; NaN where unknown.
        photos: Photographs.
        rays: Rays of each photograph's pixels.
        spread: How far a pixel may lie outside the range of the ground's colours about its spot.

    Returns:
        (H, W) of each photograph.
    """
    known = np.isfinite(picture[..., 0])
    low, high = (end.reshape(-1, 3) for end in colours_about(picture, 3, spread))
    masks = []
    for photo, own in zip(photos, rays, strict=True):
        colour = photo.premultiplied_display.reshape(-1, 3)
        fits = ((colour > low[own.column]) & (colour < high[own.column])).all(1)
        fits &= own.meets & known.ravel()[own.column]
        masks.append(fits.reshape(photo.coverage.shape))
    return masks


def near_ground(ground: Ground, lattice: Lattice, sdf: Tensor) -> Tensor:
    """Nodes (N,) bool that are solid or nearly so and not below the ground."""
    near = sdf < 2.0 * lattice.cell
    height = ground.above(lattice.nodes()[near].double().numpy())
    return near.masked_scatter(near, torch.from_numpy(height > -lattice.cell))


def freed(
    field: Sampled,
    where: Tensor,
    ground: Ground,
    photos: list[Photo],
    masks: list[Mask],
) -> Tensor:
    """A field without what stands in the room through which photographs see ground.

    Args:
        field: Lattice and signed distances (N,), on the CPU.
        where: (N,) bool, nodes that may be freed.
        ground: The ground; what lies below it stays.
        photos: Photographs.
        masks: Pixels of the photographs that show ground.

    Returns:
        The new signed distances (N,).
    """
    lattice, sdf = field
    points = lattice.nodes()[where]
    height = ground.above(points.double().numpy())
    silhouettes = [
        (~binary_opening(mask, np.ones((3, 3), bool))).astype(np.float32) for mask in masks
    ]
    carver = HullCarver([photo.camera for photo in photos], silhouettes)
    outside = torch.stack(list(carver.by_view(points)))
    enough = min(_LEAST_VIEWS, len(photos))
    seen_through = outside.topk(enough, dim=0).values[-1]
    room = torch.minimum(seen_through, torch.from_numpy(height).float())
    free = sdf.clone()
    free[where] = torch.maximum(sdf[where], room)
    return free


class Backdrop:
    """Finds the picture of the ground, and frees the room in front of it.

    Args:
        ground: The ground and what of it is bare for certain.
        photos: Photographs.

    Attributes:
        ground: The ground.
        photos: The photographs.
        rays: Rays of each photograph's pixels.
        spread: How far pixels may lie outside the range of the ground's colours, display.
        picture: Its display colours at columns' feet, their shape by 3; NaN where unknown.
        foreign: Columns at whose feet a hue is seen that the ground does not have.
    """

    def __init__(self, ground: Ground, photos: list[Photo]) -> None:
        self.ground = ground
        self.photos = photos
        columns = ground.columns
        self.rays = [PixelRays(columns, photo) for photo in photos]
        noise = pixel_noise(photos, _NOISE_COVERAGE)
        self.spread = max(_SPREAD, _NOISE_WIDTH * noise)
        bare, shape = ground.start, columns.shape
        spots = np.column_stack([columns.feet, np.zeros(len(columns.feet))])
        colours = colours_at(columns, spots, photos)
        certain = np.flatnonzero(bare)
        blocks = np.where(bare | ~np.isfinite(ground.tops), -1.0, ground.tops)
        floor, plain = np.zeros(len(certain)), np.full_like(colours, np.nan)
        for number, photo in enumerate(photos):
            is_hidden = hidden(columns, blocks, floor, spots[certain], photo)
            free = certain[~is_hidden]
            plain[number, free] = colours[number, free]
        known = np.isfinite(plain[..., 0])
        picture = common_colour(colours, ground_palette(plain[known]))
        proven = known.sum(0) > _LEAST_VIEWS
        picture[proven] = np.nanmedian(plain[:, proven], axis=0)
        picture[~(columns.inside.ravel() | proven)] = np.nan
        found = np.isfinite(picture[:, 0])
        self.foreign = np.zeros(shape, bool)
        held = hues_held(picture[found], picture[found & bare.ravel()])
        self.foreign.ravel()[found] = ~held
        self.picture = picture.reshape(*shape, 3)
        self._keep(np.ones(shape, bool))

    def _keep(self, believed: Mask) -> None:
        """Forget what is not believed and what does not hang together with the rim."""
        known = self.known & believed
        self.picture[~(self.ground.joined(known) & known)] = np.nan

    @property
    def known(self) -> Mask:
        """Columns at whose feet the picture of the ground is known."""
        return np.isfinite(self.picture[..., 0])

    def shown(self) -> list[Mask]:
        """The pixels of each photograph that show ground, each (H, W)."""
        return ground_pixels(self.picture, self.photos, self.rays, self.spread)

    def clear(self, lattice: Lattice, sdf: Tensor) -> Tensor:
        """Free the room in front of the ground.

        Args:
            lattice: Nodes.
            sdf: (N,) signed distances that hold everything, on the CPU.

        Returns:
            The new signed distances (N,).
        """
        near = near_ground(self.ground, lattice, sdf)
        kept = torch.zeros_like(near)
        for _ in range(_ROUNDS):
            masks = self.shown()
            free = self._cut(lattice, sdf, near & ~kept, masks)
            reached, wrong = np.zeros(self.picture.shape[:2]), np.zeros(self.picture.shape[:2])
            through = []
            solid = Solid(lattice, free < 0)
            for rays, mask in zip(self.rays, masks, strict=True):
                pixels = rays.unblocked(solid, rays.sample)
                through.append(np.zeros(mask.shape, bool))
                through[-1].reshape(-1)[pixels] = True
                pixels = pixels[rays.meets[pixels]]
                np.add.at(reached.reshape(-1), rays.column[pixels], 1.0)
                np.add.at(wrong.reshape(-1), rays.column[pixels[~mask.ravel()[pixels]]], 1.0)
            kept |= self._doubted(lattice, (sdf < 0) & (free >= 0), through, masks)
            reached, wrong = 9.0 * uniform_filter(reached, 3), 9.0 * uniform_filter(wrong, 3)
            believed = wrong <= _DOUBT * reached
            believed |= wrong < _LEAST_VIEWS - 0.5
            self._keep(believed & ~self.foreign)
        return self._cut(lattice, sdf, near & ~kept, self.shown())

    def _cut(self, lattice: Lattice, sdf: Tensor, where: Tensor, masks: list[Mask]) -> Tensor:
        """The field (N,) freed at some nodes (N,) bool."""
        return freed(Sampled(lattice, sdf), where, self.ground, self.photos, masks)

    def _doubted(
        self, lattice: Lattice, freed: Tensor, through: list[Mask], masks: list[Mask]
    ) -> Tensor:
        """Freed nodes through which too many photographs see what is not ground.

        Args:
            lattice: Nodes.
            freed: (N,) bool.
            through: Pixels that nothing solid blocks any more, of those that were looked at.
            masks: Pixels that show ground.

        Returns:
            (N,) bool; nodes next to freed ones may be among them.
        """
        points = lattice.nodes()[freed].double().numpy()
        good, bad = np.zeros(len(points)), np.zeros(len(points))
        for photo, open_pixels, mask in zip(self.photos, through, masks, strict=True):
            # the nearest of the pixels that were looked at
            pixel = pixels_of(photo.camera, points, SAMPLE_STEP)
            is_open = (pixel >= 0) & open_pixels.ravel()[pixel]
            fits = mask.ravel()[pixel]
            good += is_open & fits
            bad += is_open & ~fits
        # single pixels err along silhouettes: the nodes about are asked as well
        votes = torch.zeros(2, lattice.count)
        votes[:, freed] = torch.from_numpy(np.stack([good + bad, bad])).float()
        votes = avg_pool3d(
            votes.view(2, *lattice.shape), 2 * _VOTE_REACH + 1, stride=1, padding=_VOTE_REACH
        )
        return ((votes[1] > _DOUBT * votes[0]) & (votes[1] > 0)).reshape(-1)
