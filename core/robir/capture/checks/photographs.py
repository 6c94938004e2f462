# SPDX-License-Identifier: Apache-2.0
"""Whether photographs were exposed alike, and whether poses are for them as EXIF data turns them.

Exposures are compared by what the camera wrote, and at points of the masks' visual hull, before
there is a surface: good enough in the median, while single points go wrong.

Programs differ in whether poses are for photographs as stored or as EXIF turns them. Sizes tell
where width and height change places. Where they do not (square photographs, half turns, mirrors),
both are tried: the masks of the right one have an object in common, and its photographs show the
same points alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robir.capture.bounds import INSIDE, Hull, kept, silhouette, sphere_from_masks
from robir.capture.capture import Bounds, Finding, Split, View
from robir.capture.checks.coverage import directions_to
from robir.capture.frames import LINEAR_SUFFIXES, RAW_SUFFIXES, Array, Frame, FrameSet
from robir.capture.images.decode import exif_values, header, orientation, stored_size
from robir.capture.images.loading import resize_view, same_shape
from robir.capture.masks.given import without_ignoring
from robir.capture.refusal import CaptureRefusedError, note, refuse, some, warning
from robir.capture.views import load_views, unheard

POWER = 2.2  # of display values, that stands for the tone curve while it is not known
SIGHT_SIDE = 400  # longer side of the photographs that are looked at, pixels, at most
SETTINGS_SPREAD = 0.15  # stops of exposure between the camera's settings that are let pass
# stops (standard deviation) by which neighbouring photographs may differ over the whole object:
# 0.07 under one light and exposure, 0.28 with exposures off by up to half a stop
BRIGHTNESS_SPREAD = 0.15
# stops (standard deviation) by which photographs may differ at the same points: 0.1, or 0.15 where
# the visual hull is far from the object, under one light and exposure; else 0.24
POINT_SPREAD = 0.2

_GRID, _SIGHT_POINTS = 40, 1500
_FRONTAL = 0.3  # cosine to the view direction from which a hull's normal is worth something
_DARKEST = 0.02
_TIME, _APERTURE, _SPEED, _FLASH = 33434, 33437, 34855, 37385
_FIRED = 1
_FEWEST_VIEWS = 18  # views from which nine coefficients can be separated from jitter
_FLOOR = 1e-3
_CURE = "Photograph with exposure and white balance locked (manual mode) and all lamps left alone."


def check_settings(photographs: Sequence[Path]) -> list[Finding]:
    """Compare exposures and flash as EXIF states them, where two or more photographs do."""
    stated = {path.name: _settings(path) for path in photographs}
    fired = [name for name, (_, flash) in stated.items() if flash]
    message = f"The flash fired in {len(fired)} of {len(photographs)} photographs: its light "
    message += "and reflections move with the camera"
    cure = "Photograph without flash, under light that stays where it is."
    found = some("warning", "flash-fired", fired, message, cure)
    stops = {name: value for name, (value, _) in stated.items() if value is not None}
    spread = max(stops.values(), default=0.0) - min(stops.values(), default=0.0)
    if spread > SETTINGS_SPREAD:
        middle = float(np.median(list(stops.values())))
        apart = sorted(stops, key=lambda name: -abs(stops[name] - middle))
        far = [name for name in apart if abs(stops[name] - middle) > 0.5 * SETTINGS_SPREAD]
        message = "The camera's exposure (time, aperture and sensitivity) differs by "
        message += f"{spread:.1f} stops between photographs; {len(far)} of {len(photographs)} "
        numbers = {"spread_steps": round(spread, 3)}
        found.append(warning("exposure-settings", message + "are off", _CURE, *far, **numbers))
    return found


def _settings(path: Path) -> tuple[float | None, bool]:
    """Exposure in stops (log2 of time times sensitivity over squared aperture), and the flash."""
    try:
        with header(path) as picture:
            tags: dict[int, Any] = exif_values(picture) or {}
        flash = bool(int(tags.get(_FLASH, 0)) & _FIRED)
        speed = tags.get(_SPEED)
        speed = speed[0] if isinstance(speed, tuple) else speed
        gain = float(tags[_TIME]) * float(speed or 0) / float(tags[_APERTURE]) ** 2
    except (CaptureRefusedError, ValueError, TypeError, LookupError, ArithmeticError):
        return None, False
    return (float(np.log2(gain)) if 0 < gain < np.inf else None), flash


def check_brightness(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """Compare the object's brightness between photographs; at most one finding."""
    offsets = uneven_exposures(views, bounds, sight(views, bounds))
    if offsets is None:
        return []
    spread = float(offsets.std())
    order = np.argsort(-np.abs(offsets))
    far = [views[i].name for i in order if abs(offsets[i]) > POINT_SPREAD]
    outliers = f" ({len(far)} of {len(views)} stand out)" if far else ""
    message = f"The object's brightness changes by {spread:.2f} stops between photographs of the "
    message += f"same places{outliers}: exposure, white balance or the light changed"
    return [warning("brightness-changes", message, _CURE, *far, spread_steps=round(spread, 3))]


