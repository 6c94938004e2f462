# SPDX-License-Identifier: Apache-2.0
"""Photographs and masks from disk: 8-bit, display-referred, one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.frames import Distortion
from robir.capture.images.decode import (
    DEVELOPED,
    deep_codes,
    header,
    load,
    opened,
    orientation,
    reduce,
    upright,
)
from robir.capture.images.linear import LINEAR, coded
from robir.capture.images.opencv import cv2
from robir.capture.images.pixels import Photo, in_srgb, pixels_of
from robir.capture.refusal import refuse
from robir.jobs.paths import replacing
from robir.workers import side_by_side

Bytes = NDArray[np.uint8]
Size = tuple[int, int]

_MESH = 8  # pixels between those at which a lens distortion is evaluated; all but linear between


@dataclass(frozen=True, slots=True)
class StoredPhoto:
    """A photograph that is open and not yet decoded."""

    picture: Image.Image  # as the file holds it
    path: Path  # its file
    orientation: int  # EXIF orientation to apply, 1 to 8
    stated: int  # EXIF orientation that the file states

    @property
    def size(self) -> Size:
        """Width and height in pixels, turned upright, before it is decoded."""
        width, height = self.picture.size
        return (height, width) if self.orientation >= 5 else (width, height)

    def read(self, reduction: int = 1, exposure: float = 1.0) -> Photo:
        """Decode it, reduced by 1, 2, 4 or 8 where that helps; linear values times exposure."""
        is_linear = LINEAR in self.picture.info
        applied = 1 if is_linear else reduce(self.picture, reduction)
        deep = None if is_linear else deep_codes(self.picture, self.path)
        load(self.picture, self.path)
        if is_linear:
            shown, colours = coded(self.picture, exposure), ("linear",)
        else:
            shown, colours = in_srgb(self.picture, deep, self.path)
        photo = pixels_of(upright(shown, self.orientation), self.orientation)
        is_linear = is_linear or DEVELOPED in self.picture.info
        return replace(photo, reduction=applied, colours=colours, is_linear=is_linear)


@contextmanager
def open_photo(
    path: Path, declared: Size | None, is_upright: bool | None = None
) -> Iterator[StoredPhoto]:
    """Open a photograph, turned as EXIF says where `is_upright`; None asks the declared size.

    Programs that write poses with an image size ignore EXIF: it is applied where that is another.
    """
    with header(path) as picture:
        stated = orientation(picture)
        is_upright = picture.size != declared if is_upright is None else is_upright
        yield StoredPhoto(picture, path, stated if is_upright else 1, stated)


def read_mask(path: Path, size: Size, turn: int = 1, is_turned: bool | None = False) -> Bytes:
    """A mask (H, W), 255 on the object, of its own size, turned as told or as sizes tell."""
    with opened(path) as picture:
        picture = upright(picture, orientation(picture))
        turned = upright(picture, turn)
        if is_turned is None:
            is_turned = same_shape(turned.size, size) and not same_shape(picture.size, size)
        photo = pixels_of(turned if is_turned else picture)
    mask = photo.image_display.max(axis=2) if photo.alpha is None else photo.alpha
    return mask * np.uint8(255) if mask.max(initial=0) == 1 else mask


def fitted_mask(mask: Bytes, size: Size) -> Bytes:
    """A mask brought to the size of its photograph, whose shape it has."""
    if mask.shape[::-1] == size:
        return mask
    return np.array(Image.fromarray(mask).resize(size, Image.Resampling.BILINEAR))


def same_shape(one: Size, other: Size) -> bool:
    """Whether two (width, height) differ by a scale and at most a pixel of rounding."""
    return abs(one[0] * other[1] - one[1] * other[0]) <= max(*one, *other)


def size_within(size: Size, max_side: int) -> Size:
    """Width and height of a picture brought down to a longer side of at most `max_side`."""
    scale = min(1.0, max_side / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def shrink(image: Bytes, mask: Bytes, width: int, height: int) -> tuple[Bytes, Bytes]:
    """Area averages of a photograph (H, W, 3), weighted by its mask (H, W), and of that, uint8."""
    if (width, height) == (image.shape[1], image.shape[0]):
        return image, mask
    # A grain of weight keeps the picture where there is no object at all. One layer after another:
    # all at once takes 20 bytes a pixel and more.
    weight, size = mask + np.float32(1e-3), (width, height)
    small = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
    layers = [
        cv2.resize(image[:, :, i] * weight, size, interpolation=cv2.INTER_AREA) / small
        for i in range(3)
    ]
    return _parted(np.clip(np.rint(np.dstack([*layers, small])), 0, 255).astype(np.uint8))


def _parted(layers: Bytes) -> tuple[Bytes, Bytes]:
    return np.ascontiguousarray(layers[:, :, :3]), np.ascontiguousarray(layers[:, :, 3])


def resize_view(view: View, max_side: int) -> View:
    """The view at no more than `max_side` pixels; area averages of the object, camera included."""
    size = size_within((view.camera.width, view.camera.height), max_side)
    image, mask = shrink(view.image_display, view.mask, *size)
    return replace(view, image_display=image, mask=mask, camera=view.camera.resized(*size))


def resize_views(views: Iterable[View], max_side: int) -> tuple[View, ...]:
    """The views so, side by side."""
    return tuple(side_by_side(partial(resize_view, max_side=max_side), views))


def straightened(camera: Camera, distortion: Distortion) -> Camera:
    """The camera without lens distortion, its view so much narrower that no pixel lies outside."""
    lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    zoom = _zoom_without_gaps(lens, distortion)
    return replace(camera, fx=camera.fx * zoom, fy=camera.fy * zoom)


def undistort(
    image: Bytes, mask: Bytes, camera: Camera, distortion: Distortion, straight: Camera
) -> tuple[Bytes, Bytes]:
    """A photograph and its mask, uint8, as a straight camera sees them, by bilinear remapping."""
    # exact in the middle of every few pixels, and one such square beyond the border
    sides = (straight.width, straight.height)
    columns, rows = (_MESH * (np.arange(-1, -(-side // _MESH) + 1) + 0.5) for side in sides)
    middles = np.stack(np.meshgrid(columns, rows), axis=2).reshape(-1, 2)
    at = _distorted_pixels(middles, straight, camera, distortion) - 0.5
    at = at.reshape(len(rows), len(columns), 2).astype(np.float32)
    fine = cv2.resize(at, (_MESH * len(columns), _MESH * len(rows)), interpolation=cv2.INTER_LINEAR)
    where = fine[_MESH : _MESH + straight.height, _MESH : _MESH + straight.width]
    layers = np.dstack([image, mask])
    border = cv2.BORDER_REPLICATE
    return _parted(cv2.remap(layers, where, None, cv2.INTER_LINEAR, borderMode=border))


def _distorted_pixels(
    pixels: NDArray[np.float64], straight: Camera, camera: Camera, distortion: Distortion
) -> NDArray[np.float64]:
    """Where points of the undistorted picture lie in the photograph, (N, 2) pixels."""
    plain = (pixels - [straight.cx, straight.cy]) / [straight.fx, straight.fy]
    bent = np.stack(distortion.apply(*plain.T), axis=1)
    return bent * [camera.fx, camera.fy] + [camera.cx, camera.cy]


@lru_cache
def _zoom_without_gaps(
    lens: tuple[int, int, float, float, float, float], distortion: Distortion
) -> float:
    """Smallest focal factor from 1 on whose picture's border lies in the photograph."""
    width, height, fx, fy, cx, cy = lens
    camera = Camera(
        camera_to_world=np.eye(4), width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy
    )
    u, v = np.linspace(0.0, width, 65), np.linspace(0.0, height, 65)
    sides = [np.stack([u, np.full(65, edge)], axis=1) for edge in (0.0, float(height))]
    sides += [np.stack([np.full(65, edge), v], axis=1) for edge in (0.0, float(width))]
    border, middle = np.concatenate(sides), np.array([cx, cy])
    # Along every ray from the middle the distorted radius has to grow.
    fan = (middle + np.linspace(0.0, 1.0, 17)[:, None, None] * (border - middle)).reshape(-1, 2)

    def fits(zoom: float) -> bool:
        straight = replace(camera, fx=fx * zoom, fy=fy * zoom)
        at = _distorted_pixels(border, straight, camera, distortion)
        if not ((at >= -0.5) & (at <= np.array([width, height]) + 0.5)).all():
            return False
        bent = _distorted_pixels(fan, straight, camera, distortion).reshape(17, len(border), 2)
        return bool((np.diff(np.linalg.norm(bent - bent[0], axis=2), axis=0) > 0).all())

    for zoom in np.geomspace(1.0, 2.0, 141):
        if fits(float(zoom)):
            return float(zoom)
    message = "The lens distortion folds the picture over itself: "
    message += f"radial {distortion.radial}, rational {distortion.rational}, "
    message += f"tangential {distortion.tangential}, skew {distortion.skew:g}"
    cure = "Undistort the photographs (for example with `colmap image_undistorter`) "
    raise refuse("distortion", message, cure + "and give that folder.")


PREVIEW_SIDE = 160  # longer side of each of the two pictures, pixels
PREVIEW_GREY = 48  # grey behind the object, display value


def save_preview(path: Path, photo: NDArray[np.uint8], rendering: NDArray[np.uint8]) -> None:
    """Write a photograph and its rendering, (H, W, 4) display RGBA each, side by side as PNG."""
    size = size_within((photo.shape[1], photo.shape[0]), PREVIEW_SIDE)
    sheet = Image.new("RGB", (2 * size[0], size[1]), (PREVIEW_GREY,) * 3)
    for column, picture in enumerate((photo, rendering)):
        small = Image.fromarray(picture, "RGBA").resize(size, Image.Resampling.BOX)
        sheet.paste(small, (column * size[0], 0), small)
    with replacing(path) as temporary:
        sheet.save(temporary, format="PNG", compress_level=1)
