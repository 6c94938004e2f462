# SPDX-License-Identifier: Apache-2.0
"""What test_known.py has done in a Blender without a window.

Runs inside Blender after the text of capture_session.py, whose names it uses.
"""

import json
import math
from pathlib import Path

import bpy
from capture_session import attempt, module, settings  # taken out before it runs
from mathutils import Matrix, Vector

TURN = Matrix.Rotation(0.7, 4, Vector((1.0, 2.0, -1.0)).normalized())


def spots(result, places):
    """Spots of an imported result that was scaled, turned and shifted."""
    answer = {"early": attempt(bpy.ops.robir.pick_spot)}
    bpy.ops.robir.import_result(directory=result)
    asset = bpy.context.object
    asset.matrix_world = Matrix.Translation((3, -2, 1)) @ TURN @ Matrix.Scale(2.5, 4)
    bpy.context.view_layer.update()
    scene = bpy.context.scene
    answer["found"] = []
    for place in places:
        scene.cursor.location = asset.matrix_world @ Vector(place)
        said = attempt(bpy.ops.robir.pick_spot)
        answer["found"].append([said, list(settings().spot_texel), settings().spot_result])
    size = max(asset.dimensions)
    middle = sum((Vector(c) for c in asset.bound_box), Vector()) / 8
    away = [(asset.matrix_world.to_3x3() @ (Vector(p) - middle)).normalized() for p in places]
    answer["near"] = off(asset, places[0], 0.04 * size * away[0])
    before = list(settings().spot_texel)
    answer["far"] = off(asset, places[1], 0.07 * size * away[1])
    answer["kept"] = before == list(settings().spot_texel)
    asset.hide_viewport = True
    answer["hidden"] = off(asset, places[0], Vector())
    asset.hide_viewport = False
    asset.data.uv_layers.remove(asset.data.uv_layers[0])
    asset.data.update()
    answer["bare"] = off(asset, places[0], Vector())
    answer["forgotten"] = [attempt(bpy.ops.robir.forget_spot), settings().spot_result]
    answer["may_forget"] = bpy.ops.robir.forget_spot.poll()
    bpy.data.objects.remove(asset)
    answer["gone"] = attempt(bpy.ops.robir.pick_spot)
    return answer


def off(asset, place, shift):
    """Pick beside a place of the object."""
    bpy.context.view_layer.update()
    bpy.context.scene.cursor.location = asset.matrix_world @ Vector(place) + shift
    return attempt(bpy.ops.robir.pick_spot)


def grid(corners):
    """Texture coordinates on a mesh of quads whose layers are functions of the place.

    The object is stretched, turned and shifted, and doubled by a modifier; the layer that is
    rendered is not the first.
    """
    side, places = 4, []
    for row in range(side + 1):
        places += [(column - 2.0, row - 2.0, 0.3 * column) for column in range(side + 1)]
    faces = [
        (i, i + 1, i + side + 2, i + side + 1)
        for row in range(side)
        for i in range(row * (side + 1), row * (side + 1) + side)
    ]
    mesh = bpy.data.meshes.new("grid")
    mesh.from_pydata(places, [], faces)
    for name, scale in (("other", 0.01), ("rendered", 1.0)):
        layer = mesh.uv_layers.new(name=name)
        for loop in mesh.loops:
            x, y, _ = places[loop.vertex_index]
            layer.uv[loop.index].vector = (0.5 + 0.2 * scale * x, 0.4 - 0.1 * scale * y)
    mesh.uv_layers["rendered"].active_render = True
    mesh.uv_layers.active = mesh.uv_layers["other"]
    shown = bpy.data.objects.new("grid", mesh)
    bpy.context.scene.collection.objects.link(shown)
    array = shown.modifiers.new("doubled", "ARRAY")
    array.use_relative_offset, array.use_constant_offset = False, True
    array.constant_offset_displace = (0.0, 0.0, 9.0)
    shown.matrix_world = Matrix.Translation((5, 6, 7)) @ TURN @ Matrix.Diagonal((2, 3, 0.5, 1))
    bpy.context.view_layer.update()
    place = shown.matrix_world
    return [module("result.known").texel_at(shown, place @ Vector(point)) for point in corners]


