# SPDX-License-Identifier: Apache-2.0
"""One scan twice: its layout in 0..1 and the same over UDIM tiles give the same colours of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from capture.scene import BALL, BOX_HIGH, BOX_LOW, CENTRE, cameras, shoot
from capture.writers import nerf_synthetic
from geometry.given.test_surface import grid, with_layout, y_up
from PIL import Image

from robir.jobs.paths import JobPaths, of_tile, read_json

pytestmark = pytest.mark.slow

ENGINE = Path(__file__).parents[1] / "addon" / "tiny_engine.py"
CORNERS = np.array([[0, 0], [2, 0], [1, 1], [5, 0], [0, 3]])
NUMBERS = np.array([1001, 1003, 1012, 1006, 1031])
SETTINGS = ("appearance.shading_size=256", "appearance.texture_size=256")


def figure() -> trimesh.Trimesh:
    """The photographed shape, every face with a square of its own in the texture."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=BALL)
    box = trimesh.creation.box(bounds=[BOX_LOW, BOX_HIGH]).subdivide()
    solid = trimesh.util.concatenate([ball, box])
    solid.apply_translation(CENTRE)
    return with_layout(solid, grid)


def reconstructed(capture: Path, solid: trimesh.Trimesh, out: Path) -> JobPaths:
    file = out.with_suffix(".glb")
    file.write_bytes(y_up(solid).export(file_type="glb"))
    words = ["reconstruct", str(capture), "--mesh", str(file), "-o", str(out)]
    changes = [word for setting in SETTINGS for word in ("--set", setting)]
    done = subprocess.run(
        [sys.executable, str(ENGINE), *words, *changes], capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 5), done.stderr[-2000:]  # 5: so few pixels are not to be trusted
    return JobPaths(out)


def codes_at(file: Path, uvs: np.ndarray) -> np.ndarray:
    """Codes (N, 3) of a texture at places in 0..1."""
    with Image.open(file) as picture:
        codes = np.array(picture.convert("RGB")).astype(int)
    side = len(codes)
    column, row = np.floor(uvs * side).astype(int).T
    return codes[side - 1 - row, column]


def test_colours_do_not_depend_on_tiles(tmp_path):
    capture = nerf_synthetic(tmp_path / "figure", [shoot(c, samples=2) for c in cameras(14)], 2)
    solid, tiled = figure(), figure()
    count = len(solid.faces)
    which = np.arange(count) % 5
    uvs = np.asarray(solid.visual.uv).reshape(count, 3, 2)
    tiled.visual.uv = (uvs + CORNERS[which][:, None]).reshape(-1, 2)
    alone = reconstructed(capture, solid, tmp_path / "alone")
    over = reconstructed(capture, tiled, tmp_path / "over")
    metrics = read_json(over.manifest("geometry"))["metrics"]
    assert (metrics["layout"], metrics["tiles"]) == ("own", 5)
    middle = uvs.mean(axis=1)
    one = codes_at(alone.textures / "albedo.png", middle)
    several = np.zeros_like(one)
    for index, number in enumerate(NUMBERS):
        file = of_tile(over.textures / "albedo.png", number)
        with Image.open(file) as picture:
            assert picture.size in {(128, 128), (256, 256)}
        several[which == index] = codes_at(file, middle[which == index])
    apart = np.abs(one - several).mean(axis=1)
    assert np.median(apart) < 10 and np.percentile(apart, 95) < 30
    assert np.abs(one - one[::-1]).mean() > 60, "else any tile would do"
    # and the colours are the photographed ones
    points = np.asarray(solid.triangles).mean(axis=1) - CENTRE
    paint = 255 * (0.5 + 0.4 * np.sin(3 * points))
    correlation = [np.corrcoef(paint[:, k], several[:, k])[0, 1] for k in range(3)]
    assert min(correlation) > 0.8
