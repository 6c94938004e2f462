# SPDX-License-Identifier: Apache-2.0
"""Results over UDIM tiles in Blender: every tile shows its own texture, the user's layout stays."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from addon.blenders import run
from addon.test_rendering import headless
from addon.test_result_operators import COMMON
from evaluation import sphere_run
from export.test_stage import Recorder, context
from export.test_tiles import CODES
from export.tiled_run import SIDE, TILES, make_tiled_run, own_uvs
from PIL import Image

from robir.export import stage
from robir.jobs.paths import JobPaths, of_tile, write_json

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> JobPaths:
    """A finished result over three tiles; not to be written to."""
    paths = make_tiled_run(tmp_path_factory.mktemp("tiles") / "sphere run")
    write_json(paths.manifest("geometry"), {"stage": "geometry", "metrics": {"layout": "own"}})
    stage.run(context(paths, Recorder(), renders=False))
    return paths


@pytest.fixture
def tiled(finished, tmp_path) -> JobPaths:
    """A copy for one test."""
    shutil.copytree(finished.root, tmp_path / "sphere run")
    return JobPaths(tmp_path / "sphere run")


@pytest.fixture
def scene():
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def images_of(material) -> dict[str, tuple]:
    """Source, name, tiles and colour space of what feeds a material, by the socket."""
    return {
        node.label: (
            node.image.source,
            node.image.filepath.rpartition("/")[2],
            [tile.number for tile in node.image.tiles] if node.image.source == "TILED" else [],
            node.image.colorspace_settings.name,
        )
        for node in material.node_tree.nodes
        if node.type == "TEX_IMAGE" and any(output.links for output in node.outputs)
    }


TILED = {
    "Base Color": ("TILED", "albedo.<UDIM>.png", TILES.tolist(), "sRGB"),
    "Roughness": ("TILED", "roughness.<UDIM>.png", TILES.tolist(), "Non-Color"),
}


def test_an_imported_result_has_the_users_layout_and_tiled_images(tiled, scene):
    from robir_addon.result.importer import import_result

    asset = import_result(tiled.root, scene).asset
    (material,) = asset.data.materials
    assert images_of(material) == TILED
    uvs = np.array([one.vector[:] for one in asset.data.uv_layers[0].uv]).reshape(-1, 3, 2)
    third = np.floor(own_uvs().mean(axis=1)) @ [1, 10]
    order = np.argsort(third, kind="stable")  # the file has the faces tile by tile
    assert uvs == pytest.approx(own_uvs()[order], abs=1e-6)
    # seams between the tiles are closed like others
    assert len(asset.data.vertices) == 48 * 23 + 2


@pytest.mark.parametrize("fault", ["missing", "damaged"])
def test_missing_and_damaged_tiles_are_told(tiled, scene, fault):
    import bpy

    from robir_addon.engine.errors import ResultError
    from robir_addon.result.importer import import_result

    for tile in TILES if fault == "missing" else TILES[1:2]:
        file = of_tile(tiled.textures / "roughness.png", tile)
        file.unlink() if fault == "missing" else file.write_bytes(file.read_bytes()[:50])
    with pytest.raises(ResultError, match=r"roughness\.<UDIM>\.png"):
        import_result(tiled.root, scene)
    assert fault == "damaged" or not len(bpy.data.objects)


@pytest.mark.parametrize("number", [1000, "1001"])
def test_a_tile_that_cannot_be_is_damage(tiled, number):
    from robir_addon.engine.errors import ResultError
    from robir_addon.result.glb import read_glb

    content = tiled.asset.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    document["materials"][1]["extras"]["udim"] = number
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    tiled.asset.write_bytes(head + text + rest)
    with pytest.raises(ResultError, match="there is no tile"):
        read_glb(tiled.asset)


def test_pictures_beside_each_other_show_every_tile(tiled):
    from robir_addon.result.pictures import compare, compared_views, one_of

    views = compared_views(tiled)
    albedos = [one_of(compare(tiled, view)[1], 2).reshape(-1, 4) for view in views]
    seen = np.concatenate([codes[codes[:, 3] > 0.99, :3] for codes in albedos])
    for code in CODES / 255.0:
        assert (np.abs(seen - code).max(axis=1) < 0.03).any()


@pytest.mark.parametrize("command", [["scene"], ["asset", "--pack"]])
def test_files_for_blender_hold_all_tiles(tiled, command):
    import bpy

    done = headless(*command, tiled.root)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(tiled.textures)
    file = tiled.scene if command == ["scene"] else tiled.library_asset
    bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False, use_scripts=False)
    found = [image for image in bpy.data.images if image.source == "TILED"]
    assert len(found) == 2
    for image in found:
        assert [one.tile_number for one in image.packed_files] == TILES.tolist()
        assert [tuple(tile.size) for tile in image.tiles] == [(SIDE, SIDE)] * 3


DELIGHT = """
def main(archive, result, shape, out):
    import importlib
    import math
    from pathlib import Path

    import numpy as np
    from mathutils import Euler, Vector

    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    scene = bpy.context.scene
    with np.load(shape, allow_pickle=False) as arrays:
        corners, uvs = arrays["corners"], arrays["uvs"]
    data = bpy.data.meshes.new("own")
    data.from_pydata(corners.reshape(-1, 3).tolist(), [],
                     np.arange(3 * len(corners)).reshape(-1, 3).tolist())
    data.uv_layers.new(name="mine").uv.foreach_set("vector", uvs.ravel().astype(np.float32))
    data.materials.append(bpy.data.materials.new("Baked by the sun"))
    target = bpy.data.objects.new("Own", data)
    scene.collection.objects.link(target)
    bpy.context.view_layer.update()
    delight = importlib.import_module(MODULE + ".result.delight")
    mark = importlib.import_module(MODULE + ".result.importer").mark_of
    sent = delight.mesh_file(target, scene.robir, Path(out) / "result")
    target["robir_delit"] = mark(Path(result))
    answer = {"told": delight.give_back(bpy.context, Path(result))}
    answer["file"] = str(sent)
    material = data.materials[1]
    answer["objects"] = [o.name for o in bpy.data.objects if o.type == "MESH"]
    answer["slots"] = [m.name for m in data.materials]
    answer["used"] = sorted({p.material_index for p in data.polygons})
    after = np.empty(2 * len(data.loops), np.float32)
    data.uv_layers["mine"].uv.foreach_get("vector", after)
    answer["uvs kept"] = bool((after == uvs.ravel().astype(np.float32)).all())
    nodes, links = material.node_tree.nodes, material.node_tree.links
    paint = next(n for n in nodes if n.label == "Base Color")
    answer["image"] = [paint.image.source, Path(paint.image.filepath).name,
                       [tile.number for tile in paint.image.tiles]]
    # the texture alone, as it is, from three sides
    shine = nodes.new("ShaderNodeEmission")
    links.new(paint.outputs["Color"], shine.inputs["Color"])
    end = next(n for n in nodes if n.type == "OUTPUT_MATERIAL")
    links.new(shine.outputs["Emission"], end.inputs["Surface"])
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = scene.render.resolution_y = 8
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale, scene.camera = "ORTHO", 0.1, camera
    middle = Vector(corners.reshape(-1, 3).mean(axis=0).tolist())
    for index in range(3):
        turn = math.radians(60 + 120 * index)
        camera.location = middle + 5 * Vector((math.cos(turn), math.sin(turn), 0))
        camera.rotation_euler = Euler((math.pi / 2, 0, turn + math.pi / 2))
        scene.render.filepath = f"{out}/side{index}.png"
        bpy.ops.render.render(write_still=True)
    return answer
