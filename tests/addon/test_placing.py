# SPDX-License-Identifier: Apache-2.0
"""A result in its real size and place, without its ground, and what a newer one keeps of that."""

import numpy as np
import pytest
import trimesh
from addon.blenders import run
from addon.test_result_operators import COMMON
from evaluation import sphere_run
from PIL import Image

from robir.capture.store import load_capture
from robir.export.stage import export_cameras
from robir.jobs.paths import read_json, write_json

pytestmark = pytest.mark.blender

HIGH = 0.5  # height of the ground in the test above the sphere's middle, unit frame

PLACE = """
import bmesh


def where(asset):
    corners = [v.co[:] for v in asset.data.vertices]
    bpy.context.view_layer.update()
    world = [asset.matrix_world @ v.co for v in asset.data.vertices]
    return {
        "low": [min(p[k] for p in world) for k in range(3)],
        "high": [max(p[k] for p in world) for k in range(3)],
        "scale": list(asset.scale),
        "origin": list(asset.matrix_world.translation),
        "faces": len(asset.data.polygons),
        "normal": list(asset.data.corner_normals[0].vector),
        "cameras": {
            o.name: list(o.location) for o in bpy.data.objects if o.type == "CAMERA"
        },
    }


def crumb(asset):
    mesh = bmesh.new()
    mesh.from_mesh(asset.data)
    for across in (0.0, 0.1):
        mesh.faces.new([mesh.verts.new((across + x, y, 9.0)) for x, y in ((0, 0), (1, 0), (0, 1))])
    mesh.to_mesh(asset.data)
    mesh.free()


def main(archive, result):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    bpy.ops.ed.undo_push(message="start")
    answer = {"early": call("drop_ground")}
    call("import_result", directory=result)
    scene = bpy.context.scene
    asset = bpy.context.object
    answer["imported"] = where(asset)
    answer["no length"] = call("set_real_size", first=(0, 0, 0), second=(0, 0, 0), length=1.0)
    answer["sized"] = [
        call("set_real_size", first=(0, 0, 0), second=(0, 0.5, 0), length=1.5), where(asset)]
    answer["size"] = max(asset.dimensions)
    answer["stood"] = [call("stand_on_floor"), where(asset)]
    answer["refreshed"] = [call("refresh_result"), where(asset)]
    answer["again"] = [call("import_result"), where(asset)]  # not edited: nobody is asked
    answer["whole"] = len(asset.data.polygons)
    crumb(asset)
    answer["crumbled"] = len(asset.data.polygons)
    answer["dropped"] = [call("drop_ground", height=0.0), where(asset)]
    answer["edited"] = call("import_result")
    answer["nothing"] = call("drop_ground", height=0.0)
    answer["no box"] = call("crop_to_box")
    box = bpy.data.objects.new("box", None)
    scene.collection.objects.link(box)
    box.empty_display_size, box.location = 10.0, (10.0, 0.0, 0.0)
    scene.robir.box = box
    bpy.context.view_layer.update()
    answer["cropped"] = [call("crop_to_box"), where(asset)]
    bpy.ops.ed.undo()
    answer["undone"] = len(bpy.context.object.data.polygons)
    return answer
"""


@pytest.fixture
def on_ground(result):
    """The sphere's result, ground said to lie across it."""
    write_json(result.ground, {"normal": [0.0, 0.0, 1.0], "offset": HIGH})
    export_cameras(result, load_capture(result.stage("capture")))
    return result


