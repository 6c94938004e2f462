# SPDX-License-Identifier: Apache-2.0
"""Tiny captures of photographs, rendered: read back, the same to the bit, as the truth says."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_scenes.format import read_view
from blender_scenes.photographs.developing import Shot, display
from blender_scenes.photographs.recipe import Frame, PhotoRecipe
from blender_scenes.population.draw import Sources
from blender_scenes.population.photo_draw import draw_photographs
from blender_scenes.view_transform import codes_from_display
from blender_scenes.wheel import data_folder
from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.frames import FrameSet
from robir.capture.poses.sources import find_photographs
from robir.capture.recognise import read_frames
from robir.errors import CaptureError
from robir_bench.truth.aligned import align
from robir_bench.truth.files import load_truth

pytestmark = [pytest.mark.blender, pytest.mark.slow]

ROOT = Path(__file__).parents[2]

# the command with the last rows of its table changed: seconds instead of minutes
TINY = """
import sys
from blender_scenes.population import command, photo_ranges as table
table.LONGER_LOG, table.PHOTOGRAPHS_LOG, table.PIXEL_SAMPLES = (72, 72), (6, 6), 1e5
for seed in sys.argv[2:]:
    words = [sys.argv[1], "--photographs", "--count", "1", "--seed", seed]
    if code := command.main(words):
        sys.exit(code)
"""


def run(out: Path, *seeds: int) -> str:
    command = [sys.executable, "-c", TINY, str(out), *map(str, seeds)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr


def bare(seed: int) -> PhotoRecipe:
    maps = tuple(sorted(data_folder("studiolights/world").glob("*.exr")))
    return draw_photographs(seed, Sources((), maps))


def tiny(seed: int) -> PhotoRecipe:
    """What was rendered: the same but for its size."""
    shape = bare(seed).frame
    sides = [round(72 * side / max(shape.width, shape.height)) for side in
             (shape.width, shape.height)]  # fmt: skip
    return replace(bare(seed), frame=Frame(sides[0], sides[1], shape.angle))


def seed_of(layout: str, poses: str) -> int:
    """The first seed of a kind that has masks."""
    for seed in range(200):
        handover = bare(seed).handover
        is_it = (handover.layout, handover.poses) == (layout, poses)
        if is_it and handover.masks == "given":
            return seed
    raise AssertionError(layout)


EXACT, WRONG, NONE = (
    seed_of(*kind)
    for kind in (("transforms.json", "exact"), ("colmap", "errors"), ("photographs", "none"))
)


@pytest.fixture(scope="module")
def population(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("population")
    run(folder, EXACT, WRONG, NONE)
    return folder


def capture(population: Path, seed: int) -> Path:
    return population / f"seed_{seed:04d}"


def views(frames: FrameSet) -> list[View]:
    """Frames as a result has them, but for their pictures."""
    nothing = np.zeros((0, 0, 3), np.uint8)
    found = []
    for frame in frames.frames:
        lens = frame.lens
        camera = Camera(
            width=lens.width, height=lens.height, fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy,
            camera_to_world=frame.camera_to_world,
        )  # fmt: skip
        found.append(
            View(
                name=frame.name, image_display=nothing, mask=nothing[..., 0], camera=camera,
                split="train",
            )
        )  # fmt: skip
    return found


def test_exact_poses_are_read_as_the_truth_has_them(population: Path) -> None:
    folder = capture(population, EXACT)
    frames, truth = read_frames(folder), load_truth(folder)
    assert frames.format == "nerfstudio"
    assert {frame.name for frame in frames.frames} == set(truth.cameras)
    for frame in frames.frames:
        true = truth.cameras[frame.name]
        np.testing.assert_allclose(frame.camera_to_world, true.camera_to_world, atol=1e-5)
        assert frame.lens.fx == pytest.approx(true.fx, abs=1e-5)
        assert frame.mask is not None
        assert frame.mask.is_file()


def test_wrong_poses_are_brought_to_the_truth_within_their_errors(population: Path) -> None:
    folder = capture(population, WRONG)
    frames, truth = read_frames(folder), load_truth(folder)
    assert frames.format == "colmap"
    assert len(frames.points) > 100
    found = align(truth, views(frames))
    # a photograph of 72 pixels shows a fourteenth of what one of 1000 does
    assert 0.005 < found.pixels < 0.1
    # a sparse point lies on the table or the thing, or beyond
    there = found.place.inverse(frames.points)
    assert np.median(np.abs(there[:, 2])) < 1.0


def test_photographs_alone_are_found_and_the_truth_is_not_taken_for_a_capture(
    population: Path,
) -> None:
    folder = capture(population, NONE)
    photographs = find_photographs(folder)
    assert {path.parent.name for path in photographs} == {"images"}
    assert len(photographs) == 6
    assert load_truth(folder).cameras.keys() == {path.stem for path in photographs}
    with pytest.raises(CaptureError, match="poses"):
        read_frames(folder)


def test_codes_are_the_truth_developed(population: Path) -> None:
    """Noise and JPEG remain, with no mean."""
    for seed in (EXACT, WRONG, NONE):
        folder = capture(population, seed)
        scene = json.loads((folder / "truth" / "scene.json").read_text())
        recipe = tiny(seed)
        shots = {shot["name"]: shot for shot in scene["photographs"]}
        files = sorted((folder / "truth" / "test").glob("*.exr"))
        assert files
        for file in files:
            shot = shots[file.stem]
            taken = Shot(shot["exposure"], tuple(shot["white_balance"]))
            view = read_view(file)
            clean = display(view.radiance, taken, recipe.developing, recipe.frame, None)
            with Image.open(folder / "images" / f"{file.stem}.jpg") as picture:
                codes = np.asarray(picture).astype(float)
            off = codes - codes_from_display(clean)
            assert abs(off.mean()) < 1.5
            assert np.sqrt((off.mean(axis=-1) ** 2).mean()) < 12.0
            assert 0.01 < view.mask.mean() < 0.9
            assert np.abs(view.albedo[view.hit < 0.5][view.mask[view.hit < 0.5] == 0.0]).max() == 0