"""


def test_the_users_own_object_shows_every_tile_in_its_place(newest, extension_zip, tiled, tmp_path):
    mesh = sphere_run.world_mesh()
    shape = tmp_path / "shape.npz"
    np.savez(shape, corners=mesh.vertices[mesh.faces], uvs=own_uvs())
    out = tmp_path / "out"
    out.mkdir()
    answer = run(
        newest, COMMON + DELIGHT, str(extension_zip), str(tiled.root), str(shape), str(out),
        user=tmp_path / "user",
    )  # fmt: skip
    assert answer["objects"] == ["Own"]
    assert answer["slots"] == ["Baked by the sun", "Own de-lit"] and answer["used"] == [1]
    assert answer["uvs kept"]
    assert answer["image"] == ["TILED", "albedo.<UDIM>.png", TILES.tolist()]
    for index, codes in enumerate(CODES):
        with Image.open(out / f"side{index}.png") as picture:
            seen = np.array(picture.convert("RGB"))[4, 4]
        assert seen == pytest.approx(codes, abs=2), f"from side {index}"
    # what went to the engine has the user's layout too
    from robir.capture.mesh_file import read_mesh

    given = read_mesh(Path(answer["file"]))
    assert given.uvs[given.faces] == pytest.approx(own_uvs(), abs=1e-6)
