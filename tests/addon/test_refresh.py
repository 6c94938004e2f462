# SPDX-License-Identifier: Apache-2.0
"""A newer result comes: what the user did to object, light and camera stays, in every Blender."""

import pytest
from addon.blenders import run
from addon.test_result_operators import COMMON

pytestmark = pytest.mark.blender

KEPT = """
def main(archive, result):
    import os
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    scene = bpy.context.scene
    call("import_result", directory=result)
    asset = bpy.context.object
    corners = len(asset.data.vertices)
    asset.location, asset.name = (1, 2, 3), "mine"
    asset.modifiers.new("bent", "SIMPLE_DEFORM")
    asset.constraints.new("LIMIT_LOCATION")
    own = bpy.data.collections.new("own")
    scene.collection.children.link(own)
    own.objects.link(asset)
    bpy.data.collections["sphere run"].objects.unlink(asset)
    material = asset.data.materials[0]
    material.node_tree.nodes["Principled BSDF"].inputs["Coat Weight"].default_value = 0.25
    scene.camera = next(o for o in scene.objects if o.get("robir_view") == "train_001")
    scene.robir.light = "city"
    scene.robir.rotation = 0.5
    # a newer result: half as rough, and with metal
    from pathlib import Path
    textures = Path(result) / "export/textures"
    rough = bpy.data.images.load(str(textures / "roughness.png"))
    pixels = [0.5 * p if n % 4 < 3 else p for n, p in enumerate(rough.pixels)]
    rough.pixels = pixels
    rough.filepath_raw = str(textures / "metallic.png")
    rough.save()
    bpy.data.images.remove(rough)
    answer = {"said": call("refresh_result")}

    def kept():
        nodes = material.node_tree.nodes
        fed = [n.label for n in nodes if n.type == "TEX_IMAGE" and n.image]
        return {
            "name": bpy.context.object.name, "place": list(asset.location),
            "modifiers": [m.name for m in asset.modifiers],
            "constraints": len(asset.constraints),
            "homes": [c.name for c in asset.users_collection],
            "coat": nodes["Principled BSDF"].inputs["Coat Weight"].default_value,
            "material": asset.data.materials[0] == material, "fed": sorted(fed),
            "camera": scene.camera.get("robir_view"), "light": light(),
            "rotation": scene.robir.rotation, "meshes": len(bpy.data.meshes),
            "corners": len(asset.data.vertices) == corners,
        }

    answer["kept"] = kept()
    (textures / "metallic.png").unlink()
    call("import_result", directory=result)
    answer["imported"] = kept()
    asset.data.vertices[0].co.x += 1.0
    moved = asset.data.vertices[0].co.x
    answer["edited"] = call("import_result", directory=result)
    answer["edit kept"] = asset.data.vertices[0].co.x == moved
    answer["refreshed"] = call("refresh_result"), asset.data.vertices[0].co.x != moved
    return answer
"""


@pytest.fixture
def files(extension_zip, result):
    return str(extension_zip), str(result.root)


def test_what_the_user_did_outlives_a_refresh(blender, files, tmp_path):
    answer = run(blender, COMMON + KEPT, *files, user=tmp_path / "user")
    assert answer["said"] == ["FINISHED"]
    kept = answer["kept"]
    light = kept.pop("light")
    assert (light["picture"], light["hidden"]) == ("city.exr", [[True, True]])
    assert light["turn"] == pytest.approx(-0.5)
    assert kept.pop("fed") == ["Base Color", "Metallic", "Roughness"]
    assert kept == {
        "name": "mine", "place": [1, 2, 3], "modifiers": ["bent"], "constraints": 1,
        "homes": ["own"], "coat": 0.25, "material": True, "camera": "train_001", "rotation": 0.5,
        "meshes": 1, "corners": True,
    }  # fmt: skip
    again = answer["imported"]
    assert again.pop("fed") == ["Base Color", "Roughness"]
    assert again == kept | {"light": light}
    assert "was edited" in answer["edited"]
    assert answer["edit kept"]
    assert answer["refreshed"] == [["FINISHED"], True]
