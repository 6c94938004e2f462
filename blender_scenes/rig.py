# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras on a band of the upper hemisphere, looking at the scene's middle."""

import numpy as np

TARGET = np.array([0.0, 0.0, 0.25])
"""World point that every camera looks at; the scenes stand on z = 0 and have radius about 1."""

CAMERA_ANGLE_X = float(np.radians(40.0))
"""Full horizontal field of view in radians."""

ELEVATION_DEGREES = (8.0, 75.0)
DISTANCE = (3.2, 3.6)


def camera_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    """Well-spread poses: a jittered Fibonacci lattice on the elevation band, turned at random.

    Args:
        count: number of cameras V.
        rng: source of turn, jitter and distances.

    Returns:
        (V, 4, 4) camera_to_world, OpenGL axes (x right, y up, looks along -z), world z up.
    """
    low, high = np.sin(np.radians(ELEVATION_DEGREES))
    index = np.arange(count)
    golden = np.pi * (3.0 - np.sqrt(5.0))
    azimuth = index * golden + rng.uniform(0.0, 2.0 * np.pi) + rng.uniform(-0.1, 0.1, count)
    height = low + (high - low) * np.clip(
        (index + rng.uniform(0.2, 0.8, count)) / max(count, 1), 0.0, 1.0
    )
    distance = rng.uniform(*DISTANCE, count)
    flat = np.sqrt(1.0 - height**2)
    outward = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=1)
    poses = [look_at(TARGET + d * o, TARGET) for d, o in zip(distance, outward, strict=True)]
    return np.array(poses).reshape(count, 4, 4)


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera_to_world (4, 4) at `eye` looking at `target`, picture upright against world +z."""
    backward = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    pose[:3, 3] = eye
    return pose


def focal_length(resolution: int) -> float:
    """Focal length in pixels of a square picture of `resolution` pixels."""
    return 0.5 * resolution / float(np.tan(0.5 * CAMERA_ANGLE_X))
