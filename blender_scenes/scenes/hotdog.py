# SPDX-License-Identifier: GPL-3.0-or-later
"""Two hot dogs with ketchup on a plate: soft shapes that touch, narrow gaps, a glossy white rim."""

import bpy
import numpy as np

from blender_scenes import textures
from blender_scenes.objects import Pose, add_object, principled
from blender_scenes.request import SceneRequest
from blender_scenes.shapes import Shape, lathe, smooth_profile, tube

PLATE = [
    (0.0, 0.0), (0.45, 0.0), (0.48, 0.02), (0.62, 0.045), (0.78, 0.1), (0.8, 0.108),
    (0.79, 0.118), (0.76, 0.115), (0.6, 0.066), (0.5, 0.05), (0.0, 0.045),
]  # fmt: skip
PLATE_TOP = 0.045
BUN_RADIUS = 0.115
SAUSAGE_RADIUS = 0.078


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Adds plate, buns, sausages and ketchup, turned and coloured by `rng`."""
    del request
    table = Pose(degrees=(0.0, 0.0, float(rng.uniform(0.0, 360.0))))
    _plate(table, rng)
    for side in (-1.0, 1.0):
        offset = 0.25 * side + float(rng.uniform(-0.015, 0.015))
        turn = float(rng.uniform(-5.0, 5.0))
        _hotdog(Pose((0.0, offset, PLATE_TOP), (0.0, 0.0, turn)), table, rng)


def _plate(table: Pose, rng: np.random.Generator) -> None:
    white = textures.jittered(textures.linear_from_hex("e4e2dc"), rng, 0.03)
    china = np.broadcast_to(np.asarray(white, dtype=np.float32), (512, 512, 3)).copy()
    china = textures.with_band(
        china, 0.535, 0.548, textures.jittered(textures.linear_from_hex("2f4f8f"), rng)
    )
    add_object(
        "plate",
        lathe(smooth_profile(PLATE, 96), 96),
        principled("plate", china, 0.22),
        Pose(),
        table,
    )


def _hotdog(place: Pose, table: Pose, rng: np.random.Generator) -> None:
    crust, crumb = textures.linear_from_hex("b8783c"), textures.linear_from_hex("e6bf86")
    bend = float(rng.uniform(-0.03, 0.03))
    baked = np.clip(0.25 + 0.9 * (textures.noise(256, 4, rng) - 0.4), 0.0, 1.0)
    bread = principled("bread", textures.mixed(textures.jittered(crust, rng), crumb, baked), 0.7)
    meat = textures.speckled(
        256, textures.linear_from_hex("a8482a"), textures.linear_from_hex("7c3018"), 0.3, rng
    )
    skin = principled("sausage", meat, 0.25)
    ketchup = principled(
        "ketchup", textures.jittered(textures.linear_from_hex("b01812"), rng, 0.06), 0.12
    )
    for side in (-1.0, 1.0):
        half = _arc(0.36, 0.095 * side, BUN_RADIUS * 0.92, bend)
        _add("bun", tube(half, BUN_RADIUS, 40, squash=0.92), bread, place, table)
    base = _arc(0.33, 0.0, 0.06, bend)
    _add("bun", tube(base, 0.075, 40, squash=0.75), bread, place, table)
    _add("sausage", tube(_arc(0.43, 0.0, 0.185, bend), SAUSAGE_RADIUS, 40), skin, place, table)
    line = _arc(0.38, 0.0, 0.185 + SAUSAGE_RADIUS, bend, count=160)
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    swing = 0.042 * np.sin(2.0 * np.pi * 6.0 * np.linspace(0.0, 1.0, 160) + phase)
    line[:, 1] += swing
    line[:, 2] += np.sqrt(SAUSAGE_RADIUS**2 - swing**2) - SAUSAGE_RADIUS + 0.006
    _add("ketchup", tube(line, 0.016, 16), ketchup, place, table)


def _arc(
    half_length: float, offset: float, height: float, bend: float, count: int = 48
) -> np.ndarray:
    """Centre line (count, 3) along x, moved sideways by `offset`, its middle bent by `bend`."""
    x = np.linspace(-half_length, half_length, count)
    return np.stack(
        [x, offset + bend * (1.0 - (x / half_length) ** 2), np.full(count, height)], axis=1
    )


def _add(name: str, shape: Shape, material: bpy.types.Material, place: Pose, table: Pose) -> None:
    obj = add_object(name, shape, material, place)
    obj.matrix_world = table.matrix() @ obj.matrix_world
