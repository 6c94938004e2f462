# SPDX-License-Identifier: Apache-2.0
"""Tiny captures of the population, rendered: the same to the bit, resumable, as they say."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from blender_scenes.environment import LUMINANCE
from blender_scenes.format import SECOND_LIGHT, read_view
from blender_scenes.population.draw import Sources, draw
from blender_scenes.wheel import data_folder

pytestmark = pytest.mark.blender

ROOT = Path(__file__).parents[2]

# the command with the last rows of its table changed: seconds instead of minutes
TINY = """
import sys
from blender_scenes.population import command, ranges
ranges.RESOLUTION_LOG = (32, 32)
ranges.VIEWS_LOG = (2, 2)
ranges.TEST_VIEWS = 1
ranges.MOST_SAMPLES = ranges.LEAST_SAMPLES = 4
for seed in sys.argv[2:]:
    if code := command.main([sys.argv[1], "--count", "1", "--seed", seed]):
        sys.exit(code)
"""


def run(out: Path, *seeds: int) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", TINY, str(out), *map(str, seeds)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def bare(seed: int):
    """What is drawn without assets or further maps."""
    maps = tuple(sorted(data_folder("studiolights/world").glob("*.exr")))
    return draw(seed, Sources((), maps))


def seeds_of_every_shape() -> list[int]:
    """Seeds that together have what Blender's own modifiers make, a ground, and two suns."""
    wanted = {"boolean", "monkey", "ground", "two suns", "alpha", "backdrop"}
    chosen = []
    for seed in range(1000):
        recipe, tone = bare(seed).request.recipe, bare(seed).tone
        has = {part.kind for part in recipe.parts}
        has |= {"ground"} if recipe.ground is not None else set()
        has |= {"two suns"} if len(recipe.sky.suns) == 2 else set()
        has |= {"alpha" if tone.backdrop is None else "backdrop"}
        if wanted & has:
            wanted -= has
            chosen.append(seed)
        if not wanted:
            return chosen
    raise AssertionError(wanted)


SEEDS = seeds_of_every_shape()


@pytest.fixture(scope="module")
def population(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("population")
    run(folder, *SEEDS)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def captures(folder: Path) -> list[Path]:
    return [folder / f"seed_{seed:04d}" for seed in SEEDS]


def test_the_same_seed_is_the_same_capture_to_the_bit(population: Path, tmp_path: Path) -> None:
    """In another process, another folder and another order: the first is the last again."""
    again = tmp_path / "a folder with a longer name"
    run(again, SEEDS[-1], SEEDS[0])
    for capture in (captures(population)[0], captures(population)[-1]):
        before, after = contents(capture), contents(again / capture.name)
        assert before.keys() == after.keys()
        assert [name for name in before if before[name] != after[name]] == []
    assert not (again / ".renders").exists()


def test_a_finished_capture_is_not_rendered_again_and_a_lost_one_is(population: Path) -> None:
    first = captures(population)[0]
    before = {p: p.stat().st_mtime_ns for p in first.rglob("*")}
    done = run(population, SEEDS[0])
    assert f"{first.name}: already there" in done.stderr
    assert {p: p.stat().st_mtime_ns for p in first.rglob("*")} == before


def test_captures_say_what_they_are(population: Path) -> None:
    for seed, capture in zip(SEEDS, captures(population), strict=True):
        scene = json.loads((capture / "truth" / "scene.json").read_text())
        one, classes = bare(seed), scene["classes"]
        truth = read_view(capture / "truth" / "train" / "r_000.exr")
        assert (classes["ground"] == "ground") == (one.request.recipe.ground is not None)
        assert classes["backdrop"] == (one.tone.backdrop or "alpha")
        assert len(scene["lamps"]) == len(one.request.recipe.sky.suns)
        assert scene["recipe"]["parts"][0]["kind"] == one.request.recipe.parts[0].kind
        with Image.open(capture / "train" / "r_000.png") as picture:
            mode = picture.mode
        assert mode == ("RGBA" if one.tone.backdrop is None else "RGB")
        assert 0.02 < truth.mask.mean() < 0.9
        seen = truth.position[(truth.hit > 0.5) & (truth.mask > 0.99)]
        lowest = -0.06 if one.request.recipe.ground is not None else -0.01
        assert seen[:, 2].min() > lowest
        # nothing leaves the picture, unless the hand that held the camera strayed
        if one.request.recipe.cameras.kind != "handheld":
            edge = np.concatenate([truth.mask[[0, -1]].ravel(), truth.mask[:, [0, -1]].ravel()])
            assert edge.max() < 1e-3


def test_test_views_are_lit_by_the_second_light(population: Path) -> None:
    """Sides of the scene gain and lose: by its light alone a picture's noise would average out."""
    for capture in captures(population):
        with OpenEXR.File(str(capture / "truth" / SECOND_LIGHT)) as opened:
            assert opened.channels()["RGB"].pixels.shape == (256, 512, 3)
        truth = read_view(capture / "truth" / "test" / "r_000.exr")
        file = capture / "truth" / "relit" / "r_000.exr"
        with OpenEXR.File(str(file), separate_channels=True) as opened:
            planes = {name: c.pixels for name, c in opened.channels().items()}
        relit = np.stack([planes[f"radiance.{axis}"] for axis in "RGB"], axis=-1) @ LUMINANCE
        # with four samples a pixel of the outline is met in one of the renders and not in the other
        assert ((planes["mask"] > 0) != (truth.mask > 0)).mean() < 0.03
        inside = (truth.mask > 0.99) & (planes["mask"] > 0.99)
        x, y, z = np.moveaxis(truth.normal, -1, 0)
        sides = [inside & side for side in (x > 0.3, x < -0.3, y > 0.3, y < -0.3, z > 0.8)]
        gains = [
            relit[side].mean() / (truth.radiance @ LUMINANCE)[side].mean()
            for side in sides
            if side.sum() > 15
        ]
        assert max(gains) > 1.4 * min(gains)
