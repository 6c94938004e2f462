# SPDX-License-Identifier: Apache-2.0
"""Quads on request: closed, even, near the surface, the same in every run, and no part is lost."""

import importlib.util

import numpy as np
import pytest
import trimesh

from robir.errors import ConfigError
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.quads import quadrangulated, refuse_without_library
from robir.geometry.mesh.simplify import decimate

pytest.importorskip("pyinstantmeshes")

RADIUS = 0.8


def as_mesh(solid):
    return plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


def ball(subdivisions=5):
    return as_mesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS))


def ball_with_a_rod(radius):
    rod = trimesh.creation.cylinder(radius, segment=((0, 0, 0.7), (0, 0, 1.6)), sections=24)
    solid = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    return as_mesh(trimesh.util.concatenate([solid, rod.subdivide_to_size(0.05)]))


def share_of_pairs(mesh):
    """Share of the triangles whose longest edge is the longest one of the triangle beyond it too.

    Of even quads it is the diagonal; of triangles that a field or quadrics made, hardly half.
    """
    corners = mesh.vertices[mesh.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    longest = lengths.argmax(axis=1)
    one = np.take_along_axis(mesh.faces, longest[:, None], 1)[:, 0]
    two = np.take_along_axis(mesh.faces, ((longest + 1) % 3)[:, None], 1)[:, 0]
    edges = np.sort(np.stack([one, two], axis=1), axis=1)
    _, index, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    return float((count[index.reshape(-1)] == 2).mean())


def test_a_ball_in_quads():
    dense = ball()
    made = quadrangulated(dense, 4000)
    assert 3200 < len(made.faces) < 4800
    assert trimesh.Trimesh(made.vertices, made.faces, process=False).is_watertight
    radius = np.linalg.norm(made.vertices, axis=1)
    assert radius == pytest.approx(RADIUS, abs=0.01)
    assert share_of_pairs(made) > 0.85
    assert share_of_pairs(decimate(dense, 4000)) < 0.6
    again = quadrangulated(dense, 4000)
    assert np.array_equal(again.vertices, made.vertices)
    assert np.array_equal(again.faces, made.faces)


def test_a_thin_part_gets_smaller_quads_or_is_not_given_up():
    thin = ball_with_a_rod(0.05)
    made = quadrangulated(thin, 2500)
    assert made.vertices[:, 2].max() > 1.5
    assert len(made.faces) > 8000
    assert quadrangulated(ball_with_a_rod(0.002), 120) is None


def test_without_the_library_it_is_said_before_anything_runs(monkeypatch):
    refuse_without_library()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'robir\[quads\]'"):
        refuse_without_library()
