# SPDX-License-Identifier: Apache-2.0
"""Cameras: proper rotations, on the band, the whole scene in the picture."""

import numpy as np
import pytest

from blender_scenes import rig


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return rig.camera_poses(40, np.random.default_rng(3))


def test_poses_are_rigid_and_right_handed(poses: np.ndarray) -> None:
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-12)


def test_pictures_stand_upright(poses: np.ndarray) -> None:
    np.testing.assert_allclose(poses[:, 2, 0], 0.0, atol=1e-12)
    assert (poses[:, 2, 1] > 0.0).all()


def test_elevations_fill_the_band_and_distances_the_range(poses: np.ndarray) -> None:
    offset = poses[:, :3, 3] - rig.TARGET
    distance = np.linalg.norm(offset, axis=1)
    elevation = np.degrees(np.arcsin(offset[:, 2] / distance))
    assert rig.ELEVATION_DEGREES[0] <= elevation.min() < 12.0
    assert 68.0 < elevation.max() <= rig.ELEVATION_DEGREES[1]
    assert rig.DISTANCE[0] <= distance.min()
    assert distance.max() <= rig.DISTANCE[1]


def test_ground_plate_and_a_tall_object_lie_within_every_picture(poses: np.ndarray) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 64)
    rim = np.stack([0.98 * np.cos(turn), 0.98 * np.sin(turn), np.zeros(64)], axis=1)
    points = np.concatenate([rim, rim * 0.5 + [0.0, 0.0, 1.0]])
    for pose in poses:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixels = rig.focal_length(160) * local[:, :2] / -local[:, 2:]
        assert np.abs(pixels).max() < 80.0


def test_an_empty_set_of_cameras_is_an_empty_array() -> None:
    assert rig.camera_poses(0, np.random.default_rng(0)).shape == (0, 4, 4)
