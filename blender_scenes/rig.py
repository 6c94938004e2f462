# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras on a band of the upper hemisphere, looking at the scene's middle."""

import numpy as np

from blender_scenes.recipe import Cameras

TARGET = np.array([0.0, 0.0, 0.25])
"""World point that every camera looks at; the scenes stand on z = 0 and have radius about 1."""

CAMERA_ANGLE_X = float(np.radians(40.0))
"""Full horizontal field of view in radians."""

ELEVATION_DEGREES = (8.0, 75.0)
DISTANCE = (3.2, 3.6)

NEARNESS = (1.0, 1.12)
"""Random factor on the distance of a camera that follows a recipe."""

HANDHELD_DISTANCE = (0.95, 1.35)
HANDHELD_AIM = 0.08
"""Spread of where a hand-held camera aims about the scene's middle, in radii."""

HANDHELD_ROLL_DEGREES = 12.0
"""The most that a hand-held camera is tilted about its axis."""

GOLDEN_SHARE = 0.5 * (np.sqrt(5.0) - 1.0)


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


def drawn_poses(
    count: int, rng: np.random.Generator, cameras: Cameras, centre: np.ndarray, radius: float
) -> np.ndarray:
    """Poses that follow a recipe, as far away as the scene is large.

    Args:
        count: number of cameras V.
        rng: source of jitter and distances.
        cameras: kind, range of directions and margin.
        centre: (3,) of the sphere that holds the scene.
        radius: of that sphere.

    Returns:
        (V, 4, 4) camera_to_world, OpenGL axes, world z up.
    """
    index = np.arange(count)
    start, width = np.radians(cameras.azimuth)
    step = index / max(count, 1) if cameras.kind == "ring" else (index * GOLDEN_SHARE) % 1.0
    azimuth = start + width * ((step + rng.uniform(-0.02, 0.02, count)) % 1.0)
    low, high = np.sin(np.radians(cameras.elevation))
    rank = rng.permutation(count) if cameras.kind == "ring" else index
    height = low + (high - low) * (rank + rng.uniform(0.2, 0.8, count)) / max(count, 1)
    flat = np.sqrt(1.0 - height**2)
    outward = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=1)
    is_handheld = cameras.kind == "handheld"
    far = rng.uniform(*(HANDHELD_DISTANCE if is_handheld else NEARNESS), count)
    distance = cameras.margin * far * radius / np.sin(0.5 * CAMERA_ANGLE_X)
    aims = centre + is_handheld * HANDHELD_AIM * radius * rng.normal(size=(count, 3))
    rolls = is_handheld * np.radians(rng.uniform(-1.0, 1.0, count) * HANDHELD_ROLL_DEGREES)
    poses = [
        rolled(look_at(centre + d * o, aim), roll)
        for d, o, aim, roll in zip(distance, outward, aims, rolls, strict=True)
    ]
    return np.array(poses).reshape(count, 4, 4)


def rolled(pose: np.ndarray, angle: float) -> np.ndarray:
    """A pose (4, 4) turned about its own view axis by an angle in radians."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return pose @ turn


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
