# SPDX-License-Identifier: GPL-3.0-or-later
"""Curved things with fine texture: a painted vase, a bowl of fruit, a labelled bottle on a mat."""

import numpy as np

from blender_scenes import textures
from blender_scenes.objects import Pose, add_object, principled
from blender_scenes.request import SceneRequest
from blender_scenes.shapes import Shape, lathe, smooth_profile, tube

VASE = [
    (0.0, 0.0), (0.13, 0.0), (0.15, 0.02), (0.24, 0.2), (0.23, 0.36), (0.12, 0.52), (0.085, 0.6),
    (0.1, 0.68), (0.135, 0.72), (0.12, 0.725), (0.075, 0.66), (0.065, 0.6), (0.08, 0.52),
    (0.0, 0.42),
]  # fmt: skip
BOWL = [
    (0.0, 0.0), (0.11, 0.0), (0.12, 0.025), (0.22, 0.08), (0.29, 0.17), (0.305, 0.2),
    (0.29, 0.205), (0.26, 0.165), (0.19, 0.095), (0.1, 0.055), (0.0, 0.045),
]  # fmt: skip
BOTTLE = [
    (0.0, 0.0), (0.1, 0.0), (0.12, 0.015), (0.122, 0.06), (0.122, 0.32), (0.12, 0.38),
    (0.075, 0.46), (0.042, 0.52), (0.04, 0.62), (0.05, 0.625), (0.05, 0.665), (0.044, 0.675),
    (0.0, 0.68),
]  # fmt: skip
APPLE = [
    (0.0, 0.012), (0.04, 0.0), (0.09, 0.025), (0.125, 0.09), (0.132, 0.14), (0.11, 0.2),
    (0.06, 0.222), (0.02, 0.205), (0.0, 0.19),
]  # fmt: skip
MAT_RADIUS = 0.84


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Adds mat, vase, bowl, fruit and bottle, placed and painted by `rng`."""
    del request
    table = Pose(degrees=(0.0, 0.0, float(rng.uniform(0.0, 360.0))))
    _mat(table, rng)
    top = 0.015
    nudge = rng.uniform(-0.03, 0.03, (5, 2))
    _vase(Pose((-0.36 + nudge[0, 0], 0.22 + nudge[0, 1], top)), table, rng)
    _bottle(
        Pose((0.3 + nudge[1, 0], 0.36 + nudge[1, 1], top), (0.0, 0.0, float(rng.uniform(0, 360)))),
        table,
        rng,
    )
    bowl = Pose((0.22 + nudge[2, 0], -0.24 + nudge[2, 1], top))
    glaze = principled("glaze", textures.jittered(textures.linear_from_hex("2d6a78"), rng), 0.2)
    add_object("bowl", lathe(smooth_profile(BOWL, 80)), glaze, bowl, table)
    x, y, _ = bowl.location
    _apple(
        Pose((x - 0.09, y + 0.06, top + 0.085), (12.0, -14.0, 0.0)),
        table,
        rng,
        ("b8332a", "d9b44a"),
    )
    _apple(
        Pose((x + 0.1, y - 0.05, top + 0.08), (-14.0, 12.0, 60.0), 0.95),
        table,
        rng,
        ("7a9a34", "c9b653"),
    )
    _apple(
        Pose((-0.3 + nudge[3, 0], -0.32 + nudge[3, 1], top), scale=1.05),
        table,
        rng,
        ("c4622d", "e0c060"),
    )


def _mat(table: Pose, rng: np.random.Generator) -> None:
    u = 2.0 * np.pi * (np.arange(1024) + 0.5) / 1024
    weave = 0.5 + 0.5 * np.sin(48.0 * u)[None, :] * np.sign(np.sin(48.0 * u))[:, None]
    brown, pale = (
        textures.jittered(textures.linear_from_hex(c), rng) for c in ("a88a5c", "d8c69c")
    )
    cloth = textures.mixed(
        brown, pale, np.clip(weave + 0.3 * (textures.noise(1024, 8, rng) - 0.5), 0.0, 1.0)
    )
    disc = lathe(
        np.array(
            [[0, 0], [MAT_RADIUS, 0], [MAT_RADIUS, 0.01], [MAT_RADIUS - 0.006, 0.015], [0, 0.015]]
        )
    )
    planar = [disc.vertices[list(face), :2] / (2.0 * MAT_RADIUS) + 0.5 for face in disc.faces]
    add_object(
        "mat",
        Shape(disc.vertices, disc.faces, planar),
        principled("mat", cloth, 0.85),
        Pose(),
        table,
    )


def _vase(place: Pose, table: Pose, rng: np.random.Generator) -> None:
    clay = textures.jittered(textures.linear_from_hex("d9cdb4"), rng, 0.06)
    blue = textures.jittered(textures.linear_from_hex("27468c"), rng)
    size = 1024
    u = (np.arange(size) + 0.5) / size
    painted = textures.speckled(size, clay, textures.linear_from_hex("b39b76"), 0.08, rng)
    for low, high in ((0.1, 0.115), (0.13, 0.15), (0.44, 0.46), (0.53, 0.535)):
        painted = textures.with_band(painted, low, high, blue)
    wave = 0.3 + 0.035 * np.sin(2 * np.pi * 12 * u)[None, :] * np.cos(2 * np.pi * 3 * u)[None, :]
    for shift in (-0.06, 0.0, 0.06):
        near = np.abs(u[:, None] - wave - shift) < 0.012
        painted = np.where(near[..., None], np.asarray(blue, dtype=np.float32), painted)
    add_object(
        "vase", lathe(smooth_profile(VASE, 96)), principled("vase", painted, 0.32), place, table
    )


def _bottle(place: Pose, table: Pose, rng: np.random.Generator) -> None:
    green = textures.jittered(textures.linear_from_hex("2f5a38"), rng)
    paper = textures.linear_from_hex("eee3c8")
    ink = textures.linear_from_hex("3a2417")
    body = np.broadcast_to(np.asarray(green, dtype=np.float32), (1024, 1024, 3)).copy()
    label = np.broadcast_to(np.asarray(paper, dtype=np.float32), (1024, 1024, 3)).copy()
    texts = [
        ("OLIVE OIL", 0.25, 0.4, 0.05),
        (f"cold pressed {rng.integers(1900, 1999)}", 0.25, 0.33, 0.025),
    ]
    texts += [("OLIVE OIL", 0.72, 0.4, 0.05), ("shake well, keep cool and dark", 0.72, 0.33, 0.022)]
    label = textures.with_text(label, texts, ink)
    for low, high in ((0.262, 0.27), (0.455, 0.463)):
        label = textures.with_band(label, low, high, textures.linear_from_hex("a8382a"))
    body[round(0.25 * 1024) : round(0.475 * 1024)] = label[round(0.25 * 1024) : round(0.475 * 1024)]
    body = textures.with_band(body, 0.83, 1.0, textures.linear_from_hex("a8382a"))
    roughness = np.full((1024, 8), 0.18, dtype=np.float32)
    roughness[round(0.25 * 1024) : round(0.475 * 1024)] = 0.7
    add_object(
        "bottle",
        lathe(smooth_profile(BOTTLE, 128)),
        principled("bottle", body, roughness),
        place,
        table,
    )


def _apple(place: Pose, table: Pose, rng: np.random.Generator, codes: tuple[str, str]) -> None:
    red, yellow = (textures.jittered(textures.linear_from_hex(code), rng) for code in codes)
    size = 512
    v = (np.arange(size)[:, None] + 0.5) / size
    streaks = np.repeat(textures.noise(size, 32, rng)[:1], size, axis=0)
    weight = np.clip(
        1.6 * np.abs(v - 0.55) + 0.7 * (streaks - 0.6) + 0.3 * (textures.noise(size, 8, rng) - 0.5),
        0,
        1,
    )
    skin = principled("apple", textures.mixed(red, yellow, weight), 0.3)
    add_object("apple", lathe(smooth_profile(APPLE, 64), 64), skin, place, table)
    stem = np.array(
        [[0.0, 0.0, 0.0], [0.012, 0.0, 0.03], [0.03, 0.004, 0.055], [0.055, 0.006, 0.07]]
    )
    bark = principled("stem", textures.linear_from_hex("5a4028"), 0.8)
    middle = Pose(place.location, place.degrees, place.scale)
    lifted = Pose((0.0, 0.0, 0.185))
    obj = add_object("stem", tube(stem, 0.008, 12), bark, lifted, middle)
    obj.matrix_world = table.matrix() @ obj.matrix_world
