# SPDX-License-Identifier: GPL-3.0-or-later
"""What people photograph: packages, bottles, tins, mugs, vases, cushions, toys, tools, figures."""

from collections.abc import Callable

import bpy
import numpy as np

from blender_scenes.imported import import_asset, stand
from blender_scenes.objects import Pose, add_object, add_truth_outputs
from blender_scenes.photographs.finishes import mark_thing, material
from blender_scenes.photographs.recipe import Thing
from blender_scenes.scenes.drawn import COATED, SHARP_DEGREES, solid
from blender_scenes.shapes import Shape, box, cylinder, lathe, smooth_profile, sphere, tube

SEGMENTS = 96

Pieces = list[bpy.types.Object]
_Profile = list[tuple[float, float]]


def add_thing(thing: Thing) -> Pieces:
    """Adds the thing, stands it on z = 0 and makes it show itself in all truth passes."""
    rng = np.random.default_rng(thing.seed)
    pieces = _asset(thing) if thing.file is not None else _BUILDERS[thing.kind](thing, rng)
    stand(pieces, 1.0, (0.0, 0.0, thing.turn))
    for piece in pieces:
        piece.pass_index = 1
    used = {slot.material for piece in pieces for slot in piece.material_slots if slot.material}
    for made in sorted(used, key=lambda m: m.name):
        add_truth_outputs(made)
        mark_thing(made)
    return pieces


def _asset(thing: Thing) -> Pieces:
    if thing.file is None:
        raise ValueError("an asset has a file")
    meshes = import_asset(thing.file, COATED)
    if thing.body.pattern != "own":
        paint = material("body", thing.body, is_unwrapped=False)
        for mesh in meshes:
            mesh.data.materials.clear()
            mesh.data.materials.append(paint)
    return meshes


def _turned(profile: _Profile, count: int = 96) -> Shape:
    return lathe(smooth_profile(profile, count), SEGMENTS)


def _hollow(outside: _Profile, wall: float, floor: float) -> _Profile:
    """A vessel: the outside up to the rim, and the inside down to a floor."""
    rim_radius, rim_height = outside[-1]
    inside = [(max(r - wall, 0.01), h) for r, h in outside[::-1] if h > floor + 0.01]
    lip = [(rim_radius - 0.5 * wall, rim_height + 0.4 * wall)]
    inner_foot = max(inside[-1][0] * 0.9, 0.01)
    return [(0.0, 0.0), *outside, *lip, *inside, (inner_foot, floor), (0.0, floor)]


def _box(thing: Thing, rng: np.random.Generator) -> Pieces:
    a, b, c = (float(x) for x in rng.uniform(0.35, 1.0, 3))
    body = add_object("package", box((a, b, c)), material("body", thing.body), bevel=0.0)
    pieces = [body]
    if rng.random() < 0.4:
        lid = box((1.04 * a, 1.04 * b, 0.22 * c))
        pieces.append(
            add_object("lid", lid, material("trim", thing.trim), Pose((0.0, 0.0, 0.45 * c)))
        )
    return pieces


def _bottle(thing: Thing, rng: np.random.Generator) -> Pieces:
    width, shoulder = float(rng.uniform(0.13, 0.24)), float(rng.uniform(0.5, 0.72))
    neck = float(rng.uniform(0.04, 0.07))
    profile = [
        (0.0, 0.0), (0.85 * width, 0.0), (width, 0.02), (width, 0.08), (width, 0.4 * shoulder),
        (width, shoulder), (0.7 * width, shoulder + 0.09), (neck, shoulder + 0.15),
        (neck, shoulder + 0.2), (0.0, shoulder + 0.2),
    ]  # fmt: skip
    cap = cylinder(1.35 * neck, float(rng.uniform(0.06, 0.14)), rounding=0.008)
    return [
        add_object("bottle", _turned(profile), material("body", thing.body)),
        add_object("cap", cap, material("trim", thing.trim), Pose((0.0, 0.0, shoulder + 0.19))),
    ]


def _tin(thing: Thing, rng: np.random.Generator) -> Pieces:
    radius, height = float(rng.uniform(0.25, 0.45)), float(rng.uniform(0.4, 1.0))
    rim = np.linspace(0.0, 2.0 * np.pi, 97)[:-1]
    metal = material("trim", thing.trim)
    pieces = [add_object("tin", cylinder(radius, height), material("body", thing.body))]
    for z in (0.012, height - 0.004):
        ring = np.array(
            [[0.0, -0.012], [radius + 0.004, -0.012], [radius + 0.016, 0.0],
             [radius + 0.004, 0.014], [radius - 0.02, 0.012], [radius - 0.026, 0.006],
             [0.0, 0.006]]
        )  # fmt: skip
        pieces.append(add_object("rim", lathe(ring, len(rim)), metal, Pose((0.0, 0.0, z))))
    return pieces


