# SPDX-License-Identifier: Apache-2.0
"""A lamp that stands near lights a plane by the inverse square, and goes along with its result."""

import math
import shutil

import numpy as np
import OpenEXR
import pytest
from addon.white import white
from evaluation import sphere_run

from robir.jobs.paths import JobPaths, read_json, write_json

pytestmark = pytest.mark.blender

AWAY, SIDE, WIDTH = 3.0, 24, 4.0
CENTRE, TOWARDS = sphere_run.CENTRE, sphere_run.SUN_DIRECTION


@pytest.fixture
def near(result, tmp_path):
    """The result with its sun as a lamp at AWAY."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    paths = JobPaths(tmp_path / "near")
    shutil.copytree(result.root, paths.root)
    table = read_json(paths.light)
    lamps = [lamp | {"distance": AWAY} for lamp in table["sun_lamps"]]
    write_json(paths.light, table | {"sun_lamps": lamps})
    return paths


def imported(paths):
    import bpy

    from robir_addon.result.importer import import_result

    return import_result(paths.root, bpy.context.scene)


def white_plane():
    import bpy

    bpy.ops.mesh.primitive_plane_add(size=WIDTH, location=CENTRE)
    bpy.context.object.data.materials.append(white())


def seen_from_above(file):
    """Radiance (SIDE, SIDE, 3) of the plane under the lamps alone, row 0 at the greatest y."""
    import bpy

    from robir_addon.relighting.rendering import prepare_scene

    scene = bpy.context.scene
    data = bpy.data.cameras.new("above")
    data.type, data.ortho_scale = "ORTHO", WIDTH
    scene.camera = bpy.data.objects.new("above", data)
    scene.camera.location = CENTRE + np.array([0.0, 0.0, 8.0])
    scene.collection.objects.link(scene.camera)
    prepare_scene(scene)
    scene.cycles.use_denoising, scene.cycles.samples, scene.cycles.max_bounces = False, 16, 0
    scene.world = None
    render = scene.render
    render.resolution_x = render.resolution_y = SIDE
    render.threads_mode, render.threads = "FIXED", 1
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    return next(iter(OpenEXR.File(str(file)).channels().values())).pixels[..., :3]


def test_it_shines_by_the_inverse_square(near, tmp_path):
    made = imported(near)
    made.asset.hide_render = True
    white_plane()
    found = seen_from_above(tmp_path / "plane.exr")
    step = (np.arange(SIDE) + 0.5) * WIDTH / SIDE - 0.5 * WIDTH
    x, y = np.meshgrid(step, -step)
    aside = AWAY * TOWARDS - np.stack([x, y, np.zeros_like(x)], axis=-1)
    squared = (aside**2).sum(-1)
    # Lambert: E cos / pi, E by the square of the distance, as the middle gets `SUN`
    expected = AWAY**2 / squared * aside[..., 2] / np.sqrt(squared) / math.pi
    assert found == pytest.approx(expected[..., None] * sphere_run.SUN, rel=0.03)


def test_it_goes_round_the_middle_as_the_light_is_turned(near):
    import bpy

    from robir_addon.relighting.lights import turn_light

    (lamp,) = imported(near).lamps
    assert lamp.data.type == "POINT"
    assert np.array(lamp.location) == pytest.approx(CENTRE + AWAY * TOWARDS, abs=1e-5)
    for turn in (0.5 * math.pi, 0.0, 0.5 * math.pi):  # it comes back, whatever was before
        turn_light(bpy.context.scene, turn)
    x, y, z = TOWARDS
    assert np.array(lamp.location) == pytest.approx(CENTRE + AWAY * np.array([-y, x, z]), abs=1e-5)


def test_it_lights_a_larger_thing_as_the_smaller_one(near):
    import bpy

    from robir_addon.relighting.lights import turn_light
    from robir_addon.result.placing import scale_result

    made = imported(near)
    (lamp,) = made.lamps
    energy, size = lamp.data.energy, lamp.data.shadow_soft_size
    scale_result(made.asset, 2.0)
    bpy.context.view_layer.update()
    assert lamp.data.energy == pytest.approx(4.0 * energy, rel=1e-5)
    assert lamp.data.shadow_soft_size == pytest.approx(2.0 * size, rel=1e-5)
    middle = np.array(lamp.location) - 2.0 * AWAY * TOWARDS
    turn_light(bpy.context.scene, math.pi)
    x, y, z = TOWARDS
    assert np.array(lamp.location) == pytest.approx(
        middle + 2.0 * AWAY * np.array([-x, -y, z]), abs=1e-4
    )
    # made anew it stands where it was brought
    (again,) = imported(near).lamps
    assert again.data.energy == pytest.approx(4.0 * energy, rel=1e-5)
    assert np.array(again.location) == pytest.approx(middle + 2.0 * AWAY * TOWARDS, abs=1e-4)
