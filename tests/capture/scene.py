# SPDX-License-Identifier: Apache-2.0
"""A sphere and a box traced exactly, away from the origin, for tests of the readers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robir.capture.camera import Camera
from robir.capture.capture import Capture

CENTRE = np.array([3.0, -2.0, 5.0])
AIM = CENTRE + np.array([0.15, 0.0, 0.0])
BALL = 0.6
BOX_LOW, BOX_HIGH = np.array([0.2, -0.4, -0.5]), np.array([0.9, 0.4, 0.1])


@dataclass(frozen=True)
class Shot:
    """A picture with the camera that took it."""

    camera: Camera  # truth
    rgba: np.ndarray  # (H, W, 4) uint8, straight alpha


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera-to-world with OpenGL axes, z up."""
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
    return pose


def cameras(count: int = 8, odd_lens: bool = False, size: tuple[int, int] = (48, 48)) -> list:
    """Cameras all around the object; `odd_lens` is off centre with fx != fy."""
    width, height = size
    lens = {"fx": 60.0, "fy": 60.0, "cx": width / 2, "cy": height / 2}
    if odd_lens:
        lens = {"fx": 58.0, "fy": 63.0, "cx": 22.25, "cy": 25.5}
    result = []
    for i in range(count):
        # Golden angle in azimuth, heights from below to above: no two alike.
        azimuth, sine = 2.4 * i, -0.6 + 1.4 * i / max(count - 1, 1)
        cosine = np.sqrt(1 - sine * sine)
        direction = np.array([cosine * np.cos(azimuth), cosine * np.sin(azimuth), sine])
        pose = look_at(CENTRE + 3.4 * direction, AIM)
        result.append(Camera(width=width, height=height, camera_to_world=pose, **lens))
    return result


def trace(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Where rays first meet the object, (N,) distances, infinite for those that miss."""
    local = origins - CENTRE
    b = (local * directions).sum(axis=1)
    root = b * b - ((local**2).sum(axis=1) - BALL**2)
    ball = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
    with np.errstate(divide="ignore"):
        slabs = np.stack([(BOX_LOW - local) / directions, (BOX_HIGH - local) / directions])
    near, far = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
    return np.minimum(ball, np.where((near < far) & (near > 0), near, np.inf))


def shoot(camera: Camera, samples: int = 4) -> Shot:
    """Picture of the object with a smooth texture and an anti-aliased alpha."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((camera.height * camera.width, 4))
    for dx in offsets:
        for dy in offsets:
            origins, directions = camera.rays(camera.pixel_centres() + np.array([dx, dy]))
            distance = trace(origins, directions)
            hit = np.isfinite(distance)
            points = origins + np.where(hit, distance, 0.0)[:, None] * directions - CENTRE
            total[:, :3] += np.where(hit[:, None], 0.5 + 0.4 * np.sin(3 * points), 0.0)
            total[:, 3] += hit
    mean = total[:, :3] / np.maximum(total[:, 3:], 1)
    rgba = np.concatenate([mean, total[:, 3:] / samples**2], axis=1)
    shape = (camera.height, camera.width, 4)
    return Shot(camera, np.rint(255 * rgba).astype(np.uint8).reshape(shape))


def surface_points(count: int = 4000) -> np.ndarray:
    """Points on the outside of the object, (N, 3)."""
    generator = np.random.default_rng(0)
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    target = CENTRE + generator.uniform(BOX_LOW - 0.3, BOX_HIGH + 0.3, size=(count, 3))
    origins = target + 5.0 * direction
    distance = trace(origins, -direction)
    hit = np.isfinite(distance)
    return (origins - distance[:, None] * direction)[hit]


def assert_bits_alike(first: Capture, second: Capture) -> None:
    """The same views, pixels, cameras and bounds, to the last bit."""
    assert first.bounds.radius == second.bounds.radius
    for one, two in zip(first.views, second.views, strict=True):
        assert (one.name, one.split) == (two.name, two.split)
        assert np.array_equal(one.image_display, two.image_display)
        assert np.array_equal(one.mask, two.mask)
        assert np.array_equal(one.camera.camera_to_world, two.camera.camera_to_world)
        assert (one.camera.fx, one.camera.fy, one.camera.cx, one.camera.cy) == (
            two.camera.fx,
            two.camera.fy,
            two.camera.cx,
            two.camera.cy,
        )
