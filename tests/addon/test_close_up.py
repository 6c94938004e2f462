# SPDX-License-Identifier: Apache-2.0
"""The camera of the small pictures: an object fills a square, wherever the photograph has it."""

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.blender

TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))


@pytest.fixture
def camera(tmp_path):
    """A wide photograph with oblong pixels whose middle lies elsewhere; its scene is left empty."""
    bpy = pytest.importorskip("bpy")
    from robir_addon.capture.cameras import add_camera

    bpy.ops.wm.read_factory_settings(use_empty=True)
    Image.new("RGB", (80, 50)).save(tmp_path / "photo.png")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN, [4.0, -3.0, 2.0]
    view = {
        "name": "a", "split": "train", "image": "photo.png", "width": 80, "height": 50,
        "fx": 70.0, "fy": 90.0, "cx": 31.0, "cy": 28.0, "camera_to_world": pose.tolist(),
    }  # fmt: skip
    added = add_camera(view, tmp_path, [0.0, 0.0, 0.0])
    bpy.context.scene.collection.objects.link(added)
    bpy.context.view_layer.update()
    return added


def points_at(depth: float) -> np.ndarray:
    """A cloud in front of the camera, off its axis, world."""
    own = np.random.default_rng(0).uniform([0.3, -0.5, -0.1], [0.9, -0.3, 0.1], (200, 3))
    return (own - [0.0, 0.0, depth]) @ TURN.T + [4.0, -3.0, 2.0]


def test_points_fill_the_square_up_to_its_margin(camera):
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from robir_addon.capture.cameras import use_close_up

    scene, before = bpy.context.scene, (camera.data.lens, camera.data.shift_x)
    points = points_at(5.0)
    use_close_up(scene, camera, points, 64)
    bpy.context.view_layer.update()
    seen = np.array([world_to_camera_view(scene, scene.camera, Vector(p)) for p in points])[:, :2]
    low, high = seen.min(0), seen.max(0)
    np.testing.assert_allclose([low[0], high[0]], [0.08, 0.92], atol=1e-4)
    np.testing.assert_allclose(low[1] + high[1], 1.0, atol=1e-4)
    assert low[1] > 0.08
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 64)
    assert scene.camera != camera
    assert before == (camera.data.lens, camera.data.shift_x)


@pytest.mark.parametrize("points", [points_at(-1.0), points_at(0.0), np.empty((0, 3))])
def test_without_a_view_of_all_points_it_is_the_photograph(camera, points):
    import bpy

    from robir_addon.capture.cameras import use_close_up

    scene = bpy.context.scene
    use_close_up(scene, camera, points, 40)
    assert scene.camera == camera
    assert (scene.render.resolution_x, scene.render.resolution_y) == (40, 25)
