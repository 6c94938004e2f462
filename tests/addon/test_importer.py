# SPDX-License-Identifier: Apache-2.0
"""The importer against the core's own cameras, files and closed-form pictures."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from evaluation import sphere_run
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.store import load_capture
from robir.export import stage
from robir.export.config import ExportConfig
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths import tone

pytestmark = pytest.mark.blender


class Quiet:
    def progress(self, fraction, message):
        pass

    def warn(self, message):
        raise AssertionError(message)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A finished export of the sphere, without pictures of Blender's."""
    paths = sphere_run.make_run(tmp_path_factory.mktemp("run") / "sphere run")
    stage.run(
        StageContext(
            paths=paths,
            config=ExportConfig(renders=False),
            source=Path("capture"),
            masks=None,
            seed=0,
            device="cpu",
            reporter=Quiet(),
        )
    )
    return paths


@pytest.fixture
def scene():
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def test_importing_the_package_has_no_side_effects():
    code = "import sys, robir_addon; raise SystemExit('bpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_asset_is_back_in_the_capture_frame(result, scene):
    from robir_addon.importer import import_result

    imported = import_result(result.root, scene)
    mesh = imported.asset.data
    expected = sphere_run.world_mesh()
    found = np.array([v.co[:] for v in mesh.vertices])[
        np.array([p.vertices[:] for p in mesh.polygons])
    ]
    triangles = expected.vertices[expected.faces]
    assert found == pytest.approx(triangles, abs=1e-6)
    uvs = np.array([loop.vector[:] for loop in mesh.uv_layers[0].uv]).reshape(-1, 3, 2)
    assert uvs == pytest.approx(expected.uvs[expected.uv_faces], abs=1e-6)
    normals = np.array([c.vector[:] for c in mesh.corner_normals]).reshape(-1, 3, 3)
    assert normals == pytest.approx(expected.normals[expected.faces], abs=2e-3)
    # seams are welded: the sphere is closed but for its degenerate pole triangles
    assert len(mesh.vertices) == 48 * 23 + 2
    assert np.array(imported.asset.matrix_world) == pytest.approx(np.eye(4))


def test_colour_states_and_view_transform(result, scene):
    from robir_addon.importer import import_result

    imported = import_result(result.root, scene)
    nodes = imported.asset.data.materials[0].node_tree.nodes
    shader = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
    sources = {
        name: shader.inputs[name].links[0].from_node.image.colorspace_settings.name
        for name in ("Base Color", "Roughness")
    }
    assert sources == {"Base Color": "sRGB", "Roughness": "Non-Color"}
    assert not shader.inputs["Metallic"].links
    assert shader.inputs["IOR"].default_value == pytest.approx(1.5)
    world = next(n for n in imported.world.node_tree.nodes if n.type == "TEX_ENVIRONMENT")
    assert world.image.colorspace_settings.name == "Linear Rec.709"
    assert scene.world == imported.world
    settings = scene.view_settings
    assert (settings.view_transform, settings.look) == ("Standard", "None")
    assert (settings.exposure, settings.gamma) == (0.0, 1.0)
    assert imported.notes == ()


def test_a_curve_blender_lacks_is_said(result, scene, tmp_path):
    from robir_addon.importer import import_result

    copy = JobPaths(tmp_path / "copy")
    shutil.copytree(result.root, copy.root)
    table = read_json(copy.tone_curve)
    write_json(copy.tone_curve, table | {"family": "robir_aces", "blender_view_transform": None})
    imported = import_result(copy.root, scene)
    assert "robir_aces" in imported.notes[0]
    assert ".cube" in imported.notes[0]


def test_importing_twice_leaves_one_of_everything(result, scene):
    import bpy

    from robir_addon.importer import import_result

    def census():
        kinds = ("objects", "collections", "meshes", "cameras", "materials", "worlds", "images")
        return {kind: sorted(b.name for b in getattr(bpy.data, kind)) for kind in kinds}

    import_result(result.root, scene)
    before = census()
    import_result(result.root, scene)
    assert census() == before
    assert len(before["cameras"]) == 9
    assert before["collections"] == ["sphere run"]


def test_every_camera_projects_as_the_core_does(scene, result):
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from robir_addon.cameras import add_camera, use_camera

    rng = np.random.default_rng(5)
    photo = load_capture(result.stage("capture")).views[0].name
    for case in range(40):
        width, height = (int(n) for n in rng.integers(300, 2000, 2))
        fx = float(rng.uniform(0.6, 3.0) * width)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = turn * np.sign(np.linalg.det(turn))
        pose[:3, 3] = rng.normal(size=3) * 3
        camera = Camera(
            width=width,
            height=height,
            fx=fx,
            fy=fx * float(rng.uniform(0.8, 1.25)),
            cx=width * float(rng.uniform(0.35, 0.65)),
            cy=height * float(rng.uniform(0.35, 0.65)),
            camera_to_world=pose,
        )
        points = camera.position + camera.forward * 4 + rng.normal(size=(20, 3))
        view = {
            "name": f"c{case}",
            "split": "train",
            "image": str(result.stage("capture") / "views" / f"{photo}.png"),
            **{f: getattr(camera, f) for f in ("width", "height", "fx", "fy", "cx", "cy")},
            "camera_to_world": pose.tolist(),
        }
        made = add_camera(view, Path(), [0.0, 0.0, 0.0])
        scene.collection.objects.link(made)
        use_camera(scene, made)
        scene.view_layers[0].update()
        x, y = np.array([world_to_camera_view(scene, made, Vector(p))[:2] for p in points]).T
        pixels, _ = camera.project(points)
        assert np.stack([x * width, (1 - y) * height], axis=1) == pytest.approx(pixels, abs=0.01)


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


