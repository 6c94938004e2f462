# SPDX-License-Identifier: Apache-2.0
"""Similarities against 4x4 matrices and their inverse, and what is moved by them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera
from robir.capture.support import Plane
from robir.maths.similarity import Similarity


def some(seed: int) -> Similarity:
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    return Similarity(turn=turn, scale=float(rng.uniform(0.2, 5)), shift=rng.normal(size=3))


def matrix(place: Similarity) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = place.scale * place.turn, place.shift
    return whole


POINTS = np.random.default_rng(9).normal(size=(7, 3))


def test_it_is_its_matrix():
    place, first = some(1), some(2)
    by_hand = np.c_[POINTS, np.ones(7)] @ matrix(place).T
    assert place(POINTS) == pytest.approx(by_hand[:, :3])
    assert matrix(place.after(first)) == pytest.approx(matrix(place) @ matrix(first))
    assert matrix(place.inverse) == pytest.approx(np.linalg.inv(matrix(place)))


def test_outside_it_does_the_same_to_what_the_unit_sphere_stands_for():
    place, centre, radius = some(3), np.array([1.0, -2.0, 0.5]), 3.0
    moved = place.outside(centre, radius)(centre + radius * POINTS)
    assert moved == pytest.approx(centre + radius * place(POINTS))


def test_a_moved_camera_sees_moved_points_where_it_saw_them():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = some(5).turn, [0.3, -0.2, 4.0]
    camera = Camera(width=90, height=60, fx=80.0, fy=85.0, cx=44.0, cy=31.0, camera_to_world=pose)
    place = some(6)
    moved = camera.moved(place)
    pixels, depth = camera.project(POINTS)
    again, farther = moved.project(place(POINTS))
    assert again == pytest.approx(pixels)
    assert farther == pytest.approx(place.scale * depth)
    turn = moved.camera_to_world[:3, :3]
    assert turn @ turn.T == pytest.approx(np.eye(3))


def test_points_keep_their_height_above_a_moved_plane():
    plane = Plane(normal=np.array([0.6, 0.0, 0.8]), offset=1.3, tolerance=0.1)
    place = some(7)
    moved = plane.moved(place)
    assert moved.height(place(POINTS)) == pytest.approx(place.scale * plane.height(POINTS))
    assert moved.tolerance == pytest.approx(0.1 * place.scale)
