# SPDX-License-Identifier: Apache-2.0
"""From which directions photographs are missing, and which are blurred beside their neighbours.

Sharpness along a direction d of the picture is the ratio of fine to coarser gradients well inside
the mask,

    q_d^2 = mean (d . grad (G_a * I))^2 / mean (d . grad (G_b * I))^2,   a = 0.5, b = 1.5 pixels,

with G_s a Gaussian of s pixels. How much texture a side of the object has cancels, so that a plain
side does not pass for a blurred one, and the worst of four directions finds motion, too. Measured
on small copies, in which slight blur of a large photograph does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robir.capture.capture import Bounds, Finding, View
from robir.capture.frames import Array
from robir.capture.images.loading import resize_view
from robir.capture.images.opencv import cv2
from robir.capture.refusal import note, warning
from robir.workers import side_by_side

WIDE_GAP = 60.0  # degrees without a camera around a direction that count as a side not photographed
_SEEN = 30.0  # degrees around a camera that count as photographed
_MISSING = 45.0  # degrees around a camera beyond which a direction counts as missing
_BELOW = -15.0  # elevation in degrees under which nothing is missed: objects stand on something
_SAMPLES = 500


def directions_to(views: Sequence[View], bounds: Bounds) -> Array:
    """Unit vectors from the object's centre to the cameras, (V, 3), capture frame."""
    offsets = np.array([view.camera.position - bounds.centre for view in views])
    return offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-12)


def upwards(views: Sequence[View]) -> Array:
    """The direction most nearly at right angles to the rows of all pictures, unit, (3,)."""
    axes = np.array([view.camera.camera_to_world[:3, :3] for view in views])
    _, vectors = np.linalg.eigh(np.einsum("vi,vj->ij", axes[:, :, 0], axes[:, :, 0]))
    up = vectors[:, 0]
    return up if up @ axes[:, :, 1].sum(axis=0) >= 0 else -up


def check_coverage(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """How much of the sphere of directions is photographed, and where most is missing.

    One finding, whose numbers are: `seen_share`, of the directions above -15 degrees those within
    30 degrees of a camera, in [0, 1]; `gap_degrees`, the widest angle to the nearest camera;
    `gap_direction`, the unit vector in the capture's frame that it belongs to; `up`, unit; and
    `missing`, unit vectors (N, 3) farther than 45 degrees from every camera.
    """
    cameras, up = directions_to(views, bounds), upwards(views)
    sphere = _spread(_SAMPLES)
    sphere = sphere[sphere @ up >= np.sin(np.radians(_BELOW))]
    angles = np.degrees(np.arccos(np.clip((sphere @ cameras.T).max(axis=1), -1.0, 1.0)))
    widest = int(np.argmax(angles))
    gap, direction = float(angles[widest]), sphere[widest]
    share = float((angles <= _SEEN).mean())
    nearest = views[int(np.argmax(cameras @ direction))].name
    elevation = float(np.degrees(np.arcsin(np.clip(direction @ up, -1.0, 1.0))))
    message = (
        f"Photographs look at {100 * share:.0f} % of the object's sides above the ground from "
        f"within {_SEEN:.0f} degrees; the widest gap is {gap:.0f} degrees from the nearest "
        f"photograph, {nearest}, {_words(elevation)}"
    )
    numbers: dict[str, Any] = {"seen_share": round(share, 3), "gap_degrees": round(gap, 1)}
    vectors = {"gap_direction": direction, "up": up, "missing": sphere[angles > _MISSING]}
    numbers |= {key: np.round(vector, 4).tolist() for key, vector in vectors.items()}
    if gap <= WIDE_GAP:
        return [note("coverage", message, **numbers)]
    cure = "Add photographs from there; what no photograph shows is guessed."
    return [warning("coverage-gap", message, cure, nearest, **numbers)]


def _words(elevation: float) -> str:
    if elevation > 60:
        return "from above"
    height = "at the height of the object" if abs(elevation) < 15 else f"{elevation:.0f} degrees up"
    return height if elevation > -15 else f"{-elevation:.0f} degrees down"


def _spread(count: int) -> Array:
    """Directions spread evenly over the sphere by the golden angle, (count, 3), without torch."""
    steps = np.arange(count) + 0.5
    z = 1 - 2 * steps / count
    turn = np.pi * (3 - np.sqrt(5)) * steps
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


BLURRED = 0.76  # least ratio to the neighbours: sharp ones have 0.78, blurs of 2.5 pixels 0.73
SOFT = 1.45  # no blurred photograph is above: behind a Gaussian of 2.5 pixels white noise has 1.31
TEXTURED = 0.25  # ratio to the neighbours' coarser gradients below which a side is plain
_SHARP_SIDE = 400  # longer side of the photographs that are compared, pixels, at most
_FINE, _COARSE = 0.5, 1.5
_DIRECTIONS = np.array([[0.0, 1.0], [1.0, 0.0], [0.5**0.5, 0.5**0.5], [0.5**0.5, -(0.5**0.5)]])
_MARGIN = 4  # pixels from the mask's edge that are left out: the silhouette is always sharp
_LEAST = 400
_AROUND = 8  # pixels about the object that its filtered picture takes
_NEIGHBOURS = 8


def check_sharpness(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """Find photographs much less sharp at the object than those from similar directions."""
    ratios = relative_sharpness([resize_view(view, _SHARP_SIDE) for view in views], bounds)
    blurred = sorted((ratios[i], views[i].name) for i in np.flatnonzero(ratios < BLURRED))
    if not blurred:
        return []
    message = f"{len(blurred)} of {len(views)} photographs are much less sharp at the object than "
    message += "those from similar directions"
    cure = "Leave them out or take them again: a faster shutter, a tripod, the focus on the object."
    names, numbers = [n for _, n in blurred], [round(float(ratio), 3) for ratio, _ in blurred]
    return [warning("blurred", message, cure, *names, sharpness=numbers)]


def relative_sharpness(views: Sequence[View], bounds: Bounds) -> Array:
    """Sharpness at the object against photographs from like directions, (V,), or infinite."""
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
    """Sharpness in four directions, then coarser gradients, (5,); NaN where the mask is small."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    whole = (view.mask >= 250).astype(np.uint8)
    inside = cv2.erode(whole, cross, iterations=_MARGIN, borderValue=0) > 0
    if inside.sum() < _LEAST:
        return np.full(len(_DIRECTIONS) + 1, np.nan)
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    frame = tuple(slice(max(0, at[0] - _AROUND), at[-1] + 1 + _AROUND) for at in (rows, columns))
    inside = inside[frame]
    grey = view.image_display[frame].mean(axis=2, dtype=np.float32)

    def energies(size: float) -> Array:
        smooth = cv2.GaussianBlur(grey, (0, 0), size, borderType=cv2.BORDER_REFLECT)
        along = _DIRECTIONS @ np.stack([slope[inside] for slope in np.gradient(smooth)])
        return (along**2).mean(axis=1)

    # A little of the coarse keeps a side without any texture from dividing by nothing.
    fine, coarse = energies(_FINE), energies(_COARSE) + 0.025
    return np.append(np.sqrt(fine / coarse), np.sqrt(coarse.mean()))