@pytest.mark.slow
def test_scene_renders_like_the_photographs(built):
    run = headless("render", built.root, "--samples", 32)
    assert run.returncode == 0, run.stderr
    for view in load_capture(built.stage("capture")).held_out:
        ours = picture(built.renders / f"rerender_{view.name}.png")
        assert ours.shape[:2] == view.mask.shape
        inside = (view.mask > 127) & (ours[..., 3] > 0.99)
        assert np.mean((ours[..., 3] > 0.5) == (view.mask > 127)) > 0.99
        # the photographs are of a purely diffuse sphere; Principled adds its gloss
        assert psnr(ours[..., :3], view.image_display / 255.0, inside) > 23.0


@pytest.mark.parametrize("family", ["standard", "robir_aces", "agx"])
def test_tone_table_is_the_curve(tmp_path, family):
    from robir_addon.lut import read_tone_table

    curve = tone.curve_from_name(family)
    (tmp_path / "tone.cube").write_text(tone.cube_text(curve, 65), encoding="ascii")
    linear = np.random.default_rng(0).uniform(-7, 3, (500, 3))
    linear = 2.0**linear
    expected = curve.display_from_linear(torch.from_numpy(linear)).numpy()
    found = read_tone_table(tmp_path / "tone.cube").display(linear)
    assert np.abs(found - expected).max() < 0.02
    assert np.abs(found - expected).mean() < 2e-3


@pytest.mark.slow
def test_a_curve_blender_lacks_is_applied_to_renders(built, tmp_path):
    """Standard called by a name without a view transform must give the picture of Standard."""
    copy = JobPaths(tmp_path / "copy")
    shutil.copytree(built.root, copy.root)
    chosen = ["--views", "held_out_000", "--samples", 16]
    assert headless("render", copy.root, *chosen).returncode == 0
    expected = picture(copy.renders / "rerender_held_out_000.png")
    table = read_json(copy.tone_curve)
    write_json(copy.tone_curve, table | {"blender_view_transform": None})
    assert headless("render", copy.root, *chosen).returncode == 0
    found = picture(copy.renders / "rerender_held_out_000.png")
    assert found[..., 3] == pytest.approx(expected[..., 3], abs=1.5 / 255)
    solid = expected[..., 3] > 0.5
    assert found[solid] == pytest.approx(expected[solid], abs=2.5 / 255)


@pytest.mark.slow
def test_the_glb_alone_gives_the_same_picture(built, tmp_path):
    """Blender's own glTF importer and environment.exr, against scene.blend."""
    import bpy

    from robir_addon.cameras import add_camera, use_camera
    from robir_addon.rendering import prepare_scene, render_still

    headless("render", built.root, "--views", "held_out_000", "--samples", 32)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.import_scene.gltf(filepath=str(built.asset))
    scene.world = bpy.data.worlds.new("w")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    light = nodes.new("ShaderNodeTexEnvironment")
    light.image = bpy.data.images.load(str(built.environment))
    background = next(n for n in nodes if n.type == "BACKGROUND")
    scene.world.node_tree.links.new(light.outputs["Color"], background.inputs["Color"])
    scene.view_settings.view_transform = "Standard"
    table = read_json(built.cameras)
    view = next(v for v in table["views"] if v["name"] == "held_out_000")
    camera = add_camera(view, built.export, table["bounds"]["centre"])
    scene.collection.objects.link(camera)
    prepare_scene(scene)
    scene.cycles.samples = 32
    use_camera(scene, camera)
    render_still(scene, tmp_path / "fresh.png")
    fresh = picture(tmp_path / "fresh.png")
    ours = picture(built.renders / "rerender_held_out_000.png")
    photo = next(v for v in load_capture(built.stage("capture")).views if v.name == view["name"])
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


@pytest.mark.slow
def test_turntable_writes_frames_and_a_film(built):
    run = headless(
        *("relight", built.root, "--environment", "city", "--views", "held_out_000"),
        *("--turntable", 3, "--samples", 1, "--max-side", 33),
    )
    assert run.returncode == 0, run.stderr
    *frames, film = [Path(f) for f in json.loads(run.stdout.splitlines()[-1])["files"]]
    assert [f.name for f in frames] == ["0001.png", "0002.png", "0003.png"]
    assert not np.array_equal(picture(frames[0]), picture(frames[1]))
    content = film.read_bytes()
    assert content[4:8] == b"ftyp"
    assert len(content) > 1000


def test_wrong_requests_end_in_one_sentence(built, tmp_path):
    for arguments, code, words in (
        (["scene", tmp_path], 1, "cannot be read"),
        (["render", tmp_path], 1, "is missing"),
        (["render", built.root, "--views", "nobody"], 2, "no view is named 'nobody'"),
        (["relight", built.root, "--environment", "mars"], 2, "ships only city"),
    ):
        run = headless(*arguments)
        assert run.returncode == code
        assert words in run.stderr
        assert run.stderr.count("\n") == 1
