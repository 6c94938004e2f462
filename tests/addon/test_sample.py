# SPDX-License-Identifier: Apache-2.0
"""The sample that comes with the extension, as someone meets it who has no engine."""

from __future__ import annotations

from pathlib import Path

import pytest
from addon.blenders import run

pytestmark = pytest.mark.blender

SESSION = """
import bpy

def world_file():
    nodes = bpy.context.scene.world.node_tree.nodes
    return next(n.image.filepath for n in nodes if n.type == "TEX_ENVIRONMENT")

def main(archive):
    bpy.ops.wm.read_factory_settings()
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    settings, state = bpy.context.scene.robir, bpy.context.window_manager.robir
    answer = {"tried": sorted(bpy.ops.robir.try_sample()), "result": settings.result}
    answer["light"] = world_file()
    settings.light = "recovered"
    answer["recovered"] = world_file()
    answer["missing"] = [i.filepath for i in bpy.data.images
                         if i.source == "FILE" and not i.size[0]]
    answer["object"] = [bpy.context.object.name, len(bpy.context.object.data.polygons)]
    answer["message"] = state.message
    try:
        bpy.ops.robir.reconstruct_sample()
    except RuntimeError as fault:
        answer["refused"] = str(fault)
    answer["capture"], answer["after"] = settings.capture, settings.result
    answer["cure"] = state.error_cure
    # an update brings another sample, and the user has changed the former one
    from pathlib import Path
    import sys
    own = Path(answer["result"], "run.json")
    own.write_text(own.read_text() + " ")
    sample = sys.modules["bl_ext.user_default.robir.operators.result"]
    with (sample._SHIPPED / "README.txt").open("a") as text:
        text.write("newer")
    bpy.ops.robir.try_sample()
    answer["newer"] = settings.result
    answer["is_sample"] = sample.is_sample(settings.result)
    answer["texts"] = [Path(folder, "README.txt").read_text().endswith("newer")
                       for folder in (answer["result"], settings.result)]
    answer["kept"] = own.read_text().endswith(" ")
    bpy.ops.robir.try_sample()
    answer["again"] = settings.result
    return answer
"""


def test_it_is_relit_without_an_engine_and_asks_for_one_to_be_made_anew(
    blender, extension_zip, tmp_path
):
    answer = run(blender, SESSION, str(extension_zip), user=tmp_path / "user")
    assert answer["tried"] == ["FINISHED"]
    result = Path(answer["result"])
    assert (result.name, result.parents[1].name) == ("avocado", "sample")
    assert tmp_path in result.parents
    assert Path(answer["light"]).name == "sunrise.exr"
    assert result in Path(answer["recovered"]).parents
    assert answer["missing"] == []
    assert answer["object"][1] > 1000
    assert "Sunrise" in answer["message"]
    assert "No engine is installed" in answer["refused"]
    assert answer["cure"] == "Press Install Engine"
    assert Path(answer["capture"]) == result / "avocado"
    assert answer["after"] == ""
    assert answer["newer"] != answer["result"] and answer["newer"] == answer["again"]
    assert answer["texts"] == [False, True] and answer["is_sample"]
    assert answer["kept"], "what the user changed is the user's"