def lamp_of(kind, turn):
    data = bpy.data.lights.new("lamp", kind)
    lamp = bpy.data.objects.new("lamp", data)
    bpy.context.scene.collection.objects.link(lamp)
    lamp.matrix_world = turn
    bpy.context.view_layer.objects.active = lamp
    return lamp


def suns(result):
    """The direction of a turned lamp: without a result, with one, and with one that was turned."""
    answer = {"poll": bpy.ops.robir.take_sun.poll()}
    lamp_of("POINT", Matrix())
    answer["point"] = attempt(bpy.ops.robir.take_sun)
    turn = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(math.radians(30), 4, "X")
    lamp_of("SUN", turn)
    settings().view_scale, settings().view_shift = 7.0, (1, 2, 3)
    answer["taken"] = attempt(bpy.ops.robir.take_sun)
    answer["plain"] = list(settings().sun)
    bpy.ops.robir.import_result(directory=result)
    asset = bpy.context.object
    lamp = lamp_of("SUN", turn)
    attempt(bpy.ops.robir.take_sun)
    answer["shown"] = list(settings().sun)
    quarter = Matrix.Rotation(math.radians(90), 4, "Z")
    asset.matrix_world = Matrix.Translation((4, 0, 0)) @ quarter @ Matrix.Scale(3.0, 4)
    attempt(bpy.ops.robir.take_sun)
    answer["turned"] = list(settings().sun)
    hub = bpy.data.objects.new("hub", None)
    bpy.context.scene.collection.objects.link(hub)
    lamp.parent, hub.matrix_world = hub, quarter
    attempt(bpy.ops.robir.take_sun)
    answer["both turned"] = list(settings().sun)
    answer["forgotten"] = [attempt(bpy.ops.robir.forget_sun), list(settings().sun)]
    answer["may_forget"] = bpy.ops.robir.forget_sun.poll()
    return answer


def requests(result, capture, other):
    """What the engine is asked for, what is refused, and what another capture forgets."""
    worker, known = module("work.worker"), module("result.known")
    attempt(bpy.ops.robir.choose_capture, directory=capture)
    bpy.ops.robir.import_result(directory=result)
    answer = {"nothing": worker.request_of(settings()).words(), "out": settings().out}
    asset = bpy.context.object
    answer["picked"] = off(asset, asset.data.vertices[100].co, Vector())
    settings().spot_texel, settings().sun = (0.25, 0.75), (0.0, 0.6, 0.8)
    settings().spot_albedo, settings().tone_curve = (0.5, 0.25, 1.0), "agx"
    request = worker.request_of(settings())
    answer["words"] = request.words()

    def refusal():
        try:
            known.check_spot(settings(), worker.request_of(settings()))
        except module("engine.errors").RequestError as fault:
            return str(fault)
        return ""

    answer["elsewhere"] = refusal()
    settings().out = result
    answer["here"] = refusal()
    settings().texture = "4K"
    answer["finer"], answer["larger"] = refusal(), asked()[:2]
    settings().texture = "2K"
    answer["usual"] = known.SIDES["2K"]
    manifest = Path(result) / "stages" / "geometry" / "stage.json"
    manifest.write_text(json.dumps({"stage": "geometry", "fingerprint": "another"}))
    answer["changed"] = refusal()
    answer["refreshed"] = attempt(bpy.ops.robir.refresh_result)
    state = bpy.context.window_manager.robir
    answer["after"] = [settings().spot_result, settings().sun[1], state.message]
    off(asset, asset.data.vertices[100].co, Vector())
    answer["picked again"] = refusal()
    attempt(bpy.ops.robir.choose_capture, directory=capture)
    answer["same"] = asked()
    attempt(bpy.ops.robir.choose_capture, directory=other)
    answer["other"], answer["colour"] = asked(), list(settings().spot_albedo)
    return answer


def asked():
    return list(module("work.worker").request_of(settings()).settings)


def curves():
    """The tone curves that can be chosen."""
    return [item.identifier for item in settings().bl_rna.properties["tone_curve"].enum_items]
