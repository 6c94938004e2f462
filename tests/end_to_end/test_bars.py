# SPDX-License-Identifier: Apache-2.0
"""Bars on a slab, four pixels of the best photographs a pair, come back in the texture."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from capture.scene import Shot
from capture.writers import nerf_synthetic
from geometry.given.test_surface import with_layout, y_up
from PIL import Image
from transport.shapes import looking_at

from robir.geometry.mesh.triangles import LIGHT
from robir.jobs.paths import JobPaths, read_json

pytestmark = pytest.mark.slow

ENGINE = Path(__file__).parents[1] / "addon" / "tiny_engine.py"
SIDE = 1024
HALF, DEPTH = 0.6, 0.2
SIZE, FOCAL, DISTANCE = 200, 1.5, 2.4
# width on the slab's top of a pixel of the camera straight above
PIXEL = (DISTANCE - DEPTH) / (FOCAL * SIZE)

PERIOD = 4.0 * PIXEL  # half the frequency at which a pixel is half a wave

DARK, BRIGHT = 0.2, 0.7
DENSITY = 0.16  # of the texture's side, one unit of the slab: a little more than a texel a pixel


def paint(points: np.ndarray) -> np.ndarray:
    """Albedo (N,): bars along y where x < 0 and along x where x > 0; plain paint on the sides."""
    along = np.where(points[:, 0] < 0, points[:, 0], points[:, 1])
    bar = np.where((along / PERIOD) % 1.0 < 0.5, BRIGHT, DARK)
    return np.where(points[:, 2] > DEPTH - 1e-6, bar, 0.4 + 0.2 * points[:, 0])


def shoot(position: tuple[float, float, float]) -> Shot:
    """The slab without light, 4 by 4 samples a pixel."""
    camera = looking_at(position, size=SIZE, focal=FOCAL)
    fine = camera.resized(4 * SIZE, 4 * SIZE)
    origins, directions = fine.rays(fine.pixel_centres())
    low, high = np.array([-HALF, -HALF, -DEPTH]), np.array([HALF, HALF, DEPTH])
    with np.errstate(divide="ignore"):
        slabs = np.stack([(low - origins) / directions, (high - origins) / directions])
    near, far = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
    hit = near < far
    value = np.zeros((len(hit), 2))
    value[hit, 0] = paint(origins[hit] + near[hit, None] * directions[hit])
    value[:, 1] = hit
    mean = value.reshape(SIZE, 4, SIZE, 4, 2).mean(axis=(1, 3))
    grey = mean[..., 0] / np.maximum(mean[..., 1], 1e-9)
    code = np.where(grey < 0.0031308, 12.92 * grey, 1.055 * grey.clip(1e-9) ** (1 / 2.4) - 0.055)
    rgba = np.dstack([code, code, code, mean[..., 1]])
    return Shot(camera, np.rint(255 * rgba).astype(np.uint8))


def places() -> list[tuple[float, float, float]]:
    """Four nearly straight above, the rest about the slab."""
    above = [(0.01, 0.0, DISTANCE), (0.3, 0.1, 2.38), (-0.2, 0.25, 2.38), (0.05, -0.3, 2.38)]
    turns = 2 * np.pi * np.arange(12) / 12
    around = [(2.2 * np.cos(t), 2.2 * np.sin(t), 1.2) for t in turns]
    return [*above, *around, (0.4, 0.3, -2.4), (-0.5, 0.1, -2.4)]


def slab() -> trimesh.Trimesh:
    """Every side a square or a strip of the texture; so many faces that light has fewer."""
    solid = trimesh.creation.box((2 * HALF, 2 * HALF, 2 * DEPTH))
    for _ in range(4):
        solid = solid.subdivide()
    corners, normals = solid.triangles, solid.face_normals
    uvs = np.zeros((len(corners), 3, 2))
    for axis in range(3):
        for sign in (-1, 1):
            of_side = normals[:, axis] * sign > 0.5
            flat = np.delete(corners[of_side], axis, axis=2)
            place = np.array([0.1 + 0.3 * axis, 0.25 + 0.5 * (sign > 0)])
            uvs[of_side] = place + DENSITY * flat
    return with_layout(solid, lambda _count: uvs.reshape(-1, 2))


def contrast(albedo: np.ndarray, u0: float, v0: float, axis: int) -> float:
    """Of the bars' first wave in a square of the texture about a place, as a share of the truth's.

    Args:
        albedo: (T, T) linear, row 0 at v = 1.
        u0: Place of the square's middle.
        v0: The same upwards.
        axis: 0 for bars that follow each other along u, 1 along v.
    """
    texels = np.arange(-30, 31)
    columns, rows = (np.rint(at * SIDE - 0.5).astype(int) for at in (u0, (1 - v0)))
    square = albedo[np.ix_(rows + texels, columns + texels)]
    along = square.mean(axis=axis)  # bars are constant across
    wave = np.exp(2j * np.pi * texels / (SIDE * DENSITY * PERIOD))
    window = np.hanning(len(texels))
    first = 2 * np.abs((along * wave * window).sum()) / (along * window).sum()
    true = 4 / np.pi * (BRIGHT - DARK) / (BRIGHT + DARK)
    return float(first / true)


def test_a_texture_has_the_bars_of_half_the_nyquist_frequency(tmp_path):
    capture = nerf_synthetic(tmp_path / "slab", [shoot(place) for place in places()], 2)
    (tmp_path / "slab.glb").write_bytes(y_up(slab()).export(file_type="glb"))
    words = ["reconstruct", str(capture), "--mesh", str(tmp_path / "slab.glb")]
    sizes = ["appearance.shading_size=256", f"appearance.texture_size={SIDE}"]
    changes = [word for size in sizes for word in ("--set", size)]
    done = subprocess.run(
        [sys.executable, str(ENGINE), *words, "-o", str(tmp_path / "out"), *changes],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 5), done.stderr[-2000:]
    paths = JobPaths(tmp_path / "out")
    assert (paths.stage("geometry") / LIGHT).exists()
    held_out = read_json(paths.manifest("appearance"))["metrics"]["held_out_psnr"]
    assert held_out > 29.5, "texels are found by the faces of the mesh, not of light's copy"
    with Image.open(paths.textures / "albedo.png") as picture:
        assert picture.size == (SIDE, SIDE)
        code = np.asarray(picture.convert("RGB"))[..., 1] / 255.0
    albedo = np.where(code < 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    u, v = 0.1 + 0.3 * 2, 0.75
    found = [contrast(albedo, u - 0.3 * DENSITY, v, 0), contrast(albedo, u + 0.3 * DENSITY, v, 1)]
    assert min(found) > 0.5
