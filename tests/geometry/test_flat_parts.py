# SPDX-License-Identifier: Apache-2.0
"""Parts near a plane become flat where photographs of the true surface do not object."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from robir.geometry.flat_parts import with_flat_parts
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.triangles import face_geometry
from tests.geometry.test_pits import predictions_of

HALF = 0.45
WAVES = 0.02  # height of the waves


def block(height):
    """A finely meshed cube whose sides have waves of a height."""
    cube = trimesh.creation.box((2 * HALF,) * 3)
    for _ in range(6):
        cube = cube.subdivide()
    place = np.asarray(cube.vertices) / HALF
    face = np.abs(place).argmax(axis=1)
    rows = np.arange(len(place))
    across = np.delete(place, 0, axis=1)
    for axis in (1, 2):
        across[face == axis] = np.delete(place, axis, axis=1)[face == axis]
    place[rows, face] *= 1 + height / HALF * np.sin(2 * np.pi * across).prod(axis=1)
    return plain_mesh(HALF * place, np.asarray(cube.faces))


def slant(mesh):
    """Mean angle, by area, between faces and the nearest axis, degrees."""
    normals, areas = face_geometry(mesh.vertices.astype(np.float64), mesh.faces)
    nearest = np.abs(normals).max(axis=1).clip(max=1.0)
    return float((np.degrees(np.arccos(nearest)) * areas).sum() / areas.sum())


@pytest.fixture(scope="module")
def wavy():
    return block(WAVES)


def test_a_cube_with_waves_for_noise_becomes_a_cube(wavy):
    assert slant(wavy) > 4
    flat = with_flat_parts(wavy, 2 * WAVES, predictions_of(block(0.0), side=160))
    assert slant(flat) < 1.5


def test_waves_that_photographs_show_stay(wavy):
    kept = with_flat_parts(wavy, 2 * WAVES, predictions_of(wavy, side=160))
    np.testing.assert_array_equal(kept.vertices, wavy.vertices)
