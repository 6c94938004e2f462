# SPDX-License-Identifier: Apache-2.0
"""One photograph from its file to a view: decoded once, cut to the object, undistorted, reduced.

Pixels are for the object, not for its surroundings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robir.capture.bounds import INSIDE
from robir.capture.camera import Box, Camera
from robir.capture.capture import Split, View
from robir.capture.frames import Distortion, Frame, rigid
from robir.capture.images.decode import undone
from robir.capture.images.loading import (
    Bytes,
    Photo,
    Size,
    StoredPhoto,
    fitted_mask,
    open_photo,
    read_mask,
    same_shape,
    shrink,
    size_within,
    straightened,
    undistort,
)
from robir.capture.images.opencv import cv2
from robir.capture.refusal import refuse

# width of the strip of background that is kept about the object, against the longer side of what is
# kept: the outline is soft, and what lies beside it tells what is empty
MARGIN = 0.05
LEAST_SAVED = 0.25  # share of the photograph's longer side that cutting must take off to be done
_NEVER_CUT = 256  # longer side of photographs, pixels, that no stage reduces
_OVERVIEW_SIDE = 192  # longer side of small copies by which a distorted object is found, pixels
_SPARE = 1.25  # least pixels that are decoded, along a side, for one that is kept


# the mask of a photograph of some size, (H, W) uint8: as photographed, at any size, while there is
# no photograph; else at the size that this was decoded to
MaskSource = Callable[[Photo | None, Size], Bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What became of one photograph."""

    view: View  # cut to the object and reduced; its mask is full where there is none
    has_mask: bool  # whether anything says which pixels are the object
    is_turned: bool  # whether an EXIF orientation was applied
    colours: tuple[str, ...]  # what was found of its colours, and done, for the user
    is_linear: bool  # whether it went through no tone curve but sRGB's


def read_view(
    frame: Frame,
    split: Split,
    given: Path | MaskSource | None,
    max_side: int,
    exposure: float = 1.0,
) -> Reading:
    """Read a photograph, `max_side` pixels about the object, by a given mask, its own or alpha."""
    with open_photo(frame.image, frame.lens.size, frame.is_upright) as stored:
        size = stored.size
        _check_size(size, frame)
        given = given or frame.mask
        source = _drawn(given, stored, frame) if isinstance(given, Path) else given
        photo = stored.read(_reduction(size, source, max_side), exposure)
    camera = _reduced(frame.lens.camera(rigid(frame.camera_to_world), *size), photo)
    mask = photo.alpha if source is None else source(photo, size)
    image, bent = photo.image_display, frame.lens.distortion
    picture = _Picture(image, np.full_like(image[:, :, 0], 255) if mask is None else mask, camera)
    part = picture.part(bent, picture.box(bent) if max(size) > _NEVER_CUT else None, max_side)
    layers = {"image_display": part.image, "mask": part.mask, "camera": part.camera}
    return Reading(
        view=View(name=frame.name, split=split, **layers),
        has_mask=mask is not None,
        is_turned=photo.orientation != 1,
        colours=photo.colours,
        is_linear=photo.is_linear,
    )


def object_box(mask: Bytes) -> Box | None:
    """The box of the object by its mask (H, W), with a margin; None where that saves little."""
    inside = mask >= INSIDE
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    height, width = mask.shape
    margin = math.ceil(MARGIN * (max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1))
    left, right = max(0, columns[0] - margin), min(width, columns[-1] + 1 + margin)
    top, bottom = max(0, rows[0] - margin), min(height, rows[-1] + 1 + margin)
    if max(right - left, bottom - top) > (1.0 - LEAST_SAVED) * max(width, height):
        return None
    return int(left), int(top), int(right), int(bottom)


def _check_size(size: Size, frame: Frame) -> None:
    declared = frame.lens.size
    if declared is None or size == declared:
        return
    if not (frame.lens.is_scalable and same_shape(size, declared)):
        message = f"{frame.image} is {size[0]}x{size[1]} pixels, but its pose is for "
        cure = "Give the photographs the poses were made for, or correct the stated size."
        sides = f"{declared[0]}x{declared[1]}"
        raise refuse("wrong-size", message + sides, cure, frame.image.name)