def uneven_exposures(views: Sequence[View], bounds: Bounds, brightness: Array) -> Array | None:
    """How much brighter than the others each photograph is, stops (V,), where that is uneven.

    Two measures have to agree, as each has objects that deceive it. Points of the object are off by
    the exposure in the median; that fails where the visual hull is no surface. And under one light
    the mean brightness of the object is a smooth function of the direction it is seen from, which
    nine spherical harmonics fit; that fails for hard light on plain objects. `brightness` is that
    of `sight`.
    """
    if len(views) < _FEWEST_VIEWS:
        return None
    basis = _harmonics(directions_to(views, bounds))
    levels = np.array([_brightness_of(view) for view in views])
    hat = basis @ np.linalg.pinv(basis)
    left = np.maximum(1 - np.diag(hat), 0.1)
    smooth = float(((levels - hat @ levels) / np.sqrt(left)).std())
    offsets = exposure_offsets(brightness)
    apart = smooth > BRIGHTNESS_SPREAD and float(offsets.std()) > POINT_SPREAD
    return offsets if apart else None


def exposure_offsets(brightness: Array) -> Array:
    """Median brightness of photographs against others at their points, stops (V,); 0 below ten."""
    brightness = brightness[np.isfinite(brightness).sum(axis=1) >= 4]
    offsets = np.zeros(brightness.shape[1])
    comparable = np.isfinite(brightness).sum(axis=0) >= 10
    if not comparable.any():
        return offsets
    for _ in range(5):
        points = np.nanmedian(brightness - offsets, axis=1, keepdims=True)
        offsets[comparable] = np.nanmedian((brightness - points)[:, comparable], axis=0)
    offsets[comparable] -= np.median(offsets[comparable])
    return offsets


def _brightness_of(view: View) -> float:
    inside = view.mask >= 250
    pixels = view.image_display[inside if inside.any() else slice(None)]
    means = ((pixels.reshape(-1, 3) / 255.0) ** POWER).mean(axis=0)
    return float(np.log2(means + _FLOOR).mean())


def _harmonics(directions: Array) -> Array:
    """Real spherical harmonics to the second order, not normalised, (N, 9)."""
    x, y, z = directions.T
    second = [x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y]
    return np.stack([np.ones_like(x), x, y, z, *second], axis=1)


