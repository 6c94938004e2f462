# SPDX-License-Identifier: Apache-2.0
"""Ground by the photographs: columns whose foot looks the same from everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from robir.geometry.columns import Columns
from robir.geometry.rays import Photo

Array = NDArray[np.float64]

LEAST_VIEWS = 4
"""Views that must see a foot before it is judged."""

AGREEMENT = 0.06
"""Mean deviation from the median colour, display units, that still counts as the same colour."""

STANDING = 0.13
"""Columns at least this high, unit frame, are objects whatever their foot would look like."""


def feet_agree(
    columns: Columns, wanted: NDArray[np.bool_], tops: Array, photos: list[Photo]
) -> NDArray[np.bool_]:
    """Whether the photographs agree on the colour at the feet of columns.

    The foot of bare ground shows one colour to all cameras that see it. Where something stands,
    even something low, its outline appears shifted at the height of the plane, and the
    photographs disagree all along that outline.

    Args:
        columns: Columns over the support plane.
        wanted: Columns to judge, the columns' shape.
        tops: Height of the present surface over each column.
        photos: Photographs.

    Returns:
        The columns' shape; False where not wanted.
    """
    chosen = np.flatnonzero(wanted)
    blocks = np.where(tops >= STANDING, tops, -1.0)
    colours = foot_colours(columns, chosen, photos)
    for number, photo in enumerate(photos):
        colours[number, hidden_feet(columns, blocks, chosen, photo)] = np.nan
    known = np.isfinite(colours[..., 0]).sum(axis=0)
    judged = known >= LEAST_VIEWS
    found = colours[:, judged]
    deviation = np.nanmean(np.abs(found - np.nanmedian(found, axis=0)), axis=(0, 2))
    agree = np.zeros(wanted.size, bool)
    agree[chosen[judged]] = deviation < AGREEMENT
    return agree.reshape(wanted.shape)


def foot_colours(
    columns: Columns, chosen: NDArray[np.int64], photos: list[Photo]
) -> NDArray[np.float32]:
    """Display colours at the feet of columns, as if nothing stood before them.

    Args:
        columns: Columns over the support plane.
        chosen: (K,) flat indices of columns.
        photos: V photographs.

    Returns:
        (V, K, 3), NaN where a photograph does not hold the foot.
    """
    feet = np.concatenate([columns.feet[chosen], np.zeros((len(chosen), 1))], axis=1)
    points = columns.plane.world(feet)
    colours = np.full((len(photos), len(chosen), 3), np.nan, np.float32)
    for number, photo in enumerate(photos):
        image, depth = photo.camera.project(points)
        at = image[:, ::-1].T - 0.5
        covered = map_coordinates(photo.coverage, at, order=1, mode="constant") > 0.9
        values = [
            map_coordinates(photo.premultiplied_display[..., k], at, order=1, mode="nearest")
            for k in range(3)
        ]
        shown = (depth > 0) & covered
        colours[number, shown] = np.stack(values, axis=1)[shown]
    return colours


def hidden_feet(
    columns: Columns, blocks: Array, chosen: NDArray[np.int64], photo: Photo
) -> NDArray[np.bool_]:
    """Whether the lines from feet to a camera pass below the height field of what stands.

    Args:
        columns: Columns over the support plane.
        blocks: Heights of what stands, the columns' shape; negative where nothing does.
        chosen: (K,) flat indices of columns.
        photo: Photograph.

    Returns:
        (K,).
    """
    eye = columns.plane.local(photo.camera.position)
    feet = columns.feet[chosen]
    highest = blocks.max()
    hidden = np.zeros(len(feet), bool)
    if highest <= 0:
        return hidden
    across = eye[:2] - feet
    rise = highest / eye[2]
    for share in np.linspace(0.0, rise, 40):
        spot = (feet + share * across - columns.low) / columns.spacing
        height = map_coordinates(blocks, spot.T, order=0, mode="constant", cval=-1.0)
        hidden |= height > share * eye[2]
    return hidden
