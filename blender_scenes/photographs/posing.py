# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a hand holds the camera, and how wrong structure from motion is about it."""

import numpy as np
from scipy.spatial.transform import Rotation

from blender_scenes.photographs.recipe import Errors, Frame, Walk
from blender_scenes.rig import look_at, rolled

AZIMUTH_JITTER = 0.3
"""Of the step between photographs, standard deviation."""

ELEVATION_JITTER = 2.5
"""Degrees, standard deviation."""

LOWEST = 4.0
"""Degrees; the camera does not dive under the table."""

DISTANCE_JITTER = 0.07
AIM_JITTER = 0.09
"""Of where the camera looks, in radii of the thing."""

ROLL_JITTER = 3.5
"""Degrees."""


def walked_poses(walk: Walk, frame: Frame, centre: np.ndarray, radius: float) -> np.ndarray:
    """Camera_to_world (V, 4, 4), OpenGL axes, of the photographs in the order they are taken.

    Args:
        walk: round what and how far.
        frame: of the photographs.
        centre: (3,) of the thing's sphere.
        radius: of it.
    """
    rng = np.random.default_rng(walk.seed)
    shorter = 0.5 * min(frame.width, frame.height) / frame.focal
    distance = radius / np.sin(np.arctan(walk.fill * shorter))
    poses = []
    for arc in walk.arcs:
        step = arc.width / arc.photographs
        azimuths = arc.start + step * (
            np.arange(arc.photographs) + AZIMUTH_JITTER * _normal(rng, arc.photographs)
        )
        for azimuth in np.radians(azimuths):
            elevation = arc.elevation + ELEVATION_JITTER * _normal(rng, 1)[0]
            elevation = float(np.radians(np.clip(elevation, LOWEST, 85.0)))
            flat = np.cos(elevation)
            out = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
            far = distance * (1.0 + DISTANCE_JITTER * _normal(rng, 1)[0])
            aim = centre + AIM_JITTER * radius * _normal(rng, 3)
            roll = float(np.radians(ROLL_JITTER * _normal(rng, 1)[0]))
            poses.append(rolled(look_at(centre + far * out, aim), roll))
    return np.array(poses)


def _normal(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.clip(rng.normal(size=count), -2.0, 2.0)


def erroneous(
    poses: np.ndarray, frame: Frame, centre: np.ndarray, errors: Errors, seed: int
) -> np.ndarray:
    """Poses with errors that leave the thing nearly where it is in the pictures.

    An error of the focal length is made good by all distances, one of a camera's place by where it
    looks: what remains in the pictures is the error of the aim and what parallax leaves.

    Args:
        poses: (V, 4, 4), right.
        frame: its true focal length turns pixels into angles.
        centre: (3,) of the thing.
        errors: how large.
        seed: of all of them.
    """
    rng = np.random.default_rng(seed)
    pixel = max(frame.width, frame.height) / 1000.0 / frame.focal
    found = []
    for pose in poses:
        x, y, z, radial, aim_x, aim_y, roll = rng.normal(size=7)
        orbit = Rotation.from_rotvec(np.radians(errors.orbit) * np.array([x, y, z])).as_matrix()
        farther = 1.0 + errors.focal + errors.distance * radial
        new = pose.copy()
        new[:3, 3] = centre + farther * orbit @ (pose[:3, 3] - centre)
        angles = [errors.aim * pixel * aim_x, errors.aim * pixel * aim_y]
        own = Rotation.from_rotvec([*angles, np.radians(errors.roll) * roll]).as_matrix()
        new[:3, :3] = orbit @ pose[:3, :3] @ own
        found.append(new)
    return np.array(found)


def placed(
    poses: np.ndarray, points: np.ndarray, seed: int, *, is_upright: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The same in a frame of another turn, scale and origin, as programs choose at random.

    Args:
        poses: (V, 4, 4).
        points: (N, 3).
        seed: of the frame.
        is_upright: whether z stays up.

    Returns:
        Poses and points there.
    """
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    if is_upright:
        turn = Rotation.from_euler("z", rng.uniform(0.0, 360.0), degrees=True).as_matrix()
    scale, shift = float(np.exp(rng.uniform(-1.0, 1.0))), rng.normal(size=3)
    moved = poses.copy()
    moved[:, :3, :3] = turn @ poses[:, :3, :3]
    moved[:, :3, 3] = scale * poses[:, :3, 3] @ turn.T + shift
    return moved, scale * points @ turn.T + shift
