# SPDX-License-Identifier: GPL-3.0-or-later
"""Turned chess pieces on a board: glossy and rough, dark and light, lighting one another."""

import bpy
import numpy as np

from blender_scenes import textures
from blender_scenes.objects import Pose, add_object, principled
from blender_scenes.request import SceneRequest
from blender_scenes.shapes import box, lathe, smooth_profile, sphere

BOARD_SIDE = 1.24
BOARD_HEIGHT = 0.06
SQUARES = 8
PLAYED_SIDE = 1.12
"""Side of the checkered part; the rest is the frame."""

FOOT = [(0.0, 0.0), (0.066, 0.0), (0.068, 0.018), (0.056, 0.034), (0.05, 0.05)]
BODIES = {
    "pawn": [(0.028, 0.085), (0.024, 0.13), (0.042, 0.142), (0.026, 0.155)],
    "bishop": [
        (0.031, 0.1),
        (0.025, 0.2),
        (0.046, 0.215),
        (0.028, 0.232),
        (0.044, 0.275),
        (0.03, 0.32),
        (0.0, 0.345),
    ],
    "rook": [
        (0.038, 0.09),
        (0.034, 0.17),
        (0.052, 0.19),
        (0.053, 0.24),
        (0.034, 0.241),
        (0.033, 0.215),
        (0.0, 0.214),
    ],
    "queen": [
        (0.034, 0.12),
        (0.026, 0.25),
        (0.05, 0.265),
        (0.03, 0.285),
        (0.055, 0.35),
        (0.036, 0.352),
        (0.0, 0.365),
    ],
    "king": [
        (0.036, 0.12),
        (0.029, 0.27),
        (0.054, 0.285),
        (0.034, 0.305),
        (0.052, 0.38),
        (0.03, 0.395),
        (0.0, 0.4),
    ],
}
KNOBS = {"pawn": (0.19, 0.045), "bishop": (0.352, 0.013), "queen": (0.375, 0.019)}
"""Height and radius of the ball on top of a piece."""

ROUNDING = 1.35
"""Scale of the pieces over the measures above."""


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Adds the board and eleven pieces on squares drawn by `rng`."""
    del request
    table = Pose(degrees=(0.0, 0.0, float(rng.uniform(0.0, 90.0))))
    _board(table, rng)
    ivory = textures.linear_from_hex("efe4cc")
    walnut = textures.wood(
        128, textures.linear_from_hex("3d2415"), textures.linear_from_hex("6b4226"), rng
    )
    materials = {
        "ivory": principled("ivory", textures.jittered(ivory, rng, 0.04), 0.3),
        "chalk": principled(
            "chalk", textures.jittered(textures.linear_from_hex("cfc6b4"), rng), 0.8
        ),
        "walnut": principled("walnut", walnut, 0.35),
        "ebony": principled("ebony", textures.linear_from_hex("33302e"), 0.15),
        "red": principled("red", textures.jittered(textures.linear_from_hex("b3261e"), rng), 0.22),
        "brass": principled("brass", textures.linear_from_hex("d6b26a"), 0.28, metallic=1.0),
    }
    kinds = [
        "king",
        "queen",
        "bishop",
        "bishop",
        "rook",
        "rook",
        "pawn",
        "pawn",
        "pawn",
        "pawn",
        "pawn",
    ]
    order = [*materials, *rng.permutation(["ivory", "ebony", "chalk", "red", "walnut"])]
    for place, kind, name in zip(_places(len(kinds), rng), kinds, order, strict=True):
        _piece(kind, materials[name], Pose(place, (0.0, 0.0, float(rng.uniform(0, 360)))), table)


def _board(table: Pose, rng: np.random.Generator) -> None:
    light = textures.jittered(textures.linear_from_hex("e3c99c"), rng)
    dark = textures.jittered(textures.linear_from_hex("6d3f24"), rng)
    squares = textures.checker(512, SQUARES, dark, light)
    grain = 0.85 + 0.15 * textures.noise(512, 16, rng)[..., None]
    top = principled("squares", np.clip(squares * grain, 0.02, 0.9).astype(np.float32), 0.3)
    frame = principled("frame", textures.linear_from_hex("54311c"), 0.5)
    under = (BOARD_SIDE, BOARD_SIDE, BOARD_HEIGHT - 0.008)
    add_object("frame", box(under), frame, Pose((0.0, 0.0, 0.5 * under[2])), table, bevel=0.012)
    field = (PLAYED_SIDE, PLAYED_SIDE, 0.02)
    add_object("squares", box(field), top, Pose((0.0, 0.0, BOARD_HEIGHT - 0.01)), table)


def _places(count: int, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Distinct squares, the first ones near the board's middle: tall pieces stay in view."""
    square = PLAYED_SIDE / SQUARES
    index = np.stack(np.meshgrid(np.arange(SQUARES), np.arange(SQUARES)), axis=-1).reshape(-1, 2)
    middle = (index - 0.5 * (SQUARES - 1)) * square
    inner = np.abs(middle).max(axis=1) < 2.6 * square
    chosen = [*rng.permutation(np.flatnonzero(inner))[: count // 2 + 2]]
    rest = np.setdiff1d(np.arange(len(middle)), chosen)
    chosen += [*rng.permutation(rest)[: count - len(chosen)]]
    nudge = rng.uniform(-0.08, 0.08, (count, 2)) * square
    points = middle[chosen] + nudge
    return [(float(x), float(y), BOARD_HEIGHT) for x, y in points]


def _piece(kind: str, material: bpy.types.Material, place: Pose, table: Pose) -> None:
    profile = [*FOOT, *BODIES[kind]]
    if profile[-1][0] > 0.0:
        profile.append((0.0, profile[-1][1] + 0.004))
    grown = Pose(place.location, place.degrees, ROUNDING)
    add_object(kind, lathe(smooth_profile(profile, 56), 48), material, grown, table)
    if kind in KNOBS:
        height, radius = KNOBS[kind]
        x, y, z = place.location
        knob = Pose((x, y, z + ROUNDING * height), place.degrees)
        add_object("knob", sphere(ROUNDING * radius), material, knob, table)
    if kind == "king":
        x, y, z = place.location
        for size, lift in (((0.016, 0.016, 0.09), 0.43), ((0.058, 0.015, 0.016), 0.445)):
            across, along, up = (ROUNDING * s for s in size)
            at = Pose((x, y, z + ROUNDING * lift), place.degrees)
            add_object("cross", box((across, along, up)), material, at, table, bevel=0.004)
