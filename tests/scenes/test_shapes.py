# SPDX-License-Identifier: Apache-2.0
"""Shapes: closed, oriented outwards, of the volume that geometry says."""

import numpy as np
import pytest
import trimesh

from blender_scenes import shapes
from blender_scenes.shapes import Shape


def as_mesh(shape: Shape) -> trimesh.Trimesh:
    """Fan-triangulated mesh, vertices kept."""
    triangles = [(f[0], f[i], f[i + 1]) for f in shape.faces for i in range(1, len(f) - 1)]
    return trimesh.Trimesh(shape.vertices, triangles, process=False)


STRAIGHT = np.stack([np.linspace(-0.5, 0.5, 9), np.zeros(9), np.zeros(9)], axis=1)
PARTS = {
    "box": (shapes.box((1.0, 2.0, 3.0)), 6.0),
    "sphere": (shapes.sphere(0.5), np.pi / 6.0),
    "cone": (shapes.cone(0.5, 1.2), np.pi * 0.25 * 1.2 / 3.0),
    "cylinder": (shapes.cylinder(0.3, 0.7), np.pi * 0.09 * 0.7),
    "capsule": (shapes.tube(STRAIGHT, 0.2, 64), np.pi * 0.04 + 4.0 / 3.0 * np.pi * 0.008),
}


@pytest.mark.parametrize("name", PARTS)
def test_shape_is_closed_and_has_its_volume(name: str) -> None:
    shape, volume = PARTS[name]
    mesh = as_mesh(shape)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.01)


def test_box_faces_show_the_texture_upright_and_unmirrored() -> None:
    shape = shapes.box((1.0, 1.0, 1.0))
    for face, uv in list(zip(shape.faces, shape.uvs, strict=True))[:4]:
        points = shape.vertices[list(face)]
        right, up = points[1] - points[0], points[3] - points[0]
        np.testing.assert_allclose(uv[1] - uv[0], [1.0, 0.0])
        np.testing.assert_allclose(up, [0.0, 0.0, 1.0])
        outward = np.cross(right, up)
        assert outward @ points.mean(axis=0) > 0.0
