# SPDX-License-Identifier: Apache-2.0
"""Lone craters go unless photographs show them; clefts, relief and what is wide are shape."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from robir.geometry.mesh.isosurface import compacted, plain_mesh
from robir.geometry.pits import pits, without_pits
from robir.geometry.prediction import Predictions
from robir.geometry.rays import reduce_view
from tests.geometry.scenes import capture_of

RADIUS = 0.8


def grain(points):
    """Display codes that change in all directions, over about a tenth of the radius."""
    waves = np.sin(points @ np.array([[23.0, 5.0, -9.0], [-7.0, 21.0, 8.0], [11.0, -6.0, 19.0]]))
    return 128 + 80 * waves


def dented(shape, depth):
    """A sphere that is lowered by `depth` times a shape of the unit directions (N, 3)."""
    solid = trimesh.creation.icosphere(subdivisions=5)
    place = np.asarray(solid.vertices)
    return plain_mesh(place * (RADIUS - depth * shape(place))[:, None], np.asarray(solid.faces))


def crater(place):
    """A round hollow about the direction between x and z."""
    apart = np.linalg.norm(place - np.array([0.6, 0.0, 0.8]), axis=1)
    return np.exp(-((apart / 0.13) ** 4))


def bowl(place):
    """A hollow like the crater, wider, with a sharp rim."""
    apart = np.linalg.norm(place - np.array([0.6, 0.0, 0.8]), axis=1)
    return np.exp(-((apart / 0.18) ** 16))


def solid_of(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def predictions_of(mesh, side=96):
    capture = capture_of(solid_of(mesh), views=24, side=side, paint=grain)
    return Predictions([reduce_view(view, side) for view in capture.train])


@pytest.fixture(scope="module")
def of_the_sphere():
    return predictions_of(dented(crater, 0.0))


def radii(mesh, own):
    return np.linalg.norm(mesh.vertices[own], axis=1)


def test_a_crater_is_found_and_filled_for_the_most_part():
    mesh = dented(crater, 0.06)
    (pit,) = pits(mesh)
    hollow = crater(mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)) > 0.8
    assert set(np.flatnonzero(hollow)) <= set(pit.own) <= set(pit.moved)
    filled = np.linalg.norm(pit.places, axis=1)
    np.testing.assert_allclose(filled, RADIUS, atol=0.025)


def test_a_crater_that_photographs_do_not_show_goes(of_the_sphere):
    mesh = dented(crater, 0.06)
    (pit,) = pits(mesh)
    before, after = of_the_sphere.spread((mesh, dented(crater, 0.0)), pit.own)
    assert after < 0.6 * before
    smooth = without_pits(mesh, of_the_sphere)
    assert radii(smooth, pit.own).min() > RADIUS - 0.025
    rest = np.setdiff1d(np.arange(len(mesh.vertices)), pit.moved)
    np.testing.assert_array_equal(smooth.vertices[rest], mesh.vertices[rest])


def test_a_crater_that_photographs_show_stays():
    mesh = dented(crater, 0.06)
    np.testing.assert_array_equal(without_pits(mesh, predictions_of(mesh)).vertices, mesh.vertices)


def test_what_too_few_photographs_show_stays(of_the_sphere):
    below = dented(lambda place: crater(place * [1.0, 1.0, -1.0]), 0.06)
    (pit,) = pits(below)
    assert of_the_sphere.spread((below, dented(crater, 0.0)), pit.own) is None
    assert without_pits(below, of_the_sphere) is below


def slot(long, wide):
    """A groove through the crater's middle."""

    def shape(place):
        across = (place - np.array([0.6, 0.0, 0.8])) @ np.array([0.8, 0.0, -0.6])
        return np.exp(-((place[:, 1] / long) ** 4) - (across / wide) ** 4) * (place[:, 2] > 0)

    return shape


@pytest.mark.parametrize(
    ("shape", "depth"),
    [(bowl, 0.2), (slot(0.25, 0.04), 0.1), (slot(0.2, 0.08), 0.1), (crater, 0.04)],
)
def test_what_is_wide_or_long_or_shallow_is_shape(shape, depth):
    assert pits(dented(shape, depth)) == []


def test_a_loose_piece_is_left_as_it_is():
    """A patch that is hardly more than its crater."""
    across, down = np.meshgrid(np.linspace(-0.1, 0.1, 25), np.linspace(-0.1, 0.1, 25))
    apart = np.hypot(across, down)
    places = np.stack([across, down, -0.08 * np.exp(-((apart / 0.06) ** 4))], axis=-1)
    number = np.arange(25 * 25).reshape(25, 25)
    first, second = number[:-1, :-1].ravel(), number[1:, 1:].ravel()
    faces = [[first, number[:-1, 1:].ravel(), second], [first, second, number[1:, :-1].ravel()]]
    mesh = plain_mesh(places.reshape(-1, 3), np.concatenate(faces, axis=1).T)
    kept = apart.ravel() < 0.095  # a round one
    mesh = plain_mesh(mesh.vertices, mesh.faces[kept[mesh.faces].all(axis=1)])
    mesh = compacted(mesh.vertices, mesh.faces)
    assert pits(mesh) == []