def _drawn(path: Path, stored: StoredPhoto, frame: Frame) -> MaskSource:
    is_turned, turn = None, stored.orientation
    if frame.is_mask_upright is not None:
        is_turned = frame.is_mask_upright != frame.is_upright
        turn = undone(stored.stated) if frame.is_mask_upright else stored.stated
    mask = read_mask(path, stored.size, turn, is_turned)
    height, width = mask.shape
    if not same_shape((width, height), stored.size):
        message = f"The mask {path} is {width}x{height} pixels, but its photograph "
        message += f"{stored.path.name} is {stored.size[0]}x{stored.size[1]}"
        cure = "Draw the mask on the photograph itself, uncropped."
        raise refuse("wrong-size", message, cure, path.name)
    return drawn_mask(mask)


def drawn_mask(mask: Bytes) -> MaskSource:
    """The mask (h, w) of a photograph of its shape."""
    return lambda photo, _: mask if photo is None else fitted_mask(mask, photo.size)


def _reduction(size: Size, source: MaskSource | None, max_side: int) -> int:
    """By how much a photograph of some size may be reduced while it is decoded."""
    share = 1.0
    if source is not None:
        outline = source(None, size)
        box = object_box(outline)
        if box is not None:
            share = max(box[2] - box[0], box[3] - box[1]) / max(outline.shape)
    side = share * max(size)
    wanted = _SPARE * min(side, max_side)
    return next(factor for factor in (8, 4, 2, 1) if factor == 1 or side / factor >= wanted)


def _reduced(camera: Camera, photo: Photo) -> Camera:
    """The camera of a photograph that was reduced while it was decoded."""
    if photo.reduction == 1:
        return camera
    exact = {name: getattr(camera, name) / photo.reduction for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, width=photo.size[0], height=photo.size[1], **exact)


@dataclass(frozen=True, slots=True)
class _Picture:
    """Pixels, their mask and their camera, lens distortion aside."""

    image: Bytes
    mask: Bytes
    camera: Camera

    @property
    def size(self) -> Size:
        return self.camera.width, self.camera.height

    def shrunk(self, size: Size) -> _Picture:
        return _Picture(*shrink(self.image, self.mask, *size), self.camera.resized(*size))

    def straight(self, distortion: Distortion, camera: Camera) -> _Picture:
        """As another camera sees it, without the distortion."""
        return _Picture(*undistort(self.image, self.mask, self.camera, distortion, camera), camera)

    def box(self, distortion: Distortion) -> Box | None:
        """The part to keep, undistorted; a small copy tells it where the lens distorts."""
        if distortion.is_null:
            return object_box(self.mask)
        width, height = size = size_within(self.size, _OVERVIEW_SIDE)
        mask = cv2.resize(self.mask, size, interpolation=cv2.INTER_AREA)
        small = _Picture(np.dstack([mask] * 3), mask, self.camera.resized(*size))
        found = object_box(small.straight(distortion, straightened(small.camera, distortion)).mask)
        if found is None:
            return None
        left, top, right, bottom = found
        x, y = self.size[0] / width, self.size[1] / height
        end = min(self.size[0], math.ceil(right * x)), min(self.size[1], math.ceil(bottom * y))
        return math.floor(left * x), math.floor(top * y), *end

    def part(self, distortion: Distortion, box: Box | None, max_side: int) -> _Picture:
        """A part of it, or the whole, undistorted and at most `max_side` pixels long."""
        width, height = self.size if box is None else (box[2] - box[0], box[3] - box[1])
        target = size_within((width, height), max_side)
        if distortion.is_null:
            return (self if box is None else self._cut(box)).shrunk(target)
        # Remapping at twice the final size costs little and blurs nothing that will be kept.
        between = (min(width, 2 * target[0]), min(height, 2 * target[1]))
        if box is None:
            picture = self.shrunk(between)
            camera = straightened(picture.camera, distortion)
        else:
            scale = between[0] / width
            picture = self.shrunk((round(self.size[0] * scale), round(self.size[1] * scale)))
            camera = straightened(self.camera, distortion).part(box).resized(*between)
        return picture.straight(distortion, camera).shrunk(target)

    def _cut(self, box: Box) -> _Picture:
        part = np.s_[box[1] : box[3], box[0] : box[2]]
        image, mask = np.ascontiguousarray(self.image[part]), np.ascontiguousarray(self.mask[part])
        return _Picture(image, mask, self.camera.part(box))
