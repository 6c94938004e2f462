# SPDX-License-Identifier: GPL-3.0-or-later
"""What a recipe says: things of many shapes, alone or in a heap, with or without ground."""

import bpy
import numpy as np

from blender_scenes.imported import KEPT_SOCKETS, import_asset, stand
from blender_scenes.objects import Pose, add_object
from blender_scenes.paint import material
from blender_scenes.recipe import Ground, Part
from blender_scenes.request import SceneError, SceneRequest
from blender_scenes.shapes import Shape, box, cone, cylinder, lathe, smooth_profile, sphere, tube

COATED = (
    *KEPT_SOCKETS,
    "Coat Weight", "Coat Roughness", "Coat IOR", "Coat Tint",
    "Sheen Weight", "Sheen Roughness", "Sheen Tint",
)  # fmt: skip
"""Inputs of an asset's material that stay: the truth describes the layer below coat and sheen."""

SHARP_DEGREES = 35.0
"""Edges sharper than this stay edges."""

THICKNESS = {"disc": 0.03, "mat": 0.012, "table": 0.05}
"""Of a ground by its shape, scene units."""


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Adds the parts and the ground of `request.recipe`; nothing is left to `rng`."""
    del rng
    if request.recipe is None:
        raise SceneError("scene 'drawn' needs a recipe; make it with: population DIR")
    for index, part in enumerate(request.recipe.parts):
        stand(_meshes(f"part_{index}", part), part.size, part.degrees, part.place)
    if request.recipe.ground is not None:
        _add_ground(request.recipe.ground)


def _meshes(name: str, part: Part) -> list[bpy.types.Object]:
    """The part as it is made, neither scaled nor in place."""
    if part.file is not None:
        meshes = import_asset(part.file, COATED)
        if part.paint.pattern != "own":
            paint = material(name, part.paint, part.seed, is_unwrapped=False)
            for obj in meshes:
                obj.data.materials.clear()
                obj.data.materials.append(paint)
        return meshes
    rng = np.random.default_rng(part.seed)
    is_unwrapped = part.kind not in ("monkey", "boolean")
    paint = material(name, part.paint, part.seed, is_unwrapped)
    if part.kind == "monkey":
        bpy.ops.mesh.primitive_monkey_add()
        head = bpy.context.object
        head.modifiers.new("subdivision", "SUBSURF").levels = 2
        return [_applied(head, paint)]
    if part.kind == "boolean":
        return [_applied(_boolean(rng, paint), paint)]
    return [add_object(name, solid(part.kind, rng), paint)]


def solid(kind: str, rng: np.random.Generator) -> Shape:
    """A shape of about unit size with random proportions.

    Args:
        kind: one of `recipe.KINDS` but asset, monkey and boolean.
        rng: draws the proportions.
    """
    a, b, c = rng.uniform(0.35, 1.0, 3)
    if kind == "box":
        return box((float(a), float(b), float(c)))
    if kind == "cylinder":
        return cylinder(0.5 * float(a), float(b), rounding=0.04)
    if kind == "cone":
        return cone(0.5 * float(a), float(b))
    if kind == "sphere":
        return sphere(0.5)
    if kind == "tube":
        turn = np.linspace(0.0, rng.uniform(0.5, 1.7) * np.pi, 48)
        arc = np.stack([np.cos(turn), np.sin(turn), 0.25 * c * turn], axis=1)
        return tube(0.4 * arc, 0.08 + 0.1 * float(a))
    return lathe(smooth_profile(_profile(rng), 80), 80)


def _profile(rng: np.random.Generator) -> list[tuple[float, float]]:
    """Radius and height of a turned shape: a foot, a few swells, a rounded top."""
    height, count = rng.uniform(0.5, 1.4), int(rng.integers(3, 7))
    radii = rng.uniform(0.1, 0.5, count)
    heights = height * np.sort(rng.uniform(0.05, 0.95, count))
    foot = float(rng.uniform(0.15, 0.4))
    swells = [(float(r), float(h)) for r, h in zip(radii, heights, strict=True)]
    return [(0.0, 0.0), (foot, 0.0), (foot, 0.02), *swells, (0.0, float(height))]


def _boolean(rng: np.random.Generator, paint: bpy.types.Material) -> bpy.types.Object:
    """A block less, with, or cut by one or two others; the result is a modifier away."""
    kinds = ("box", "cylinder", "sphere")
    block = add_object("block", solid(str(rng.choice(kinds[:2])), rng), paint)
    for _ in range(int(rng.integers(1, 3))):
        tool_shape = solid(str(rng.choice(kinds)), rng)
        place, turn = rng.uniform(-0.3, 0.3, 3), rng.uniform(0.0, 180.0, 3)
        (x, y, z), (a, b, c) = map(float, place), map(float, turn)
        pose = Pose((x, y, z), (a, b, c), float(rng.uniform(0.5, 0.9)))
        tool = add_object("tool", tool_shape, paint, pose)
        modifier = block.modifiers.new("cut", "BOOLEAN")
        modifier.object = tool
        modifier.operation = str(rng.choice(("DIFFERENCE", "DIFFERENCE", "UNION")))
        modifier.solver = "EXACT"
    return block


def _applied(obj: bpy.types.Object, paint: bpy.types.Material) -> bpy.types.Object:
    """Turns the modifiers of an object into its mesh; what they used is removed."""
    bpy.context.view_layer.update()
    mesh = bpy.data.meshes.new_from_object(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    tools = [m.object for m in obj.modifiers if m.type == "BOOLEAN"]
    obj.modifiers.clear()
    for tool in tools:
        bpy.data.objects.remove(tool)
    obj.data = mesh
    mesh.materials.clear()
    mesh.materials.append(paint)
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=float(np.radians(SHARP_DEGREES)))
    return obj


def _add_ground(ground: Ground) -> None:
    """Adds the ground with its upper side at z = 0, its texture seen from above."""
    thickness = THICKNESS[ground.shape]
    if ground.shape == "table":
        shape, drop = box((2.0 * ground.size, 2.0 * ground.size, thickness)), -0.5 * thickness
    else:
        shape, drop = cylinder(ground.size, thickness, rounding=0.4 * thickness), -thickness
    flat = [shape.vertices[list(face), :2] / (2.0 * ground.size) + 0.5 for face in shape.faces]
    paint = material("ground", ground.paint, ground.seed, is_unwrapped=True)
    seen = Shape(shape.vertices, shape.faces, flat)
    add_object("ground", seen, paint, Pose((0.0, 0.0, drop)))
