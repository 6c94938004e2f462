# SPDX-License-Identifier: GPL-3.0-or-later
"""A toy lorry with a loaded bed: straight edges, thin boards, a polished tank, a hard shadow."""

import numpy as np

from blender_scenes import textures
from blender_scenes.objects import Pose, add_object, principled
from blender_scenes.request import SceneRequest
from blender_scenes.shapes import box, cone, cylinder, lathe, sphere

WHEEL_RADIUS = 0.135


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Adds the lorry, turned and painted by `rng`."""
    del request
    lorry = Pose(degrees=(0.0, 0.0, float(rng.uniform(-40.0, 40.0))), scale=1.1)
    paint = textures.jittered(textures.linear_from_hex("c0301c"), rng)
    _chassis(lorry)
    _cab(lorry, paint, rng)
    _bed(lorry, rng)
    _load(lorry, rng)


def _chassis(lorry: Pose) -> None:
    frame = principled("frame", textures.linear_from_hex("3c4148"), 0.6)
    steel = principled("steel", textures.linear_from_hex("d8d8da"), 0.22, metallic=1.0)
    tyre = principled("tyre", textures.linear_from_hex("38383a"), 0.85)
    add_object("frame", box((1.24, 0.26, 0.07)), frame, Pose((0.0, 0.0, 0.2)), lorry, bevel=0.01)
    tread = np.array(
        [[0, 0], [0.62, 0], [0.9, 0], [1.0, 0.12], [1.0, 0.62], [0.9, 0.74], [0.62, 0.74], [0, 0.7]]
    ) * [WHEEL_RADIUS, WHEEL_RADIUS]
    for x in (-0.44, -0.13, 0.42):
        for side in (-1, 1):
            turn = (-90.0 * side, 0.0, 0.0)
            place = (x, side * 0.17, WHEEL_RADIUS)
            add_object("wheel", lathe(tread, 48), tyre, Pose(place, turn), lorry)
            hub = (x, side * (0.17 + 0.7 * WHEEL_RADIUS), WHEEL_RADIUS)
            add_object("hub", cylinder(0.07, 0.02, 0.008), steel, Pose(hub, turn), lorry)
    tank = Pose((0.06, -0.235, 0.2), (0.0, 90.0, 0.0))
    add_object("tank", cylinder(0.065, 0.22, 0.02), steel, tank, lorry)
    add_object(
        "bumper", box((0.05, 0.46, 0.09)), steel, Pose((0.635, 0.0, 0.18)), lorry, bevel=0.015
    )


def _cab(lorry: Pose, paint: textures.Rgb, rng: np.random.Generator) -> None:
    glass = textures.linear_from_hex("31506b")
    cream = textures.linear_from_hex("efe3c4")
    panel = np.broadcast_to(np.asarray(paint, dtype=np.float32), (256, 256, 3)).copy()
    panel[140:226, 34:222] = glass
    panel[140:226, 124:132] = paint
    panel = textures.with_band(panel, 0.24, 0.36, cream)
    panel = textures.with_text(panel, [(f"No {rng.integers(10, 99)}", 0.5, 0.3, 0.13)], paint)
    cab = principled("cab", panel, 0.28)
    bonnet = principled("bonnet", paint, 0.25)
    roof = principled("roof", cream, 0.35)
    lamp = principled("headlamp", textures.linear_from_hex("f2e08c"), 0.15)
    add_object("cab", box((0.28, 0.44, 0.36)), cab, Pose((0.33, 0.0, 0.415)), lorry, bevel=0.012)
    add_object("bonnet", box((0.15, 0.4, 0.19)), bonnet, Pose((0.54, 0.0, 0.33)), lorry, bevel=0.03)
    add_object("roof", box((0.31, 0.47, 0.035)), roof, Pose((0.33, 0.0, 0.61)), lorry, bevel=0.015)
    for y in (-0.13, 0.13):
        add_object("headlamp", sphere(0.042), lamp, Pose((0.615, y, 0.34)), lorry)
    add_object("chimney", cylinder(0.028, 0.34, 0.01), bonnet, Pose((0.16, 0.18, 0.42)), lorry)


def _bed(lorry: Pose, rng: np.random.Generator) -> None:
    dark, light = textures.linear_from_hex("7a5230"), textures.linear_from_hex("c99a62")
    boards = principled("boards", textures.wood(256, dark, light, rng, planks=4), 0.65)
    add_object(
        "floor", box((0.78, 0.48, 0.04)), boards, Pose((-0.23, 0.0, 0.285)), lorry, bevel=0.006
    )
    for y in (-0.23, 0.23):
        add_object(
            "side", box((0.78, 0.03, 0.15)), boards, Pose((-0.23, y, 0.375)), lorry, bevel=0.006
        )
    for x in (-0.605, 0.145):
        add_object(
            "end", box((0.03, 0.43, 0.15)), boards, Pose((x, 0.0, 0.375)), lorry, bevel=0.006
        )


def _load(lorry: Pose, rng: np.random.Generator) -> None:
    ball_colours = [
        textures.jittered(textures.linear_from_hex(c), rng) for c in ("2f7fc1", "f3efe4")
    ]
    ball = principled("ball", textures.stripes(256, 3, *ball_colours, along_u=True), 0.18)
    orange, white = (
        textures.jittered(textures.linear_from_hex(c), rng) for c in ("e8801a", "f4f0e6")
    )
    hat = principled("cone", textures.stripes(256, 3, orange, white), 0.5)
    crate_colours = [textures.linear_from_hex(c) for c in ("5d7a3a", "a9bf6a")]
    crate = principled("crate", textures.checker(128, 4, *crate_colours), 0.7)
    floor = 0.305
    lift = float(rng.uniform(-0.02, 0.02))
    tilt = (30.0, 20.0, float(rng.uniform(0, 360)))
    add_object("ball", sphere(0.14), ball, Pose((-0.44, lift, floor + 0.14), tilt), lorry)
    add_object("cone", cone(0.12, 0.34), hat, Pose((-0.15, 0.06, floor)), lorry)
    turn = (0.0, 0.0, float(rng.uniform(10, 60)))
    add_object(
        "crate",
        box((0.14, 0.14, 0.14)),
        crate,
        Pose((0.02, -0.1, floor + 0.07), turn),
        lorry,
        bevel=0.006,
    )
