# SPDX-License-Identifier: Apache-2.0
"""Curves of photographs that were re-toned by a power, in Blender's own colour management."""

import numpy as np
import pytest
import torch
from PIL import Image

from robir.maths import tone

pytestmark = pytest.mark.blender

RADIANCES = (0.01, 0.09, 0.5)


@pytest.fixture
def grey():
    """A scene that shows nothing but its World."""
    import bpy

    from robir_addon.relighting.rendering import prepare_scene

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("grey")
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    prepare_scene(scene)
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.render.film_transparent = False
    scene.render.resolution_x = scene.render.resolution_y = 4
    return scene


def table_of(curve):
    """What the appearance stage writes of a curve."""
    return {
        "family": curve.name,
        "parameters": curve.parameters,
        "blender_view_transform": curve.blender_view_transform,
        "blender_gamma": curve.blender_gamma,
        "exposure": 0.0,
    }


@pytest.mark.parametrize("power", [0.5, 2.0])
@pytest.mark.parametrize("family", ["standard", "filmic"])
def test_a_power_is_shown_live(grey, tmp_path, family, power):
    from robir_addon.relighting.rendering import (
        match_view_transform,
        render_still,
        view_transform_differs,
    )

    curve = tone.powered(tone.curve_from_name(family), power)
    table = table_of(curve)
    assert view_transform_differs(grey, table)
    assert match_view_transform(grey, table) == ()
    assert not view_transform_differs(grey, table)
    found = []
    for radiance in RADIANCES:
        grey.world.color = (radiance,) * 3
        render_still(grey, tmp_path / "grey.png")
        with Image.open(tmp_path / "grey.png") as image:
            found.append(np.asarray(image.convert("RGB"))[2, 2])
    expected = curve.display_from_linear(torch.tensor(RADIANCES)[:, None].expand(-1, 3))
    np.testing.assert_allclose(found, 255 * expected.numpy(), atol=2)