def _mug(thing: Thing, rng: np.random.Generator) -> Pieces:
    radius, height = float(rng.uniform(0.28, 0.4)), float(rng.uniform(0.6, 0.95))
    waist = radius * float(rng.uniform(0.85, 1.1))
    outside = [
        (0.85 * radius, 0.0), (0.95 * radius, 0.03), (waist, 0.4 * height), (radius, 0.8 * height),
        (radius, height),
    ]  # fmt: skip
    turn = np.linspace(-0.43, 0.43, 32) * np.pi
    reach = float(rng.uniform(0.16, 0.24))
    arc = np.stack(
        [
            max(waist, radius) - 0.02 + reach * np.cos(turn),
            0.0 * turn,
            0.48 * height + 0.3 * np.sin(turn),
        ],
        axis=1,
    )
    # a tube is made for paths near the x-y plane: lay it down, then raise it
    flat = np.stack([arc[:, 0], arc[:, 2], arc[:, 1]], axis=1)
    handle = tube(flat, 0.045, squash=1.3)
    body = material("body", thing.body)
    trim = body if rng.random() < 0.4 else material("trim", thing.trim)
    return [
        add_object("mug", _turned(_hollow(outside, 0.035, 0.05)), body),
        add_object("handle", handle, trim, Pose(degrees=(90.0, 0.0, 0.0))),
    ]


def _bowl(thing: Thing, rng: np.random.Generator) -> Pieces:
    height = float(rng.uniform(0.28, 0.5))
    outside = [(0.18, 0.0), (0.2, 0.03), (0.36, 0.35 * height), (0.47, 0.8 * height), (0.5, height)]
    pieces = [
        add_object("bowl", _turned(_hollow(outside, 0.03, 0.05)), material("body", thing.body))
    ]
    fruit = material("trim", thing.trim)
    for turn in range(int(rng.integers(0, 4))):
        angle = 2.1 * turn + float(rng.uniform(0.0, 0.3))
        place = (0.18 * float(np.cos(angle)), 0.18 * float(np.sin(angle)), 0.55 * height + 0.06)
        pieces.append(add_object("fruit", _pebble(rng, 0.13), fruit, Pose(place)))
    return pieces


def _vase(thing: Thing, rng: np.random.Generator) -> Pieces:
    """Narrow at the neck and deep: its inside is black in every photograph."""
    belly, neck = float(rng.uniform(0.24, 0.36)), float(rng.uniform(0.09, 0.17))
    outside = [
        (0.6 * belly, 0.0), (0.7 * belly, 0.02), (belly, 0.4), (0.7 * belly, 0.65), (neck, 0.82),
        (neck, 0.9), (1.25 * neck, 1.0),
    ]  # fmt: skip
    return [
        add_object("vase", _turned(_hollow(outside, 0.022, 0.06)), material("body", thing.body))
    ]


def _pebble(rng: np.random.Generator, radius: float) -> Shape:
    """A ball, egg or pebble."""
    ball = sphere(radius)
    long, flat, taper = rng.uniform(0.75, 1.0), rng.uniform(0.6, 1.0), rng.uniform(-0.2, 0.2)
    points = ball.vertices * np.array([1.0, long, flat])
    points[:, :2] *= 1.0 + taper * points[:, 2:] / radius
    return Shape(points, ball.faces, ball.uvs)


def _egg(thing: Thing, rng: np.random.Generator) -> Pieces:
    lying = Pose(degrees=(float(rng.uniform(60.0, 90.0)) * (rng.random() < 0.6), 0.0, 0.0))
    return [add_object("egg", _pebble(rng, 0.5), material("body", thing.body), lying)]


def _cushion(thing: Thing, rng: np.random.Generator) -> Pieces:
    """A stuffed square: a ball drawn out to its corners, with a button."""
    ball = sphere(1.0)
    x, y, z = ball.vertices.T
    share, thick = float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.3, 0.5))
    side = np.maximum(np.abs(x), np.abs(y)) / np.maximum(np.hypot(x, y), 1e-9)
    pulled = 1.0 / np.maximum(side, 1e-9) * share + (1.0 - share)
    dent = 1.0 - 0.3 * np.exp(-(x**2 + y**2) / 0.03)
    points = 0.5 * np.stack([x * pulled, y * pulled, thick * z * dent], axis=1)
    # seen from above and below: the cloth lies flat on either side
    flat = [0.5 + 0.5 * points[list(face), :2] for face in ball.faces]
    cloth = add_object(
        "cushion", Shape(points, ball.faces, flat), material("body", thing.body),
        Pose(degrees=(float(rng.choice((0.0, 0.0, 70.0))), 0.0, 0.0)),
    )  # fmt: skip
    return [cloth]