def test_a_result_is_sized_placed_and_freed_of_its_ground(
    blender, extension_zip, on_ground, tmp_path
):
    ground = read_json(on_ground.cameras)["ground"]
    assert ground["offset"] == pytest.approx(sphere_run.CENTRE[2] + HIGH * sphere_run.RADIUS)
    answer = run(
        blender, COMMON + PLACE, str(extension_zip), str(on_ground.root), user=tmp_path / "user"
    )
    assert "Import a result first" in answer["early"]
    assert "no length was given" in answer["no length"]
    before, (done, sized) = answer["imported"], answer["sized"]
    assert done == ["FINISHED"]
    assert answer["size"] == pytest.approx(6 * sphere_run.SPHERE * sphere_run.RADIUS, rel=0.01)
    # three times as large about the object's origin, which is the capture's
    np.testing.assert_allclose(sized["low"], 3 * np.array(before["low"]), atol=1e-5)
    np.testing.assert_allclose(sized["high"], 3 * np.array(before["high"]), atol=1e-5)
    assert sized["scale"] == [1.0, 1.0, 1.0] and sized["origin"] == before["origin"]
    for name, place in before["cameras"].items():
        np.testing.assert_allclose(sized["cameras"][name], 3 * np.array(place), atol=1e-5)
    stood = answer["stood"][1]
    side = 3 * sphere_run.SPHERE * sphere_run.RADIUS
    level = 3 * HIGH * sphere_run.RADIUS  # the ground is the foot, whatever hangs below
    np.testing.assert_allclose(stood["low"], [-side, -side, -side - level], atol=0.02 * side)
    np.testing.assert_allclose(stood["high"], [side, side, side - level], atol=0.02 * side)
    assert stood["origin"] == [0.0, 0.0, 0.0]
    moved = np.array(stood["low"]) - sized["low"]
    for name, place in sized["cameras"].items():
        np.testing.assert_allclose(stood["cameras"][name], place + moved, atol=1e-4)
    for later in ("refreshed", "again"):
        done, there = answer[later]
        assert done == ["FINISHED"]
        for key in ("low", "high", "normal"):
            np.testing.assert_allclose(there[key], stood[key], atol=1e-4)
        assert there["cameras"].keys() == stood["cameras"].keys()
        for name, place in stood["cameras"].items():
            np.testing.assert_allclose(there["cameras"][name], place, atol=1e-4)
    dropped = answer["dropped"][1]
    row = np.pi / 24 * side
    assert dropped["low"][2] == pytest.approx(0.0, abs=1e-4)  # it stands again
    assert dropped["high"][2] == pytest.approx(stood["high"][2], abs=row)
    assert dropped["origin"] == [0.0, 0.0, 0.0]
    assert answer["crumbled"] == answer["whole"] + 2  # and nothing hangs in the air
    assert 0 < dropped["faces"] < 0.4 * stood["faces"]
    np.testing.assert_allclose(np.linalg.norm(dropped["normal"]), 1.0, atol=1e-3)
    assert "edited and would be lost" in answer["edited"]
    assert "nothing of the object to delete" in answer["nothing"]
    assert "no object box" in answer["no box"]
    cropped = answer["cropped"][1]
    assert cropped["low"][0] > -row and cropped["high"][0] == pytest.approx(dropped["high"][0])
    assert answer["undone"] == dropped["faces"]


LEVELS = """
def main(archive, result, out):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    bpy.context.scene.robir.result = result
    answer = {"early": call("export_glb", filepath=out + "/a.glb", most_faces=9)}
    call("import_result", directory=result)
    asset = bpy.context.object
    before = census()
    answer["few"] = call("export_glb", filepath=out + "/a.glb", most_faces=1000,
                         texture_side="512")
    answer["small"] = call("export_glb", filepath=out + "/small.glb", texture_side="1024")
    answer["left"] = [before, census(), [m.name for m in asset.modifiers], len(asset.data.polygons)]
    return answer
"""


def test_a_file_has_as_few_faces_and_texels_as_asked(own_blender, extension_zip, result, tmp_path):
    """Read by trimesh; the sphere's textures of 128 pixels are made larger first."""
    for file in result.textures.glob("*.png"):
        with Image.open(file) as image:
            image.resize((1024, 1024), Image.Resampling.NEAREST).save(file)
    files = (str(extension_zip), str(result.root), str(tmp_path))
    answer = run(own_blender, COMMON + LEVELS, *files, user=tmp_path / "user")
    assert "import the result first" in answer["early"]
    assert answer["few"] == answer["small"] == ["FINISHED"]
    before, after, modifiers, faces = answer["left"]
    assert (before, modifiers, faces) == (after, [], len(sphere_run.sphere_mesh().faces))
    found = {}
    for file in tmp_path.glob("*.glb"):
        (mesh,) = trimesh.load(file, process=False).geometry.values()
        found[file.name] = (len(mesh.faces), mesh.visual.material.baseColorTexture.size)
        distance = np.linalg.norm(mesh.vertices - mesh.vertices.mean(0), axis=1)
        assert distance == pytest.approx(sphere_run.SPHERE * sphere_run.RADIUS, rel=0.2)
    assert found.keys() == {"a.glb", "small.glb"}
    count, size = found["a.glb"]
    assert 700 < count <= 1002 and size == (512, 512)
    assert found["small.glb"] == (faces, (1024, 1024))
