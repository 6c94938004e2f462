# SPDX-License-Identifier: Apache-2.0
"""The ways to spoil a split of photographs, each a function of a value and a random generator."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import grey_dilation, grey_erosion
from scipy.spatial.transform import Rotation

from robir.evaluation.light import read_exr
from robir.maths import tone
from robir.maths.vectors import farthest_points

Picture = NDArray[np.uint8]

_HOLE_RADIUS = 0.04


@dataclass(frozen=True, slots=True, kw_only=True)
class Photographs:
    """The pictures of one split with their cameras."""

    table: dict[str, Any]  # contents of the split's transforms file; one frame a picture
    pictures: tuple[Picture, ...]  # RGBA codes (H, W, 4), straight alpha
    truths: tuple[Path, ...]  # the EXR file of each, with linear radiance and coverage
    curve: tone.AbstractToneCurve  # tone curve that the pictures went through
    exposure: float  # stops added before it

    def with_pictures(self, change: Callable[[Picture], Picture]) -> Photographs:
        """Every picture changed."""
        return replace(self, pictures=tuple(change(picture) for picture in self.pictures))

    def developed(self, stops: NDArray[np.floating[Any]]) -> Photographs:
        """The pictures made again from linear radiance, each so many stops brighter, (V,)."""
        made = [
            _developed(file, self.curve, self.exposure + extra)
            for file, extra in zip(self.truths, stops, strict=True)
        ]
        return replace(self, pictures=tuple(made))


def keep_views(photographs: Photographs, count: float, rng: np.random.Generator) -> Photographs:
    """So many views, each next one the farthest from those kept; fewer are a subset of more."""
    frames = photographs.table["frames"]
    place = np.array([frame["transform_matrix"] for frame in frames])[:, :3, 3]
    kept = farthest_points(place, int(count), first=int(rng.integers(len(frames))))
    return replace(
        photographs,
        table=photographs.table | {"frames": [frames[index] for index in kept]},
        pictures=tuple(photographs.pictures[index] for index in kept),
        truths=tuple(photographs.truths[index] for index in kept),
    )


def turn_cameras(photographs: Photographs, degrees: float, rng: np.random.Generator) -> Photographs:
    """Each camera turned about its own centre; the angles' root mean square is `degrees`."""
    frames = []
    for frame in photographs.table["frames"]:
        pose = np.array(frame["transform_matrix"], float)
        vector = np.radians(degrees) / np.sqrt(3.0) * rng.standard_normal(3)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(vector).as_matrix()
        frames.append(frame | {"transform_matrix": pose.tolist()})
    return replace(photographs, table=photographs.table | {"frames": frames})


def spoil_masks(photographs: Photographs, how: str, rng: np.random.Generator) -> Photographs:
    """Alpha grown or shrunk by a disc of so many pixels, or with so many holes."""
    kind, number = how.split()[0], int(how.split()[1])

    def change(picture: Picture) -> Picture:
        alpha = picture[..., 3]
        if kind == "holes":
            alpha = np.where(_holes(alpha, number, rng), np.uint8(0), alpha)
        else:
            filtered = grey_dilation if kind == "dilate" else grey_erosion
            alpha = filtered(alpha, footprint=_disc(number))
        return np.dstack([picture[..., :3], alpha])

    return photographs.with_pictures(change)


def expose(photographs: Photographs, stops: float, _rng: np.random.Generator) -> Photographs:
    """All pictures brighter by so many stops."""
    return photographs.developed(np.full(len(photographs.pictures), stops))


def jitter(photographs: Photographs, stops: float, rng: np.random.Generator) -> Photographs:
    """Each picture brighter by its own normal number of stops with this standard deviation."""
    return photographs.developed(stops * rng.standard_normal(len(photographs.pictures)))


def change_tone(photographs: Photographs, family: str, _rng: np.random.Generator) -> Photographs:
    """The pictures under another tone curve."""
    other = replace(photographs, curve=tone.curve_from_name(family))
    return other.developed(np.zeros(len(other.pictures)))


def retone(photographs: Photographs, power: float, _rng: np.random.Generator) -> Photographs:
    """The codes of the pictures raised to a power, as an editor's gamma slider does."""

    def change(picture: Picture) -> Picture:
        codes = np.rint(255 * (picture[..., :3] / 255) ** power).astype(np.uint8)
        return np.dstack([codes, picture[..., 3]])

    return photographs.with_pictures(change)


def shrink(photographs: Photographs, width: float, _rng: np.random.Generator) -> Photographs:
    """The pictures at another width, by area averages; cameras follow."""
    table = photographs.table
    factor = int(width) / table["w"]
    size = (int(width), round(table["h"] * factor))
    scaled = {name: table[name] * factor for name in ("fl_x", "fl_y", "cx", "cy")}

    def change(picture: Picture) -> Picture:
        return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))

    return replace(
        photographs.with_pictures(change), table=table | scaled | {"w": size[0], "h": size[1]}
    )


def compress(photographs: Photographs, quality: float, _rng: np.random.Generator) -> Photographs:
    """The pictures after a JPEG of this quality, masks as they were."""

    def change(picture: Picture) -> Picture:
        stream = io.BytesIO()
        Image.fromarray(picture[..., :3]).save(stream, format="JPEG", quality=int(quality))
        with Image.open(stream, formats=["JPEG"]) as image:
            return np.dstack([np.asarray(image), picture[..., 3]])

    return photographs.with_pictures(change)


def add_noise(photographs: Photographs, deviation: float, rng: np.random.Generator) -> Photographs:
    """Gaussian noise on the display values of the object."""

    def change(picture: Picture) -> Picture:
        noise = 255 * deviation * rng.standard_normal((*picture.shape[:2], 3))
        noisy = np.clip(np.rint(picture[..., :3] + noise), 0, 255)
        codes = np.where(picture[..., 3:] > 0, noisy, picture[..., :3]).astype(np.uint8)
        return np.dstack([codes, picture[..., 3]])

    return photographs.with_pictures(change)


def _developed(truth: Path, curve: tone.AbstractToneCurve, stops: float) -> Picture:
    """The picture of a truth file's linear radiance."""
    planes = read_exr(truth)
    radiance = np.stack([planes[f"radiance.{axis}"] for axis in "RGB"], axis=-1)
    linear = torch.from_numpy(np.maximum(radiance, 0.0)) * 2.0**stops
    display = curve.display_from_linear(linear).numpy()
    coverage = np.clip(planes["mask"], 0.0, 1.0)[..., None]
    display = np.where(coverage > 0, display, 0.0)
    rgba = np.concatenate([display, coverage], axis=-1)
    return np.rint(255 * np.clip(rgba, 0.0, 1.0)).astype(np.uint8)


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return x**2 + y**2 <= radius**2


def _holes(alpha: Picture, count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Discs about random object pixels, (H, W)."""
    rows, columns = np.nonzero(alpha > 127)
    y, x = np.mgrid[: alpha.shape[0], : alpha.shape[1]]
    found = np.zeros(alpha.shape, bool)
    for pick in rng.integers(len(rows), size=count) if len(rows) else ():
        reach = _HOLE_RADIUS * alpha.shape[1]
        found |= (y - rows[pick]) ** 2 + (x - columns[pick]) ** 2 <= reach**2
    return found
