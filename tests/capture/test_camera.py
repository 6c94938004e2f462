# SPDX-License-Identifier: Apache-2.0
"""Projection and rays undo each other, and follow the written axis convention."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera

lens = st.floats(20.0, 900.0)


@st.composite
def any_camera(draw) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([draw(st.floats(-2, 2)) for _ in range(3)]).as_matrix()
    pose[:3, 3] = [draw(st.floats(-9, 9)) for _ in range(3)]
    width, height = draw(st.integers(2, 700)), draw(st.integers(2, 500))
    return Camera(
        width=width,
        height=height,
        fx=draw(lens),
        fy=draw(lens),
        cx=width * draw(st.floats(0.2, 0.8)),
        cy=height * draw(st.floats(0.2, 0.8)),
        camera_to_world=pose,
    )


@given(camera=any_camera(), distance=st.floats(0.1, 50.0))
def test_points_on_rays_project_to_their_pixels(camera, distance):
    pixels = np.random.default_rng(0).uniform([0, 0], [camera.width, camera.height], (40, 2))
    origins, directions = camera.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    back, depth = camera.project(origins + distance * directions)
    np.testing.assert_allclose(back, pixels, atol=1e-6)
    np.testing.assert_allclose(depth, distance * directions @ camera.forward, atol=1e-9)


@given(camera=any_camera())
def test_resizing_keeps_rays(camera):
    half = camera.resized(2 * camera.width, 3 * camera.height)
    corner = np.array([[camera.width, camera.height]], dtype=float)
    np.testing.assert_allclose(camera.rays(corner)[1], half.rays(corner * [2, 3])[1], atol=1e-12)


@given(camera=any_camera(), radius=st.floats(0.1, 9.0))
def test_normalising_keeps_pixels(camera, radius):
    centre = np.array([0.3, -2.0, 1.0])
    points = camera.position + camera.rays(camera.pixel_centres()[:20])[1] * 2.5
    unit = camera.normalised(centre, radius)
    np.testing.assert_allclose(
        unit.project((points - centre) / radius)[0], camera.project(points)[0], atol=1e-6
    )


def test_axes_by_hand():
    """A camera at the origin looks along -z; up in the world is up in the picture."""
    camera = Camera(
        width=100, height=80, fx=50.0, fy=40.0, cx=50.0, cy=40.0, camera_to_world=np.eye(4)
    )
    pixels, depth = camera.project(np.array([[1.0, 0.5, -2.0]]))
    np.testing.assert_allclose(pixels, [[75.0, 30.0]])
    assert depth[0] == 2.0
    assert camera.project(np.array([[0.0, 0.0, 1.0]]))[1][0] < 0
    np.testing.assert_allclose(
        camera.pixel_centres()[[0, 1, 100]], [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]
    )