def sight(views: Sequence[View], bounds: Bounds) -> Array:
    """Brightness (P, V) in stops at some 1500 points of the masks' hull; NaN where not shown."""
    views = [resize_view(view, SIGHT_SIDE) for view in views]
    inside = _hull(views, bounds)
    half = bounds.radius / _GRID
    cells = np.argwhere(inside & ~ndimage.binary_erosion(inside))
    cells = cells[:: max(1, len(cells) // _SIGHT_POINTS)]
    slope = np.gradient(ndimage.gaussian_filter(inside.astype(np.float64), 1.5))
    normals = -np.stack([part[tuple(cells.T)] for part in slope], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    points = bounds.centre + half * (2 * cells + 1 - _GRID)
    brightness = np.full((len(points), len(views)), np.nan)
    for number, view in enumerate(views):
        towards = view.camera.position - points
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        seen = (normals * towards).sum(axis=1) > _FRONTAL
        for step in np.arange(2.5, 0.75 * _GRID):
            along = np.rint(cells + step * towards).astype(np.int64)
            within = ((along >= 0) & (along < _GRID)).all(axis=1)
            seen &= ~(within & inside[tuple(np.clip(along, 0, _GRID - 1).T)])
        pixels, depth = view.camera.project(points)
        limits = (view.camera.width - 1, view.camera.height - 1)
        column, row = np.clip(pixels, 0, limits).astype(np.int64).T
        seen &= view.camera.in_picture(pixels, depth) & (view.mask[row, column] >= 250)
        grey = ((view.image_display / 255.0) ** POWER).mean(axis=2)
        grey = ndimage.gaussian_filter(grey, 0.7 * max(1.0, view.camera.width / 120))
        brightness[seen, number] = np.log2(grey[row, column][seen] + _DARKEST)
    return brightness


def _hull(views: Sequence[View], bounds: Bounds) -> NDArray[np.bool_]:
    """Cells of a cube about the sphere that at most a twentieth of the masks call background."""
    ticks = np.linspace(-1 + 1 / _GRID, 1 - 1 / _GRID, _GRID) * bounds.radius
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    masks = [(view.camera, view.mask >= INSIDE) for view in views]
    outlines = [silhouette(camera, mask) for camera, mask in masks if mask.any()]
    inside = kept(outlines, grid + bounds.centre, 0.0, int(0.05 * len(outlines)))
    return inside.reshape(_GRID, _GRID, _GRID)


Chosen = list[tuple[Frame, Split]]

_SIDE = 160  # longer side of the photographs that are tried, pixels
_MOST = 24  # photographs that are tried
_POINTS = 5000  # sparse points that are looked at
# pixels within which a point that is so much farther away than another is hidden by it
_CELL, _BEHIND = 6, 1.05
_AGREE = 0.03  # share of a mask by which masks have to agree better to decide
_ALIKE = 0.9  # variance of brightness at the same points, against the other turn's, that decides


@dataclass(frozen=True, slots=True)
class _Turn:
    """What the poses, and the masks, are for: photographs upright (True) or as stored."""

    poses: bool
    masks: bool

    def of(self, chosen: Chosen) -> Chosen:
        return [
            (replace(frame, is_upright=self.poses, is_mask_upright=self.masks), split)
            for frame, split in chosen
        ]

    def __str__(self) -> str:
        poses, masks = (("as stored", "upright")[which] for which in (self.poses, self.masks))
        return f"poses are for photographs {poses}, masks are drawn on photographs {masks}"


def prepared(
    frames: FrameSet, chosen: Chosen, drawn: Mapping[str, Path]
) -> tuple[Chosen, dict[str, Path], list[Finding]]:
    """Frames that know what they are for, masks by name, `drawn` ones first, and findings."""
    chosen, masks, findings = without_ignoring(chosen, drawn)
    exif = {f.name: found for f, _ in chosen if (found := _exif_turn(f)) is not None}
    turns = [_Turn(poses, of_masks) for poses in (False, True) for of_masks in (False, True)]
    own = {f.name: masks.get(f.name) or f.mask for f, _ in chosen if f.name in exif}
    for frame, _ in chosen:
        if frame.name in exif:
            turns = [t for t in turns if _fits(t, frame, own[frame.name], *exif[frame.name])]
    has_masks = any(own.values())
    turns = [turn for turn in turns if has_masks or turn.poses == turn.masks]
    if not exif or not turns:
        return chosen, masks, findings
    found = turns[0] if len(turns) == 1 else _tried(turns, frames, chosen, masks, list(exif))
    if has_masks or len(turns) > 1:
        message = f"EXIF data turns {len(exif)} photographs: {found}"
        findings.append(note("exif-turn", message, *exif))
    return found.of(chosen), masks, findings


def _exif_turn(frame: Frame) -> tuple[int, tuple[int, int]] | None:
    """EXIF orientation and stored size of a photograph that is not stored upright."""
    if frame.image.suffix.lower() in (*RAW_SUFFIXES, *LINEAR_SUFFIXES):
        return None
    try:
        with header(frame.image) as picture:
            turn = orientation(picture)
            return None if turn == 1 else (turn, picture.size)
    except CaptureRefusedError:
        return None


def _fits(turn: _Turn, frame: Frame, mask: Path | None, exif: int, stored: tuple[int, int]) -> bool:
    """Whether sizes allow a photograph's pose and mask to be for what is said."""
    sizes = {False: stored, True: stored[::-1] if exif >= 5 else stored}
    declared, lens = sizes[turn.poses], frame.lens
    if frame.is_upright is not None and frame.is_upright != turn.poses:
        return False
    is_scaled = lens.is_scalable and lens.size is not None and same_shape(declared, lens.size)
    if lens.size not in (None, declared) and not is_scaled:
        return False
    drawn = None if mask is None else stored_size(mask)
    return drawn is None or same_shape(drawn, sizes[turn.masks])


def _tried(
    turns: Sequence[_Turn],
    frames: FrameSet,
    chosen: Chosen,
    masks: Mapping[str, Path],
    turned: list[str],
) -> _Turn:
    """The turn under which masks, and photographs, agree."""
    few = chosen[:: -(-len(chosen) // _MOST)]
    loaded = [load_views(turn.of(few), masks, _SIDE, unheard) for turn in turns]
    if all(any(finding.level == "error" for finding in one.findings) for one in loaded):
        raise CaptureRefusedError(loaded[0].findings)
    hulls = [
        None if one.maskless else sphere_from_masks(one.views, frames.sphere) for one in loaded
    ]
    shares = [0.0 if hull is None else hull.strict for hull in hulls]
    left = [i for i, share in enumerate(shares) if share >= max(shares) - _AGREE]
    if len(left) > 1:
        spread = {i: _spread(_brightness(loaded[i].views, hulls[i], frames.points)) for i in left}
        left = [i for i in left if spread[i] <= min(spread.values()) / _ALIKE]
    if len(left) != 1:
        message = f"EXIF data turns {len(turned)} photographs, and neither sizes nor masks nor "
        message += "what they show tell whether poses are for photographs as stored or turned"
        cure = "Save the photographs with the turn applied or without EXIF data, as the program "
        cure += "that found the poses saw them."
        raise refuse("exif-orientation", message, cure, *turned)
    return turns[left[0]]


def _brightness(views: Sequence[View], hull: Hull | None, points: Array) -> Array:
    """Brightness of points of the object, or of the sparse points, (P, V); NaN where not seen."""
    if hull is not None:
        return sight(views, hull.sphere)
    result = np.full((len(points[:_POINTS]), len(views)), np.nan)
    for number, view in enumerate(views):
        pixels, depth = view.camera.project(points[:_POINTS])
        seen = np.flatnonzero(view.camera.in_picture(pixels, depth))
        column, row = pixels[seen].astype(np.int64).T
        # what lies behind others is hidden
        cell = row // _CELL * view.camera.width + column // _CELL
        nearest = np.full(view.mask.size, np.inf)
        np.minimum.at(nearest, cell, depth[seen])
        shown = depth[seen] < _BEHIND * nearest[cell]
        grey = view.image_display.mean(axis=2)[row, column]
        result[seen[shown], number] = grey[shown]
    return result


def _spread(brightness: Array) -> float:
    """Variance at the same points against that of all, 1 where there is nothing to compare."""
    rows = brightness[np.isfinite(brightness).sum(axis=1) > 1]
    total = float(np.nanvar(rows)) if rows.size else 0.0
    return float(np.nanvar(rows, axis=1).mean()) / total if total > 0 else 1.0
