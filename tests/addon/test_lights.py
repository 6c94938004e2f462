# SPDX-License-Identifier: Apache-2.0
"""A Sun lamp beside the environment without its sun must light as the whole environment does."""

import inspect

import numpy as np
import OpenEXR
import pytest
from addon.blenders import MODULE, run
from addon.white import white
from evaluation import sphere_run

pytestmark = [pytest.mark.blender, pytest.mark.slow]

SCRIPT = f"""
import bpy, sys
from pathlib import Path

MODULE = {MODULE!r}


{inspect.getsource(white)}

def main(archive, result, out):
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    rooms = {{"importer": "result", "lights": "relighting", "rendering": "relighting"}}
    ours = {{n: sys.modules[f"{{MODULE}}.{{room}}.{{n}}"] for n, room in rooms.items()}}
    scene = bpy.context.scene
    imported = ours["importer"].import_result(Path(result), scene)
    imported.asset.hide_render = True
    material = white()
    bpy.ops.mesh.primitive_plane_add(size=4)
    bpy.context.object.data.materials.append(material)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0, 0, 0.6))
    bpy.context.object.data.materials.append(material)
    data = bpy.data.cameras.new("above")
    data.type, data.ortho_scale = "ORTHO", 4
    scene.camera = bpy.data.objects.new("above", data)
    scene.camera.location = (0, 0, 5)
    scene.collection.objects.link(scene.camera)
    ours["rendering"].prepare_scene(scene)
    scene.cycles.use_denoising = False
    scene.cycles.samples = 64
    scene.cycles.max_bounces = 0
    scene.cycles.sample_clamp_indirect = 0
    render = scene.render
    render.resolution_x = render.resolution_y = 48
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    render.threads_mode, render.threads = "FIXED", 1
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    black = bpy.data.worlds.new("black")
    if bpy.app.version < (5, 0, 0):
        black.use_nodes = True
    black.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    for name in ("lamp", "whole", "lamp alone"):
        ours["lights"].show_recovered_light(scene, imported.world, name != "whole")
        if name == "lamp alone":
            scene.world = black
        render.filepath = f"{{out}}/{{name}}.exr"
        bpy.ops.render.render(write_still=True)
    return [[o.hide_render for o in imported.lamps], bpy.app.version_string]
"""


def test_lamp_and_environment_light_a_plane_alike(newest, extension_zip, result, tmp_path):
    words = (str(extension_zip), str(result.root), str(tmp_path))
    run(newest, SCRIPT, *words, user=tmp_path / "user")
    lamp, whole, alone = (
        next(iter(OpenEXR.File(str(tmp_path / f"{name}.exr")).channels().values())).pixels[..., :3]
        for name in ("lamp", "whole", "lamp alone")
    )
    for part in (slice(0, 8), slice(0, 48)):  # a corner without shadow, and all of it
        ratio = lamp[part, part].mean((0, 1)) / whole[part, part].mean((0, 1))
        assert ratio == pytest.approx(np.ones(3), abs=6e-3)
    # noise of the environment, and at borders of the shadow a disc against a lobe
    assert np.abs(lamp - whole).mean() / whole.mean() < 0.04
    # closed form: a white plane under irradiance E has radiance E / pi; the plane lies flat
    expected = sphere_run.SUN * sphere_run.SUN_DIRECTION[2] / np.pi
    assert alone[:8, :8].mean((0, 1)) == pytest.approx(expected, rel=2e-3)
    # the cube's shadow lies where the sun is not: away from its direction over the ground
    shadow = np.argwhere(alone[..., 0] < 0.2 * expected[0]).mean(axis=0) - 23.5
    across = np.array([-shadow[0], shadow[1]]) @ sphere_run.SUN_DIRECTION[[1, 0]]
    assert across < -1.0
