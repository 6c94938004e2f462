# SPDX-License-Identifier: Apache-2.0
"""Ground by the photographs: columns whose foot looks the same from everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from robir.geometry.ground.columns import Columns
from robir.geometry.rays import Photo

Array = NDArray[np.float64]


_LEAST_VIEWS = 4  # photographs that must see a spot before it is judged
SAME_COLOUR = 0.06  # mean difference of display colours up to which they count as the same
# by how much less photographs must differ, display, about a surface than about the foot below it
# for the surface to be believed: a plate's rim is, what is left before bare ground not
_LEAD = 0.01
# by how much what hides a spot must be higher than the surface over the spot's own column, in
# steps between columns. A plate's rim hides the ground beside it, and a lump left beside the rim
# must not be asked by photographs that see the rim; but lumps do not speak for each other.
_TALLER = 2.0
_LINE_STEPS = 40  # steps of the line from a spot to a camera that may be hidden
_LEAST_COVERAGE = 0.9  # above which a mask holds a spot
_DARK = 0.02  # added to display colours before their hue is taken, which is noise in the dark


def hue_of(colours: Array) -> Array:
    """Logarithms of the channels of display colours (..., 3) against their mean.

    Args:
        colours: Display.
    """
    light = colours + _DARK
    return np.log(light / light.mean(-1, keepdims=True))


def feet_agree(
    columns: Columns,
    wanted: NDArray[np.bool_],
    tops: Array,
    photos: list[Photo],
) -> NDArray[np.bool_]:
    """Whether the photographs agree on the colour at the feet of columns.

    The foot of bare ground shows one colour to all cameras that see it. Where something stands,
    even something low, its outline appears shifted at the height of the plane, and the
    photographs disagree all along that outline, more than they do about the surface itself.

    Args:
        columns: Columns over the support plane.
        wanted: Columns to judge, the columns' shape.
        tops: Height of the present surface over each column.
        photos: Photographs.

    Returns:
        The columns' shape; False where not wanted.
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
    columns: Columns,
    wanted: NDArray[np.bool_],
    heights: Array,
    tops: Array,
    photos: list[Photo],
) -> Array:
    """How much the photographs differ on the colour of spots over columns.

    Args:
        columns: Columns over the support plane.
        wanted: Columns to judge, the columns' shape.
        heights: Height of each column's spot above the plane, finite where wanted.
        tops: Height of the present surface over each column; what stands hides spots.
        photos: Photographs.

    Returns:
        Mean difference from the median display colour, the columns' shape; NaN where not wanted or
        where too few photographs show the spot.
    """
    chosen = np.flatnonzero(wanted)
    spots = np.column_stack([columns.feet[chosen], heights.ravel()[chosen]])
    over = tops.ravel()[chosen] + _TALLER * columns.spacing
    colours = colours_at(columns, spots, photos)
    for number, photo in enumerate(photos):
        colours[number, hidden(columns, tops, over, spots, photo)] = np.nan
    judged = np.isfinite(colours[..., 0]).sum(axis=0) >= _LEAST_VIEWS
    found = colours[:, judged]
    result = np.full(wanted.size, np.nan)
    result[chosen[judged]] = np.nanmean(np.abs(found - np.nanmedian(found, axis=0)), axis=(0, 2))
    return result.reshape(wanted.shape)


def colours_at(columns: Columns, spots: Array, photos: list[Photo]) -> NDArray[np.float32]:
    """Display colours at spots near the plane, as if nothing stood before them.

    Args:
        columns: Columns over the support plane.
        spots: (K, 3) in the plane's frame.
        photos: V photographs.

    Returns:
        (V, K, 3), NaN where a photograph does not hold the spot.
    """
    points = columns.plane.world(spots)
    colours = np.full((len(photos), len(spots), 3), np.nan, np.float32)
    for number, photo in enumerate(photos):
        image, depth = photo.camera.project(points)
        at = image[:, ::-1].T - 0.5
        covered = map_coordinates(photo.coverage, at, order=1, mode="constant")
        values = [
            map_coordinates(photo.premultiplied_display[..., k], at, order=1, mode="nearest")
            for k in range(3)
        ]
        shown = (depth > 0) & (covered > _LEAST_COVERAGE)
        colours[number, shown] = np.stack(values, axis=1)[shown]
    return colours


def hidden(
    columns: Columns,
    tops: Array,
    over: Array,
    spots: Array,
    photo: Photo,
) -> NDArray[np.bool_]:
    """Whether the lines from spots to a camera pass below the height field of what stands.

    Args:
        columns: Columns over the support plane.
        tops: Heights of what stands, the columns' shape; negative where nothing does.
        over: (K,) height above which a column must reach to hide a spot.
        spots: (K, 3) in the plane's frame.
        photo: Photograph.

    Returns:
        (K,).
    """
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
