# SPDX-License-Identifier: Apache-2.0
"""Captures made worse on purpose: one factor at a time, from a rendered capture with truth.

Nothing is rendered again. Poses, masks and pictures are changed; what a change leaves alone is a
hard link to the original, the truth always is. Exposure and tone curve start from the linear
radiance that the truth keeps. Evaluation goes by the test views' truth, so their cameras and size
are never touched; their pictures are, where a user's whole set of photographs would be.

| factor       | value                                   | what happens |
|--------------|-----------------------------------------|-----------------------------------------|
| `views`      | number                                  | that many training views, far apart |
| `pose noise` | degrees                                 | cameras turn about themselves |
| `mask`       | "dilate PX", "erode PX", "holes N"      | alpha grows, shrinks or gets N holes |
| `exposure`   | stops                                   | all pictures brighter or darker |
| `jitter`     | stops                                   | each picture its own exposure |
| `tone`       | name of a family                        | another tone curve |
| `resolution` | pixels                                  | width of the training pictures |
| `jpeg`       | quality 1..95                           | pictures go through a JPEG |
| `noise`      | standard deviation of display values    | Gaussian noise |
"""

from __future__ import annotations

import io
import json
import os
import shutil
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

from robir.errors import ConfigError
from robir.evaluation.truth import read_exr
from robir.jobs.paths import read_json, replacing, write_json
from robir.maths import tone

Picture = NDArray[np.uint8]
Value = float | str

_HOLE_RADIUS = 0.04


@dataclass(frozen=True, slots=True, kw_only=True)
class Photographs:
    """The pictures of one split with their cameras.

    Attributes:
        table: Contents of the split's transforms file; one frame a picture.
        pictures: RGBA codes (H, W, 4), straight alpha.
        truths: The EXR file of each, with linear radiance and coverage.
        curve: Tone curve that the pictures went through.
        exposure: Stops added before it.
    """

    table: dict[str, Any]
    pictures: tuple[Picture, ...]
    truths: tuple[Path, ...]
    curve: tone.AbstractToneCurve
    exposure: float

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


Change = Callable[[Photographs, Any, np.random.Generator], Photographs]


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """Something that may be wrong with a capture.

    Attributes:
        change: Makes the photographs worse by a value.
        is_of_tests: Whether the test views' pictures suffer too.
        check: Whether a value makes sense.
        wanted: What values make sense, for people.
    """

    change: Change
    is_of_tests: bool
    check: Callable[[Any], bool]
    wanted: str


def keep_views(photographs: Photographs, count: float, rng: np.random.Generator) -> Photographs:
    """So many views, each next one the farthest from those kept; fewer are a subset of more."""
    frames = photographs.table["frames"]
    place = np.array([frame["transform_matrix"] for frame in frames])[:, :3, 3]
    kept = [int(rng.integers(len(frames)))]
    distance = np.linalg.norm(place - place[kept[0]], axis=1)
    while len(kept) < min(int(count), len(frames)):
        kept.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(place - place[kept[-1]], axis=1))
    kept.sort()
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
        with Image.open(stream) as image:
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


def _is_number(low: float, high: float) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, float) and low <= value <= high


def _is_mask_error(value: Any) -> bool:
    words = value.split() if isinstance(value, str) else []
    known = len(words) == 2 and words[0] in ("dilate", "erode", "holes")
    return known and words[1].isdecimal() and 1 <= int(words[1]) <= 64


def _is_family(value: Any) -> bool:
    return value in {curve.name for curve in tone.families()}


