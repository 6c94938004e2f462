# SPDX-License-Identifier: Apache-2.0
"""Rendered pictures of an imported result against closed forms and against each other."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from robir.capture.store import load_capture
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths import tone

pytestmark = pytest.mark.blender


def headless(*arguments):
    command = [sys.executable, "-m", "robir_addon.headless", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def psnr(first, second, mask):
    return -10 * np.log10(max(np.mean((first[mask] - second[mask]) ** 2), 1e-12))


def picture(file):
    with Image.open(file) as image:
        return np.array(image.convert("RGBA")) / 255.0


@pytest.fixture(scope="module")
def built(result):
    """The sphere's scene.blend."""
    run = headless("scene", result.root)
    assert run.returncode == 0, run.stderr
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    assert lines[0]["progress"] == 0.0
    assert lines[-1]["files"] == [str(result.scene)]
    return result


@pytest.fixture(scope="module")
def rendered(built):
    """The same with its held-out views rendered, 32 samples a pixel."""
    run = headless("render", built.root, "--samples", 32)
    assert run.returncode == 0, run.stderr
    return built


@pytest.mark.slow
def test_scene_renders_like_the_photographs(rendered):
    for view in load_capture(rendered.stage("capture")).held_out:
        ours = picture(rendered.renders / f"rerender_{view.name}.png")
        assert ours.shape[:2] == view.mask.shape
        inside = (view.mask > 127) & (ours[..., 3] > 0.99)
        assert np.mean((ours[..., 3] > 0.5) == (view.mask > 127)) > 0.99
        # the photographs are of a purely diffuse sphere; Principled adds its gloss
        assert psnr(ours[..., :3], view.image_display / 255.0, inside) > 23.0
        with Image.open(rendered.renders / f"rerender_{view.name}.png") as shown:
            assert set(shown.info) <= {"dpi", "gamma", "srgb"}  # neither folder nor date


@pytest.mark.parametrize("family", ["standard", "robir_aces", "agx"])
def test_tone_table_is_the_curve(tmp_path, family):
    from robir_addon.relighting.rendering import read_tone_table

    curve = tone.curve_from_name(family)
    (tmp_path / "tone.cube").write_text(tone.cube_text(curve, 65), encoding="ascii")
    linear = np.random.default_rng(0).uniform(-7, 3, (500, 3))
    linear = 2.0**linear
    expected = curve.display_from_linear(torch.from_numpy(linear)).numpy()
    found = read_tone_table(tmp_path / "tone.cube").display(linear)
    assert np.abs(found - expected).max() < 0.02
    assert np.abs(found - expected).mean() < 2e-3


@pytest.mark.slow
def test_a_curve_blender_lacks_is_applied_to_renders(rendered, tmp_path):
    """Standard called by a name without a view transform must give the picture of Standard."""
    copy = JobPaths(tmp_path / "copy")
    shutil.copytree(rendered.root, copy.root)
    chosen = ["--views", "held_out_000", "--samples", 32]
    expected = picture(copy.renders / "rerender_held_out_000.png")
    table = read_json(copy.tone_curve)
    write_json(copy.tone_curve, table | {"blender_view_transform": None})
    assert headless("render", copy.root, *chosen).returncode == 0
    found = picture(copy.renders / "rerender_held_out_000.png")
    assert found[..., 3] == pytest.approx(expected[..., 3], abs=1.5 / 255)
    solid = expected[..., 3] > 0.5
    assert found[solid] == pytest.approx(expected[solid], abs=2.5 / 255)


@pytest.mark.slow
def test_the_glb_alone_gives_the_same_picture(rendered, tmp_path):
    """Blender's own glTF importer and environment.exr, against scene.blend."""
    import bpy

    from robir_addon.capture.cameras import add_camera, use_camera
    from robir_addon.relighting.rendering import prepare_scene, render_still

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.import_scene.gltf(filepath=str(rendered.asset))
    scene.world = bpy.data.worlds.new("w")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    light = nodes.new("ShaderNodeTexEnvironment")
    light.image = bpy.data.images.load(str(rendered.environment))
    background = next(n for n in nodes if n.type == "BACKGROUND")
    scene.world.node_tree.links.new(light.outputs["Color"], background.inputs["Color"])
    scene.view_settings.view_transform = "Standard"
    table = read_json(rendered.cameras)
    view = next(v for v in table["views"] if v["name"] == "held_out_000")
    camera = add_camera(view, rendered.export, table["bounds"]["centre"])
    scene.collection.objects.link(camera)
    prepare_scene(scene)
    scene.cycles.samples = 32
    use_camera(scene, camera)
    render_still(scene, tmp_path / "fresh.png")
    fresh = picture(tmp_path / "fresh.png")
    ours = picture(rendered.renders / "rerender_held_out_000.png")
    photo = next(v for v in load_capture(rendered.stage("capture")).views if v.name == view["name"])
    inside = (photo.mask > 127) & (ours[..., 3] > 0.99)
    target = photo.image_display / 255.0
    difference = psnr(fresh[..., :3], target, inside) - psnr(ours[..., :3], target, inside)
    assert abs(difference) < 0.5
    assert psnr(fresh[..., :3], ours[..., :3], inside) > 35.0


@pytest.mark.slow
def test_rotation_turns_the_light_counter_clockwise(built, tmp_path):
    from robir.export.textures import write_exr

    image = np.full((32, 64, 3), 0.05, np.float32)
    image[8:12, 20:24] = [30.0, 10.0, 5.0]
    write_exr(tmp_path / "still.exr", image)
    # a quarter turn seen from above moves +X to +Y, which lies a quarter further left
    write_exr(tmp_path / "turned.exr", np.roll(image, -16, axis=1))
    quality = ["--views", "held_out_001", "--samples", 32, "--max-side", 32]
    for name, rotation in (("still", 90), ("turned", 0)):
        file = tmp_path / f"{name}.exr"
        light = ["--environment", file, "--rotation", rotation]
        run = headless("relight", built.root, *light, *quality)
        assert run.returncode == 0, run.stderr
    still, turned = (
        picture(built.renders / f"relit_{name}_held_out_001.png") for name in ("still", "turned")
    )
    assert still.shape[:2] == (32, 32)
    assert psnr(still, turned, np.ones((32, 32), bool)) > 35.0


def test_wrong_requests_end_in_one_sentence(built, tmp_path):
    for arguments, code, words in (
        (["scene", tmp_path], 6, "cannot be read"),
        (["render", tmp_path], 6, "cannot be read"),
        (["render", built.root, "--views", "nobody"], 2, "no view is named 'nobody'"),
        (["relight", built.root, "--environment", "mars"], 2, "ships only city"),
        (["relight", built.root, "--environment=--help"], 2, "ships only city"),
    ):
        run = headless(*arguments)
        assert run.returncode == code
        assert words in run.stderr
        assert run.stderr.count("\n") == 1
