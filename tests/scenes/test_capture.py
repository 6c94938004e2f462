# SPDX-License-Identifier: Apache-2.0
"""Small captures rendered in Cycles by the command line, held against what is known about them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from PIL import Image

from blender_scenes.environment import LUMINANCE, map_directions
from blender_scenes.format import ViewTruth, read_view
from blender_scenes.view_transform import display_from_linear

pytestmark = pytest.mark.blender

ROOT = Path(__file__).parents[2]
SMALL = ("--resolution", "32", "--views", "2", "--test-views", "1", "--samples", "4")


def run(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "blender_scenes", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Path:
    out = tmp_path_factory.mktemp("captures") / "truck"
    done = run("truck", out, *SMALL, "--cache", cache)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(out)
    return out


@pytest.fixture(scope="module")
def views(capture: Path) -> list[tuple[np.ndarray, float, ViewTruth]]:
    """Camera_to_world, focal length and truth of every view."""
    found = []
    for split in ("train", "test"):
        transforms = json.loads((capture / f"transforms_{split}.json").read_text())
        for frame in transforms["frames"]:
            truth = read_view(capture / "truth" / f"{frame['file_path']}.exr")
            found.append((np.array(frame["transform_matrix"]), transforms["fl_x"], truth))
    return found


@pytest.fixture(scope="module")
def scene(capture: Path) -> dict:
    return json.loads((capture / "truth" / "scene.json").read_text())


def test_pictures_are_the_view_transform_of_the_linear_radiance(capture: Path) -> None:
    truth = read_view(capture / "truth" / "train" / "r_000.exr")
    codes = np.asarray(Image.open(capture / "train" / "r_000.png")).astype(float)
    covered = truth.mask > 0.0
    expected = 255.0 * display_from_linear(truth.radiance, "Filmic")
    assert np.abs(codes[..., :3] - expected)[covered].max() <= 0.51
    assert (codes[..., :3][~covered] == 0.0).all()
    assert np.abs(codes[..., 3] - 255.0 * truth.mask).max() <= 0.51
    assert 0.1 < covered.mean() < 0.6


def test_positions_project_to_their_pixel_centres(views: list) -> None:
    for pose, focal, truth in views:
        hit = truth.hit > 0.5
        rows, columns = np.nonzero(hit)
        local = (truth.position[hit] - pose[:3, 3]) @ pose[:3, :3]
        assert (local[:, 2] < 0.0).all()
        u = 16.0 + focal * local[:, 0] / -local[:, 2]
        v = 16.0 - focal * local[:, 1] / -local[:, 2]
        assert np.abs(u - columns - 0.5).max() < 0.05
        assert np.abs(v - rows - 0.5).max() < 0.05


def test_mesh_is_what_the_cameras_see(capture: Path, views: list, scene: dict) -> None:
    """Rays through the pixel centres meet the mesh where the position pass says."""
    mesh = trimesh.load(capture / "truth" / "mesh.ply", process=False)
    for pose, _, truth in views:
        seen = truth.position[truth.hit > 0.5]
        ray = seen - pose[:3, 3]
        eyes = np.broadcast_to(pose[:3, 3], seen.shape)
        met, index, _ = mesh.ray.intersects_location(eyes, ray, multiple_hits=False)
        assert len(index) > 0.99 * len(seen)
        assert np.quantile(np.linalg.norm(met - seen[index], axis=1), 0.99) < 1e-3
    reach = np.linalg.norm(mesh.vertices - scene["scene_centre"], axis=1).max()
    assert reach == pytest.approx(scene["scene_radius"], rel=1e-6)


def test_sun_is_seen_from_the_open_side_and_not_from_below(
    capture: Path, views: list, scene: dict
) -> None:
    sun = np.array(scene["sun_direction"])
    assert np.linalg.norm(sun) == pytest.approx(1.0)
    assert sun[2] > 0.5
    points = np.concatenate([t.position[t.hit > 0.5] for _, _, t in views])
    normals = np.concatenate([t.normal[t.hit > 0.5] for _, _, t in views])
    visible = np.concatenate([t.sun_visibility[t.hit > 0.5] for _, _, t in views])
    assert (visible[normals @ sun < 0.0] == 0.0).all()
    roof = (points[:, 2] > points[:, 2].max() - 0.3) & (normals[:, 2] > 0.99)
    assert visible[roof].max() == 1.0
    assert 0.1 < (visible[points[:, 2] < 1e-3] == 0.0).mean() < 0.9


def planted_sky(file: Path, sun: np.ndarray, glow: np.ndarray) -> None:
    """Writes a map with a small white sun and a faint green glow in given directions."""
    sky = np.full((128, 256, 3), 0.05, dtype=np.float32)
    sky[map_directions(128) @ glow > np.cos(np.radians(6.0))] = [0.0, 1.0, 0.0]
    sky[map_directions(128) @ sun > np.cos(np.radians(1.2))] = 900.0
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": sky}).write(str(file))


def test_sun_inside_a_map_casts_the_shadow_the_truth_says(tmp_path: Path, cache: Path) -> None:
    """The map's frame, the sun's direction and its visibility agree with the lit picture."""
    height = np.sin(np.radians(46.0))
    flat = np.sqrt(1.0 - height**2)
    sun, glow = (
        np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
        for azimuth in (-1.0, 0.0)
    )
    hdri, out = tmp_path / "sun.exr", tmp_path / "out"
    planted_sky(hdri, sun, glow)
    light = ("--ground", "plain", "--light", "hdri-sun", "--hdri", hdri)
    done = run("truck", out, *SMALL[:-1], 16, "--cache", cache, *light)
    assert done.returncode == 0, done.stderr
    scene = json.loads((out / "truth" / "scene.json").read_text())
    found = scene["sun_direction"]
    assert found[2] == pytest.approx(sun[2], abs=0.01)
    with OpenEXR.File(str(out / "truth" / "environment.exr")) as opened:
        rendered = opened.channels()["RGB"].pixels
    # turned about z as a whole: the glow stays one radian to the left of the sun
    green = rendered[..., 1] > 3.0 * rendered[..., 0]
    middle = map_directions(128)[green].mean(axis=0)
    turn = np.arctan2(middle[1], middle[0]) - np.arctan2(found[1], found[0])
    assert np.cos(turn - 1.0) > np.cos(np.radians(1.0))
    truths = [
        read_view(out / "truth" / name)
        for name in ("train/r_000.exr", "train/r_001.exr", "test/r_000.exr")
    ]
    ratio, visible = [], []
    for truth in truths:
        ground = (truth.hit > 0.5) & (np.abs(truth.position[..., 2]) < 1e-4) & (truth.mask > 0.999)
        ratio.append((truth.radiance @ LUMINANCE)[ground] / (truth.albedo @ LUMINANCE)[ground])
        visible.append(truth.sun_visibility[ground] > 0.5)
    ratio, visible = np.concatenate(ratio), np.concatenate(visible)
    lit, dark = np.median(ratio[visible]), np.median(ratio[~visible])
    assert lit > 5.0 * dark
    agree = (ratio > 0.5 * (lit + dark)) == visible
    assert agree.mean() > 0.93


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["castle", "OUT"], "invalid choice: 'castle'"),
        (["truck"], "OUT"),
        (["truck", "OUT", "--views", "many"], "invalid int value"),
        (["asset", "OUT"], "needs --asset FILE"),
        (["asset", "OUT", "--asset", "missing.obj"], "missing.obj: no such file"),
        (
            ["truck", "OUT", "--light", "hdri-sun", "--hdri", "missing.hdr"],
            "missing.hdr: no such file",
        ),
        (["truck", "OUT", "--view-transform", "Sepia"], "invalid choice: 'Sepia'"),
    ],
)
def test_bad_arguments_end_with_code_2_and_a_sentence(
    arguments: list[str], words: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = run(*[str(out) if a == "OUT" else a for a in arguments])
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()


def test_folder_of_another_capture_is_refused_and_left_alone(
    capture: Path, cache: Path, tmp_path: Path
) -> None:
    done = run("truck", capture, *SMALL, "--cache", cache, "--seed", "1")
    assert done.returncode == 2
    assert str(capture) in done.stderr
    assert "fingerprint" in done.stderr
    again = run("truck", capture, *SMALL, "--cache", cache)
    assert again.returncode == 0
    assert "nothing to do" in again.stderr
    (tmp_path / "letter.txt").write_text("mine")
    assert run("truck", tmp_path, *SMALL, "--cache", cache).returncode == 2
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]