def _toy(thing: Thing, rng: np.random.Generator) -> Pieces:
    """Blocks and balls of plastic, held together by screws."""
    pieces, top = [], 0.0
    body, trim = material("body", thing.body), material("trim", thing.trim)
    for _ in range(int(rng.integers(2, 4))):
        a, b, c = (float(v) for v in rng.uniform(0.25, 0.6, 3))
        kind = str(rng.choice(("box", "cylinder")))
        turn = Pose((0.0, 0.0, top), (0.0, 0.0, float(rng.uniform(0.0, 90.0))))
        if kind == "box":
            block, lift = box((a, b, 0.7 * c)), 0.35 * c
        else:
            block, lift = cylinder(0.5 * a, 0.7 * c, rounding=0.02), 0.0
        raised = Pose((0.0, 0.0, top + lift), turn.degrees)
        pieces.append(add_object("block", block, body, raised))
        for step in range(3):
            angle = 2.1 * step + 0.4
            reach = 0.32 * min(a, b if kind == "box" else a)
            place = (reach * float(np.cos(angle)), reach * float(np.sin(angle)), top + 0.7 * c)
            screw = cylinder(0.028, 0.02, rounding=0.006)
            pieces.append(add_object("screw", screw, trim, Pose(place)))
        top += 0.7 * c
    ball = add_object("ball", sphere(0.16), trim, Pose((0.0, 0.0, top + 0.15)))
    return [*pieces, ball]


def _carving(thing: Thing, rng: np.random.Generator) -> Pieces:
    """Turned or cut wood or clay, with a knob."""
    body = material("body", thing.body)
    kind = str(rng.choice(("lathe", "lathe", "tube", "cone")))
    piece = add_object("carving", solid(kind, rng), body)
    if kind in ("tube", "cone"):
        return [piece]
    top = max(v.co.z for v in piece.data.vertices)
    knob = add_object("knob", sphere(0.07), material("trim", thing.trim), Pose((0.0, 0.0, top)))
    return [piece, knob]


def _tool(thing: Thing, rng: np.random.Generator) -> Pieces:
    """A handle with a metal shaft, lying."""
    length = float(rng.uniform(0.35, 0.5))
    grip = [
        (0.0, 0.0), (0.07, 0.0), (0.09, 0.05), (0.075, 0.4 * length), (0.09, 0.8 * length),
        (0.06, length), (0.0, length),
    ]  # fmt: skip
    lying = Pose(degrees=(90.0, 0.0, 0.0))
    shaft = cylinder(float(rng.uniform(0.02, 0.035)), 0.5, rounding=0.004)
    head = box((0.24, 0.1, 0.1))
    trim = material("trim", thing.trim)
    up = Pose((0.0, 0.0, length - 0.01))
    pieces = [
        add_object("grip", _turned(grip), material("body", thing.body), Pose(), lying),
        add_object("shaft", shaft, trim, up, lying),
    ]
    if rng.random() < 0.6:
        pieces.append(add_object("head", head, trim, Pose((0.0, 0.0, length + 0.46)), lying))
    return pieces


def _figure(thing: Thing, rng: np.random.Generator) -> Pieces:
    """Blender's monkey, on a foot."""
    bpy.ops.mesh.primitive_monkey_add()
    head = bpy.context.object
    head.modifiers.new("subdivision", "SUBSURF").levels = 2
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(head.evaluated_get(graph))
    head.modifiers.clear()
    head.data = mesh
    mesh.materials.clear()
    mesh.materials.append(material("body", thing.body, is_unwrapped=False))
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=float(np.radians(SHARP_DEGREES)))
    head.location = (0.0, 0.0, 1.15)
    head.rotation_euler = (float(np.radians(rng.uniform(-20.0, 5.0))), 0.0, 0.0)
    foot = cylinder(0.7, 0.3, rounding=0.05)
    return [head, add_object("foot", foot, material("trim", thing.trim))]


_BUILDERS: dict[str, Callable[[Thing, np.random.Generator], Pieces]] = {
    "box": _box, "bottle": _bottle, "tin": _tin, "mug": _mug, "bowl": _bowl, "vase": _vase,
    "egg": _egg, "cushion": _cushion, "toy": _toy, "carving": _carving, "tool": _tool,
    "figure": _figure,
}  # fmt: skip
