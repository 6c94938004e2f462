# SPDX-License-Identifier: Apache-2.0
"""Flat parts of the ground at another height than its plane: a mat, a tray, a turntable.

Such a step is less than a cell of the field and as flat as the ground: nothing in the surface tells
it from noise. The photographs do: at a wrong height their pictures of a texture or of a shadow's
edge are shifted against each other. So the ground is moved up and down as a whole (Collins 1996, "A
space-sweep approach to true multi-image matching"). Plain parts say nothing by themselves; but what
has one hue is one thing, and lies at one height. What reaches the ground's rim lies in its plane,
which was found there.

Batch letters: H heights, V photographs, K columns.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    distance_transform_edt,
    label,
    median_filter,
)
from skimage.segmentation import watershed

from robir.geometry.ground.columns import Columns
from robir.geometry.ground.photo_consistency import LEAST_VIEWS, TALLER, colours_at, hidden, hue_of
from robir.geometry.rays import Photo
from robir.maths.vectors import farthest_points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

HEIGHTS = np.arange(-4, 5) / 4
"""Heights that are tried, steps between columns. What is higher the fit finds by itself."""

PLANE = len(HEIGHTS) // 2
"""Which of them is the plane's."""

VIEWS = 20
"""Photographs that are asked, far from each other."""

SAME_HUE = 0.08
"""Difference of hue between the columns on either side of one that may be of one part."""

CORE, LEAST_CORE = 2, 30
"""A part has a core so many columns inside its borders, of at least so many columns."""

ASIDE = 2
"""Columns next to what stands on the ground, whose feet it hides from some photographs, are not
asked."""

LESS, CERTAIN = 0.08, 2.0
"""By what share less, and by how many standard errors, the photographs must differ at another
height than at the plane's: more than of a flat ground."""

BLOCK = 8
"""Columns along the edge of the squares the standard error is taken of: neighbours err alike."""


def terraces(columns: Columns, ground: Mask, tops: Array, photos: list[Photo]) -> Array:
    """Height of the ground over each column.

    Args:
        columns: Columns over the support plane.
        ground: Columns that are bare ground, the columns' shape.
        tops: Height of the present surface over each column.
        photos: Photographs.

    Returns:
        The columns' shape, unit frame; 0 where the ground lies in its plane. What is not bare has
        the height of the nearest that is.
    """
    level = np.zeros(columns.shape)
    if not ground.any():
        return level
    eyes = np.stack([photo.camera.position for photo in photos])
    asked = [photos[k] for k in farthest_points(eyes, VIEWS)]
    heights = HEIGHTS * columns.spacing
    differ, picture = _sweep(columns, ground, tops, heights, asked)
    parts = _parts(picture, ground)
    inner = binary_erosion(ground, np.ones((3, 3), bool), ASIDE) & np.isfinite(differ).all(0)
    rim = ground & ~binary_erosion(columns.inside, np.ones((3, 3), bool), CORE)
    left = set(np.unique(parts[inner])) - {0} - set(np.unique(parts[rim]))
    while left:
        sure = [part for part in left if _is_raised(differ, inner & (parts == part))]
        if not sure:
            break
        first = max(sure, key=lambda part: int((inner & (parts == part)).sum()))
        area = _with_neighbours(first, left, parts, inner, differ)
        left -= set(np.unique(parts[area]))
        level[area] = _lowest(heights, differ[:, area & inner].mean(axis=1))
    nearest = distance_transform_edt(~ground, return_distances=False, return_indices=True)
    return level[tuple(nearest)]


def _sweep(
    columns: Columns, ground: Mask, tops: Array, heights: Array, photos: list[Photo]
) -> tuple[Array, Array]:
    """How much photographs differ with the ground at each height, and its picture in the plane.

    A photograph counts for a column where it shows it at all heights.

    Returns:
        (H, *columns' shape) medians of the differences from the median display colour, and display
        colours, the columns' shape by 3; NaN where too few photographs show a column.
    """
    chosen = np.flatnonzero(ground)
    feet = columns.feet[chosen]
    spots = [np.column_stack([feet, np.full(len(feet), height)]) for height in heights]
    colours = np.stack([colours_at(columns, own, photos) for own in spots])
    over = tops.ravel()[chosen] + TALLER * columns.spacing
    for number, photo in enumerate(photos):
        colours[:, number, hidden(columns, tops, over, spots[PLANE], photo)] = np.nan
    shown = np.isfinite(colours[..., 0]).all(axis=0)
    colours[:, ~shown | (shown.sum(axis=0) < LEAST_VIEWS)] = np.nan
    with warnings.catch_warnings():
        # columns that too few photographs show have no median
        warnings.simplefilter("ignore", RuntimeWarning)
        common = np.nanmedian(colours, axis=1)
        apart = np.nanmedian(np.abs(colours - common[:, None]).mean(-1), axis=1)
    differ = np.full((len(heights), ground.size), np.nan)
    differ[:, chosen] = apart
    picture = np.full((ground.size, 3), np.nan)
    picture[chosen] = common[PLANE]
    return differ.reshape(-1, *columns.shape), picture.reshape(*columns.shape, 3)


def _parts(picture: Array, ground: Mask) -> NDArray[np.int32]:
    """Parts of the ground that have one hue each: their numbers, 0 elsewhere."""
    hue = median_filter(hue_of(np.nan_to_num(picture)), (3, 3, 1))
    change = np.zeros(ground.shape)
    for axis in (0, 1):
        between = np.abs(np.roll(hue, -1, axis) - np.roll(hue, 1, axis)).max(-1)
        within = np.roll(ground, -1, axis) & np.roll(ground, 1, axis)
        change = np.maximum(change, np.where(within, between, 0.0))
    core = binary_erosion((change < SAME_HUE) & ground, np.ones((3, 3), bool), CORE)
    cores, _ = label(core)
    cores[np.bincount(cores.ravel())[cores] < LEAST_CORE] = 0
    return watershed(change, cores, mask=ground)


def _is_raised(differ: Array, part: Mask) -> bool:
    """Whether the photographs surely differ less about a part that lies off the plane."""
    at = differ[:, part].mean(axis=1)
    best = int(at.argmin())
    if not 0 < best < len(at) - 1 or at[PLANE] - at[best] < LESS * at[PLANE]:
        return False
    gain = (differ[PLANE] - differ[best])[part]
    row, column = np.nonzero(part)
    _, block = np.unique([row // BLOCK, column // BLOCK], axis=1, return_inverse=True)
    sums = np.bincount(block, gain)
    error = np.sqrt(((sums - sums.mean()) ** 2).sum())
    return bool(gain.sum() > CERTAIN * error)


def _with_neighbours(
    first: int, left: set[int], parts: NDArray[np.int32], inner: Mask, differ: Array
) -> Mask:
    """A raised part and those joined to it about which photographs do not differ more there."""
    area = parts == first
    best = int(differ[:, area & inner].mean(axis=1).argmin())
    while True:
        around = set(np.unique(parts[binary_dilation(area, np.ones((3, 3), bool)) & ~area])) & left
        fits = [
            part
            for part in around
            if (differ[best] - differ[PLANE])[inner & (parts == part)].mean() <= 0.0
        ]
        if not fits:
            return area
        area |= np.isin(parts, fits)


def _lowest(heights: Array, at: Array) -> float:
    """Height at which a parabola through the lowest of differences (H,) is lowest."""
    best = int(np.clip(at.argmin(), 1, len(at) - 2))
    before, least, after = at[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    aside = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(heights[best] + np.clip(aside, -1.0, 1.0) * (heights[1] - heights[0]))
