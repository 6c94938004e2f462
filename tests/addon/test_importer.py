# SPDX-License-Identifier: Apache-2.0
"""The importer against the core's own cameras and files; what is the user's stays the user's."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from evaluation import sphere_run

from robir.capture.camera import Camera
from robir.capture.store import load_capture
from robir.export.gltf import write_glb
from robir.export.textures import finished_textures
from robir.jobs.paths import JobPaths, read_json

pytestmark = pytest.mark.blender


@pytest.fixture
def scene():
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def test_importing_the_package_has_no_side_effects():
    code = "import sys, robir_addon; raise SystemExit('bpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_asset_is_back_in_the_capture_frame(result, scene):
    from robir_addon.result.importer import import_result

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
    from robir_addon.result.importer import import_result

    imported = import_result(result.root, scene)
    nodes = imported.asset.data.materials[0].node_tree.nodes
    shader = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
    sources = {
        name: shader.inputs[name].links[0].from_node.image.colorspace_settings.name
        for name in ("Base Color", "Roughness")
    }
    assert sources == {"Base Color": "sRGB", "Roughness": "Non-Color"}
    assert not shader.inputs["Metallic"].links and not shader.inputs["Normal"].links
    assert shader.inputs["IOR"].default_value == pytest.approx(1.5)
    world = next(n for n in imported.world.node_tree.nodes if n.type == "TEX_ENVIRONMENT")
    assert world.image.colorspace_settings.name == "Linear Rec.709"
    assert scene.world == imported.world


@pytest.mark.parametrize("specular", [1.0, 0.0])
def test_paint_without_highlights_has_none_in_blender(result, scene, tmp_path, specular):
    """By our importer and by Blender's own."""
    import bpy

    from robir_addon.result.importer import import_result

    paths = JobPaths(tmp_path / "run")
    shutil.copytree(result.root, paths.root)
    arrays = sphere_run.sphere_textures() | {"specular": np.float32(specular)}
    write_glb(paths.asset, sphere_run.parts(finished_textures(arrays, 12)), "sphere")
    asset = import_result(paths.root, scene).asset
    bpy.ops.import_scene.gltf(filepath=str(paths.asset))
    for made in (asset, bpy.context.object):
        nodes = made.data.materials[0].node_tree.nodes
        shader = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
        assert shader.inputs["Specular IOR Level"].default_value == pytest.approx(0.5 * specular)


@pytest.mark.parametrize("transform", [None, "A Curve of Later Years"])
def test_a_curve_blender_lacks_is_said(result, scene, transform):
    from robir_addon.relighting.rendering import match_view_transform

    table = read_json(result.tone_curve)
    lacking = {"family": "robir_aces", "blender_view_transform": transform}
    (note,) = match_view_transform(scene, table | lacking)
    assert "robir_aces" in note
    assert ".cube" in note
    assert scene.view_settings.view_transform == "Standard"


KINDS = [
    "objects",
    "collections",
    "meshes",
    "cameras",
    "lights",
    "materials",
    "worlds",
    "images",
    "scenes",
]


def census():
    import bpy

    return {kind: sorted(b.name for b in getattr(bpy.data, kind)) for kind in KINDS}


def test_what_the_user_made_is_left_alone_and_the_world_comes_back(result):
    """Blender's own start: a cube, a lamp, a camera and a World."""
    import bpy

    from robir_addon.result.importer import import_result, remove_result

    bpy.ops.wm.read_factory_settings()
    scene = bpy.context.scene
    before, world, camera = census(), scene.world, scene.camera
    size = (scene.render.resolution_x, scene.render.pixel_aspect_y)
    imported = import_result(result.root, scene)
    assert scene.camera == camera
    assert (scene.render.resolution_x, scene.render.pixel_aspect_y) == size
    own = bpy.data.objects.new("kept", None)
    imported.asset.users_collection[0].objects.link(own)
    import_result(result.root, scene)
    assert own.name in scene.objects
    # a World that nothing shows must survive saving
    assert world.users == 1
    remove_result(result.root)
    assert scene.world == world
    assert own.name in scene.collection.objects
    bpy.data.objects.remove(own)
    assert census() == before


def test_a_saved_file_keeps_every_light(result, tmp_path):
    """The light that is not shown, and the World the scene had before, survive saving."""
    import bpy

    from robir_addon.relighting import lights
    from robir_addon.result.importer import import_result, mark_of, remove_result

    bpy.ops.wm.read_factory_settings()
    scene, before = bpy.context.scene, bpy.context.scene.world.name
    world = import_result(result.root, scene).world
    lights.show_environment(scene, world, result.environment)
    file = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    scene, world = bpy.context.scene, lights.world_of(mark_of(result.root))
    assert not lights.shows_recovered_light(world)
    lights.show_recovered_light(scene, world, use_sun_lamp=True)
    assert lights.environment_file(world) == result.environment_without_sun
    assert [lamp.hide_render for lamp in lights.lamps_of(mark_of(result.root))] == [False]
    remove_result(result.root)
    assert scene.world.name == before


def test_of_two_results_one_shines(result, scene, tmp_path):
    from robir_addon.relighting import lights
    from robir_addon.result.importer import import_result, remove_result

    other = JobPaths(tmp_path / "other")
    shutil.copytree(result.root, other.root)
    first, second = import_result(result.root, scene), import_result(other.root, scene)
    assert [i.lamps[0].hide_render for i in (first, second)] == [True, False]
    assert scene.world == second.world
    lights.show_recovered_light(scene, first.world, use_sun_lamp=True)
    assert [i.lamps[0].hide_render for i in (first, second)] == [False, True]
    remove_result(result.root)
    assert list(scene.collection.children) == list(second.asset.users_collection)


def test_a_broken_folder_changes_nothing(result, scene, tmp_path):
    from robir_addon.engine.errors import ResultError
    from robir_addon.result.importer import import_result

    copy = JobPaths(tmp_path / "copy")
    shutil.copytree(result.root, copy.root)
    import_result(copy.root, scene)
    before = census()
    for file in (copy.cameras, copy.asset, copy.environment, copy.textures / "roughness.png"):
        kept = file.read_bytes()
        file.unlink()
        with pytest.raises(ResultError, match=file.name):
            import_result(copy.root, scene)
        file.write_bytes(kept)
        assert census() == before


def test_every_camera_projects_as_the_core_does(scene, result):
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from robir_addon.capture.cameras import add_camera, use_camera

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