FACTORS: dict[str, Factor] = {
    "views": Factor(
        change=keep_views, is_of_tests=False, check=_is_number(1, 1e5), wanted="a number of views"
    ),
    "pose noise": Factor(
        change=turn_cameras, is_of_tests=False, check=_is_number(0, 90), wanted="degrees"
    ),
    "mask": Factor(
        change=spoil_masks,
        is_of_tests=True,
        check=_is_mask_error,
        wanted='"dilate PIXELS", "erode PIXELS" or "holes NUMBER"',
    ),
    "exposure": Factor(
        change=expose, is_of_tests=True, check=_is_number(-10, 10), wanted="stops, -10 to 10"
    ),
    "jitter": Factor(
        change=jitter, is_of_tests=True, check=_is_number(0, 5), wanted="stops, 0 to 5"
    ),
    "tone": Factor(
        change=change_tone, is_of_tests=True, check=_is_family, wanted="the name of a tone family"
    ),
    "resolution": Factor(
        change=shrink, is_of_tests=False, check=_is_number(16, 1e5), wanted="a width in pixels"
    ),
    "jpeg": Factor(
        change=compress, is_of_tests=True, check=_is_number(1, 95), wanted="a quality, 1 to 95"
    ),
    "noise": Factor(
        change=add_noise,
        is_of_tests=True,
        check=_is_number(0, 1),
        wanted="a standard deviation of display values, 0 to 1",
    ),
}
"""What `robir stability` can sweep, by the name in a plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """One value of one factor.

    Attributes:
        source: Rendered capture with truth.
        factor: Name in FACTORS.
        value: How much of it.
    """

    source: Path
    factor: str
    value: Value

    def __post_init__(self) -> None:
        """Refuse factors and values that make no sense."""
        if self.factor not in FACTORS:
            raise ConfigError(f"factor {self.factor!r} is unknown; known: {', '.join(FACTORS)}")
        factor = FACTORS[self.factor]
        if not factor.check(self.value):
            raise ConfigError(f"factor {self.factor}: {self.value!r} is not {factor.wanted}")

    @property
    def label(self) -> str:
        """The value as written on charts."""
        return self.value if isinstance(self.value, str) else f"{self.value:g}"

    def make(self, out: Path, seed: int) -> None:
        """Write the worse capture; it appears whole or not at all, and stays if it is there.

        Args:
            out: Folder of the new capture.
            seed: Of everything random in it.
        """
        if out.exists():
            return
        partial = out.with_name(f".{out.name}")
        shutil.rmtree(partial, ignore_errors=True)
        _link_tree(self.source / "truth", partial / "truth")
        scene = read_json(self.source / "truth" / "scene.json")
        if self.factor == "tone":
            curve = tone.curve_from_name(str(self.value))
            scene["view_transform"] = curve.blender_view_transform or curve.name
            write_json(partial / "truth" / "scene.json", scene)
        rng = np.random.default_rng(seed)
        factor = FACTORS[self.factor]
        for split in ("train", "test"):
            before = _load(self.source, split)
            is_meant = split == "train" or factor.is_of_tests
            after = factor.change(before, self.value, rng) if is_meant else before
            _save(self.source, partial, split, before, after)
        partial.replace(out)


def _load(source: Path, split: str) -> Photographs:
    scene = read_json(source / "truth" / "scene.json")
    table = json.loads((source / f"transforms_{split}.json").read_text(encoding="utf-8"))
    names = [Path(frame["file_path"]).name for frame in table["frames"]]
    pictures = []
    for name in names:
        with Image.open(source / split / f"{name}.png") as image:
            pictures.append(np.asarray(image.convert("RGBA")))
    return Photographs(
        table=table,
        pictures=tuple(pictures),
        truths=tuple(source / "truth" / split / f"{name}.exr" for name in names),
        curve=_curve_of(scene["view_transform"]),
        exposure=float(scene.get("exposure", 0.0)),
    )


def _save(source: Path, out: Path, split: str, before: Photographs, after: Photographs) -> None:
    """Write a split; a picture that is the very one of before is a link to its file."""
    (out / split).mkdir(parents=True)
    write_json(out / f"transforms_{split}.json", after.table)
    originals = {id(picture) for picture in before.pictures}
    for frame, picture in zip(after.table["frames"], after.pictures, strict=True):
        name = f"{Path(frame['file_path']).name}.png"
        if id(picture) in originals:
            _link(source / split / name, out / split / name)
        else:
            with replacing(out / split / name) as temporary:
                Image.fromarray(picture).save(temporary, format="PNG")


def _link_tree(source: Path, out: Path) -> None:
    for file in sorted(source.rglob("*")):
        if file.is_file():
            target = out / file.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            _link(file, target)


def _link(source: Path, target: Path) -> None:
    """A hard link, or a copy where the file system has none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def _curve_of(view_transform: str) -> tone.AbstractToneCurve:
    """The curve that stands for a view transform of Blender, or for a family of ours."""
    for curve in tone.families():
        if view_transform in (curve.blender_view_transform, curve.name):
            return curve
    raise ConfigError(
        f"the capture went through {view_transform!r}, for which there is no tone curve; render it "
        "with one of " + ", ".join(c.blender_view_transform or c.name for c in tone.families())
    )


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
