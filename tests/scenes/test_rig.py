# SPDX-License-Identifier: Apache-2.0
"""Cameras: proper rotations, on the band, the whole scene in the picture."""

import numpy as np
import pytest

from blender_scenes import rig
from blender_scenes.recipe import Cameras


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    return rig.camera_poses(40, np.random.default_rng(3))


def test_poses_are_rigid_and_right_handed(poses: np.ndarray) -> None:
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-12)


def test_ground_plate_and_a_tall_object_lie_within_every_picture(poses: np.ndarray) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 64)
    rim = np.stack([0.98 * np.cos(turn), 0.98 * np.sin(turn), np.zeros(64)], axis=1)
    points = np.concatenate([rim, rim * 0.5 + [0.0, 0.0, 1.0]])
    for pose in poses:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixels = rig.focal_length(160) * local[:, :2] / -local[:, 2:]
        assert np.abs(pixels).max() < 80.0


def drawn(kind: str, **changes) -> np.ndarray:
    known = {"elevation": (6.0, 60.0), "azimuth": (40.0, 360.0), "margin": 1.1}
    cameras = Cameras(kind=kind, **(known | changes))
    return rig.drawn_poses(30, np.random.default_rng(1), cameras, CENTRE, 1.7)


CENTRE = np.array([0.2, -0.1, 0.6])


@pytest.mark.parametrize("kind", ["dome", "ring", "half dome", "handheld"])
def test_drawn_cameras_are_rigid_and_see_the_whole_sphere(kind: str) -> None:
    found = drawn(kind)
    turns = found[:, :3, :3]
    np.testing.assert_allclose(
        turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-12)
    to_centre = np.einsum("vij,vi->vj", turns, CENTRE - found[:, :3, 3])
    distance = np.linalg.norm(to_centre, axis=1)
    off = np.arccos(-to_centre[:, 2] / distance) + np.arcsin(1.7 / distance)
    aim = 0.12 if kind == "handheld" else 1e-9
    assert off.max() < 0.5 * rig.CAMERA_ANGLE_X + aim
    rolled = np.degrees(np.arcsin(np.abs(turns[:, 2, 0])))
    if kind == "handheld":
        assert 3.0 < rolled.max() <= rig.HANDHELD_ROLL_DEGREES
    else:
        assert rolled.max() < 1e-6


def test_directions_stay_in_their_range() -> None:
    for kind, elevation, azimuth in (
        ("ring", (20.0, 26.0), (40.0, 360.0)),
        ("half dome", (6.0, 60.0), (40.0, 180.0)),
    ):
        found = drawn(kind, elevation=elevation, azimuth=azimuth)
        outward = found[:, :3, 3] - CENTRE
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        height = np.degrees(np.arcsin(outward[:, 2]))
        assert elevation[0] <= height.min() <= height.max() <= elevation[1]
        turn = (np.degrees(np.arctan2(outward[:, 1], outward[:, 0])) - azimuth[0]) % 360.0
        assert turn.max() <= azimuth[1]
        # no gap beyond what jitter leaves
        assert np.diff(np.sort(turn)).max() < 3.0 * azimuth[1] / len(turn)
