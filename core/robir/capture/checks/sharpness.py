# SPDX-License-Identifier: Apache-2.0
"""Photographs that are blurred at the object, found by comparison with their neighbours.

Sharpness along a direction d of the picture is the ratio of fine to coarser gradients well inside
the mask,

    q_d^2 = mean (d . grad (G_a * I))^2 / mean (d . grad (G_b * I))^2,   a = 0.5, b = 1.5 pixels,

with G_s a Gaussian of s pixels. How much texture a side of the object has cancels, so that a plain
side does not pass for a blurred one, and the worst of four directions finds motion, too. Measured
on small copies, in which slight blur of a large photograph does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from robir.capture.capture import Bounds, Finding, View
from robir.capture.checks.coverage import directions_to
from robir.capture.frames import Array
from robir.capture.images.loading import resize_view
from robir.capture.refusal import warning
from robir.workers import side_by_side

# ratio to the neighbours' sharpness below which a photograph counts as blurred: sharp ones reach
# 0.78 and more, those blurred by a Gaussian of 2.5 pixels at most 0.73
BLURRED = 0.76
# sharpness that no blurred photograph exceeds: behind a Gaussian of 2.5 pixels white noise has 1.31
SOFT = 1.45
TEXTURED = 0.25  # ratio to the neighbours' coarser gradients below which a side is plain
SIDE = 400  # longer side of the photographs that are compared, pixels, at most
_FINE, _COARSE = 0.5, 1.5
_DIRECTIONS = np.array([[0.0, 1.0], [1.0, 0.0], [0.5**0.5, 0.5**0.5], [0.5**0.5, -(0.5**0.5)]])
_MARGIN = 4  # pixels from the mask's edge that are left out: the silhouette is always sharp
_LEAST = 400
_NEIGHBOURS = 8


def check_sharpness(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """Find photographs much less sharp at the object than those from similar directions."""
    ratios = relative_sharpness([resize_view(view, SIDE) for view in views], bounds)
    blurred = sorted((ratios[i], views[i].name) for i in np.flatnonzero(ratios < BLURRED))
    if not blurred:
        return []
    message = f"{len(blurred)} of {len(views)} photographs are much less sharp at the object than "
    message += "those from similar directions"
    cure = "Leave them out or take them again: a faster shutter, a tripod, the focus on the object."
    names, numbers = [n for _, n in blurred], [round(float(ratio), 3) for ratio, _ in blurred]
    return [warning("blurred", message, cure, *names, sharpness=numbers)]


def relative_sharpness(views: Sequence[View], bounds: Bounds) -> Array:
    """How sharp photographs are at the object against those from similar directions, (V,).

    Infinite where nothing can be said.
    """
    values = np.array(side_by_side(sharpness, views)).reshape(-1, len(_DIRECTIONS) + 1)
    ratios = np.full(len(views), np.inf)
    measured = np.flatnonzero(np.isfinite(values).all(axis=1))
    if len(measured) <= _NEIGHBOURS // 2:
        return ratios
    directions, values = directions_to(views, bounds)[measured], values[measured]
    near = np.argsort(-(directions @ directions.T), axis=1)[:, 1 : _NEIGHBOURS + 1]
    relative = values / np.median(values[near], axis=1)
    # Glitter on one side does not make the other side blurred.
    worst = np.where(values < SOFT, relative, np.inf)[:, :-1].min(axis=1)
    ratios[measured] = np.where(relative[:, -1] > TEXTURED, worst, np.inf)
    return ratios


def sharpness(view: View) -> Array:
    """Sharpness along the four directions, then the coarser gradients in grey levels, (5,).

    All NaN where the mask is too small.
    """
    inside = ndimage.binary_erosion(view.mask >= 250, iterations=_MARGIN)
    if inside.sum() < _LEAST:
        return np.full(len(_DIRECTIONS) + 1, np.nan)
    grey: Array = view.image_display.mean(axis=2, dtype=np.float64)

    def energies(size: float) -> Array:
        slopes = np.gradient(ndimage.gaussian_filter(grey, size))
        along = _DIRECTIONS @ np.stack([slope[inside] for slope in slopes])
        return (along**2).mean(axis=1)

    # A little of the coarse keeps a side without any texture from dividing by nothing.
    fine, coarse = energies(_FINE), energies(_COARSE) + 0.025
    return np.append(np.sqrt(fine / coarse), np.sqrt(coarse.mean()))
