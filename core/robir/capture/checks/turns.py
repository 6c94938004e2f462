# SPDX-License-Identifier: Apache-2.0
"""Whether poses and masks are for photographs as stored or as their EXIF data turns them.

Programs differ in this. Sizes tell where width and height change places. Where they do not (square
photographs, half turns, mirrors), both are tried: the masks of the right one have an object in
common, and its photographs show the same points alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robir.capture.bounds import Hull, sphere_from_masks
from robir.capture.capture import Finding, Split, View
from robir.capture.checks.uneven_exposure import sight
from robir.capture.frames import LINEAR_SUFFIXES, RAW_SUFFIXES, Array, Frame, FrameSet
from robir.capture.images.decode import header, orientation, stored_size
from robir.capture.images.loading import same_shape
from robir.capture.masks.given import without_ignoring
from robir.capture.refusal import CaptureRefusedError, note, refuse
from robir.capture.views import load_views, unheard

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
