# SPDX-License-Identifier: Apache-2.0
"""Where to photograph next, on a result: what no or few photographs show is tinted."""

from __future__ import annotations

import numpy as np
import pytest
from addon.blenders import run
from addon.test_result_operators import COMMON
from PIL import Image

pytestmark = pytest.mark.blender

SESSION = """
def shares(out):
    # red, orange and clear pixels of the tint alone, under Cycles
    over = next(o for o in bpy.data.objects if "robir_few_views" in o)
    over.hide_render, over.parent.hide_render = False, True
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Raw"
    scene.render.filepath = out
    bpy.ops.render.render(write_still=True)
    over.parent.hide_render = False


def main(archive, result, out):
    install(archive)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    call("import_result", directory=result)
    answer = {"before": census()}
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = 64
    answer["shown"] = [call("show_few_views"), len(bpy.data.objects)]
    shares(out + "/tint.png")
    answer["hidden"] = [call("show_few_views"), len(bpy.data.objects)]
    call("show_few_views")
    answer["refreshed"] = [call("import_result"), len(bpy.data.objects)]
    call("show_few_views")
    call("remove_result")
    answer["left"] = [len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials)]
    return answer
"""


def test_few_views_are_tinted_until_the_next_press(newest, extension_zip, result, tmp_path):
    file = result.textures / "coverage.png"
    with Image.open(file) as picture:
        codes = np.zeros_like(np.array(picture))
    third = codes.shape[0] // 3
    codes[third:] = round(255 * 2 / 6)
    codes[2 * third :] = 255
    Image.fromarray(codes).save(file)
    words = str(extension_zip), str(result.root), str(tmp_path)
    answer = run(newest, COMMON + SESSION, *words, user=tmp_path / "user")
    count = len(answer["before"]["objects"])
    assert answer["shown"] == [["FINISHED"], count + 1]
    assert answer["hidden"] == answer["refreshed"] == [["FINISHED"], count]
    assert answer["left"] == [0, 0, 0]
    with Image.open(tmp_path / "tint.png") as picture:
        seen = np.array(picture.convert("RGBA")).astype(int)
    red = (seen[..., 3] > 200) & (seen[..., 1] < 20)
    orange = (seen[..., 3] > 100) & (seen[..., 1] > 20)
    assert red.mean() > 0.02 and orange.mean() > 0.02
    assert (seen[..., 3] == 0).mean() > 0.2
