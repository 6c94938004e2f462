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
| `retone`     | power                                   | display codes to that power, as x^0.5 |
| `resolution` | pixels                                  | width of the training pictures |
| `jpeg`       | quality 1..95                           | pictures go through a JPEG |
| `noise`      | standard deviation of display values    | Gaussian noise |
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from robir.errors import CaptureError, ConfigError
from robir.jobs.paths import read_json, replacing, write_json
from robir.maths import tone
from robir.maths.tone_curve import DISPLAY_POWER
from robir_bench.stability import spoil
from robir_bench.stability.spoil import Photographs
from robir_bench.truth.light import true_curve

Value = float | str

Change = Callable[[Photographs, Any, np.random.Generator], Photographs]


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """Something that may be wrong with a capture."""

    change: Change  # makes the photographs worse by a value
    is_of_tests: bool  # whether the test views' pictures suffer too
    check: Callable[[Any], bool]  # whether a value makes sense
    wanted: str  # what values make sense, for people


def _is_number(low: float, high: float) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, float) and low <= value <= high


def _is_mask_error(value: Any) -> bool:
    words = value.split() if isinstance(value, str) else []
    known = len(words) == 2 and words[0] in ("dilate", "erode", "holes")
    return known and words[1].isdecimal() and 1 <= int(words[1]) <= 64


def _is_family(value: Any) -> bool:
    return value in {curve.name for curve in tone.families()}


# what `robir stability` can sweep, by the name in a plan
FACTORS: dict[str, Factor] = {
    "views": Factor(
        change=spoil.keep_views,
        is_of_tests=False,
        check=_is_number(1, 1e5),
        wanted="a number of views",
    ),
    "pose noise": Factor(
        change=spoil.turn_cameras, is_of_tests=False, check=_is_number(0, 90), wanted="degrees"
    ),
    "mask": Factor(
        change=spoil.spoil_masks,
        is_of_tests=True,
        check=_is_mask_error,
        wanted='"dilate PIXELS", "erode PIXELS" or "holes NUMBER"',
    ),
    "exposure": Factor(
        change=spoil.expose, is_of_tests=True, check=_is_number(-10, 10), wanted="stops, -10 to 10"
    ),
    "jitter": Factor(
        change=spoil.jitter, is_of_tests=True, check=_is_number(0, 5), wanted="stops, 0 to 5"
    ),
    "tone": Factor(
        change=spoil.change_tone,
        is_of_tests=True,
        check=_is_family,
        wanted="the name of a tone family",
    ),
    "retone": Factor(
        change=spoil.retone,
        is_of_tests=True,
        check=_is_number(0.1, 10),
        wanted="a power of the display codes, 0.1 to 10",
    ),
    "resolution": Factor(
        change=spoil.shrink,
        is_of_tests=False,
        check=_is_number(16, 1e5),
        wanted="a width in pixels",
    ),
    "jpeg": Factor(
        change=spoil.compress,
        is_of_tests=True,
        check=_is_number(1, 95),
        wanted="a quality, 1 to 95",
    ),
    "noise": Factor(
        change=spoil.add_noise,
        is_of_tests=True,
        check=_is_number(0, 1),
        wanted="a standard deviation of display values, 0 to 1",
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """One value of one factor."""

    source: Path  # rendered capture with truth
    factor: str  # name in FACTORS
    value: Value  # how much of it

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

        Raises:
            CaptureError: If the source is no rendered capture with truth.
        """
        if out.exists():
            return
        try:
            self._write(out, np.random.default_rng(seed))
        except (OSError, KeyError, ValueError) as fault:
            raise CaptureError(
                f"{self.source} cannot be spoilt ({fault}); it must be a capture with truth as "
                "`python -m blender_scenes` makes it"
            ) from fault

    def _write(self, out: Path, rng: np.random.Generator) -> None:
        partial = out.with_name(f".{out.name}")
        shutil.rmtree(partial, ignore_errors=True)
        _link_tree(self.source / "truth", partial / "truth")
        scene = read_json(self.source / "truth" / "scene.json")
        if self.factor == "tone":
            curve = tone.curve_from_name(str(self.value))
            scene["view_transform"] = curve.blender_view_transform or curve.name
        if self.factor == "retone":
            scene[DISPLAY_POWER] = self.value
        if self.factor in ("tone", "retone"):
            write_json(partial / "truth" / "scene.json", scene)
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
        with Image.open(source / split / f"{name}.png", formats=["PNG"]) as image:
            pictures.append(np.asarray(image.convert("RGBA")))
    return Photographs(
        table=table,
        pictures=tuple(pictures),
        truths=tuple(source / "truth" / split / f"{name}.exr" for name in names),
        curve=curve_of(scene),
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


def curve_of(scene: dict[str, Any]) -> tone.AbstractToneCurve:
    """The curve that the pictures of a capture with truth went through.

    Args:
        scene: Contents of the truth's scene.json.

    Raises:
        ConfigError: If it is none of ours.
    """
    curve = true_curve(scene)
    if curve is None:
        raise ConfigError(
            f"the capture went through {scene['view_transform']!r}, for which there is no tone "
            "curve; render it with one of "
            + ", ".join(c.blender_view_transform or c.name for c in tone.families())
        )
    return curve
