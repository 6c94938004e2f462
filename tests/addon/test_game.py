# SPDX-License-Identifier: Apache-2.0
"""Export for Games: levels that stand on the floor, and a normal map that holds the fine shape."""

from __future__ import annotations

import json

import pytest
import trimesh
from addon.blenders import run
from addon.test_result_operators import COMMON
from evaluation import sphere_run

pytestmark = pytest.mark.blender

SESSION = """
import numpy as np


def baked(kind):
    # what each texel of the imported object shows, (N, 3), and where something is shown
    image = bpy.data.images.new(kind, 64, 64, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.generated_color = (0, 0, 0, 0)
    nodes = bpy.context.object.active_material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image, nodes.active = image, texture
    bpy.ops.object.bake(type=kind, normal_space="OBJECT", margin=0)
    nodes.remove(texture)
    pixels = np.empty(4 * 64 * 64, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(-1, 4)


def slant(file, radius):
    # degrees between what is shown of a sphere and what it is, with the map and without
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=file)
    bpy.context.scene.render.engine = "CYCLES"
    bpy.context.scene.cycles.samples = 1
    shown = next(o for o in bpy.data.objects if o.type == "MESH")
    bpy.context.view_layer.objects.active = shown
    shown.select_set(True)
    place = baked("POSITION")
    seen = (place[:, :3] != 0).any(1)  # what was not baked is 0
    truth = place[seen, :3] - [0, 0, radius]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    answer = []
    for _ in range(2):
        normal = 2 * baked("NORMAL")[seen, :3] - 1
        cosine = (normal * truth).sum(1) / np.linalg.norm(normal, axis=1)
        answer.append(float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1))))))
        for link in list(shown.active_material.node_tree.links):
            if link.to_socket.name == "Normal":
                shown.active_material.node_tree.links.remove(link)
    return answer


def main(archive, result, out):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    scene = bpy.context.scene
    call("import_result", directory=result)
    before = [census(), [list(o.location) for o in bpy.data.objects], scene.render.engine]
    wishes = {"most_faces": 200, "texture_side": "512", "size": 0.5}
    answer = {"said": call("export_game", filepath=out + "/ball.glb", **wishes)}
    after = [census(), [list(o.location) for o in bpy.data.objects], scene.render.engine]
    answer["is_same"] = before == after
    whole = {"most_faces": 60, "levels": 1, "is_cleaned": False, "is_usd": False}
    call("export_game", filepath=out + "/whole.glb", size=2.0, **whole)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=out + "/ball_LOD1.usdc")
    answer["usd"] = [[o.name, len(o.data.polygons), sorted({p.loop_total for p in o.data.polygons})]
                     for o in bpy.data.objects if o.type == "MESH"]
    answer["slant"] = slant(out + "/whole.glb", 1.0)
    return answer
"""


def test_levels_stand_on_the_floor_with_the_fine_shape_in_a_normal_map(
    blender, extension_zip, result, tmp_path
):
    table = json.loads(result.cameras.read_text())
    floor = sphere_run.CENTRE[2] - 0.8 * sphere_run.SPHERE  # what is below counts as ground
    table["ground"] = {"normal": [0.0, 0.0, 1.0], "offset": float(floor)}
    result.cameras.write_text(json.dumps(table))
    words = str(extension_zip), str(result.root), str(tmp_path)
    answer = run(blender, COMMON + SESSION, *words, user=tmp_path / "user")
    assert answer["said"] == ["FINISHED"] and answer["is_same"]
    glbs = {f.name for f in tmp_path.glob("*.glb")}
    assert glbs == {"ball.glb", "ball_LOD1.glb", "ball_LOD2.glb", "whole.glb"}
    for name, faces in (("ball.glb", 200), ("ball_LOD1.glb", 100), ("ball_LOD2.glb", 50)):
        scene = trimesh.load(tmp_path / name)
        (mesh,) = scene.dump()
        assert 0.9 * faces - 2 <= len(mesh.faces) <= faces
        low, high = mesh.bounds
        assert low[1] == pytest.approx(0.0, abs=1e-5), "y is up, and the feet are at the origin"
        assert low[[0, 2]] + high[[0, 2]] == pytest.approx(0.0, abs=0.02)
        assert max(high - low) == pytest.approx(0.5, rel=0.05)
        assert high[1] < 0.47, "the ground below is gone"
        material = mesh.visual.material
        assert material.normalTexture.size == (512, 512)
        assert material.baseColorTexture.size == (sphere_run.TEXELS, sphere_run.TEXELS)
    assert answer["usd"] == [["ball_LOD1", pytest.approx(100, abs=12), [3]]]
    shown, plain = answer["slant"]
    assert shown < 2.0 and shown < 0.8 * plain, "the map says where the fine surface looks"
