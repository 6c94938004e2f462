# SPDX-License-Identifier: Apache-2.0
"""What test_delight.py has done in a Blender without a window.

Runs inside Blender after the text of capture_session.py, whose names it uses.
"""

import shutil
from pathlib import Path

import bpy
from capture_session import attempt, settings, told  # taken out before it runs
from mathutils import Vector


def delight(capture, ball, box):
    """An object with a material of its own, de-lit; undone; de-lit again; and one without UVs."""
    answer = {"poll": bpy.ops.robir.delight.poll()}
    bpy.ops.robir.choose_capture(directory=capture)
    target = figure(ball, box)
    answer["may"] = bpy.ops.robir.delight.poll()
    bpy.ops.ed.undo_push(message="before")
    before = state_of(target)
    answer["done"] = attempt(bpy.ops.robir.delight)
    answer["told"] = told()
    answer["before"], answer["after"] = before, state_of(target)
    answer["remembered"] = [d.value for d in target.data.attributes["robir_material_before"].data]
    answer["images"] = sorted(
        node.image.filepath
        for node in target.data.materials[1].node_tree.nodes
        if node.type == "TEX_IMAGE"
    )
    answer["world"] = bpy.context.scene.world.name
    answer["spot"] = spot_on(target)
    answer["again"] = attempt(bpy.ops.robir.delight)
    answer["after_again"] = state_of(target)
    answer["fed"] = fed_as_metal_comes_and_goes(target, Path(answer["told"]["result"]))
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    answer["undone"] = state_of(bpy.data.objects["Figure"])
    target = bpy.data.objects["Figure"]
    target.data.uv_layers.remove(target.data.uv_layers[0])
    target.data.update()
    answer["bare"] = attempt(bpy.ops.robir.delight)
    answer["bare_after"] = state_of(bpy.data.objects["Figure"])
    answer["objects"] = [o.name for o in bpy.data.objects if o.get("robir_result")]
    return answer


def fed_as_metal_comes_and_goes(target, result):
    """Sockets that have a picture after newer results without metal, with it, and without."""
    textures, seen = result / "export" / "textures", []
    metal = textures / "metallic.png"
    for has_metal in (False, True, False):
        metal.unlink(missing_ok=True)
        if has_metal:
            shutil.copyfile(textures / "roughness.png", metal)
        said = attempt(bpy.ops.robir.import_result, directory=str(result))
        nodes = target.data.materials[1].node_tree.nodes
        seen.append([said, sorted(n.label for n in nodes if n.type == "TEX_IMAGE")])
    return seen


def spot_on(target):
    """A spot picked on a face of the object, and its true place; what the others say of it."""
    triangle = target.data.polygons[700]
    corners = [target.data.vertices[v].co for v in triangle.vertices]
    uvs = [target.data.uv_layers[0].uv[loop].vector for loop in triangle.loop_indices]
    middle = sum(corners, Vector()) / len(corners)
    bpy.context.view_layer.update()
    bpy.context.scene.cursor.location = target.matrix_world @ middle
    answer = [attempt(bpy.ops.robir.pick_spot), list(settings().spot_texel)]
    answer.append([sum(uv[k] for uv in uvs) / len(uvs) for k in range(2)])
    answer.append(attempt(bpy.ops.robir.reconstruct)[1])
    return answer


def state_of(target):
    indices = {polygon.material_index for polygon in target.data.polygons}
    return [[m and m.name for m in target.data.materials], sorted(indices), len(bpy.data.worlds)]


def figure(ball, box):
    """The photographed shape as one object with a layout without overlaps, and a material."""
    centre, radius = ball
    low, high = box
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=centre, segments=48, ring_count=24)
    middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=middle)
    cube, sphere = bpy.context.object, bpy.data.objects["Sphere"]
    cube.scale = [b - a for a, b in zip(low, high, strict=True)]
    sphere.select_set(True)
    bpy.ops.object.join()
    target = bpy.context.object
    target.name = "Figure"
    target.data.materials.append(bpy.data.materials.new("Baked by the sun"))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.02)
    bpy.ops.object.mode_set(mode="OBJECT")
    return target
