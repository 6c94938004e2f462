# SPDX-License-Identifier: Apache-2.0
"""A boulder on a patterned floor, traced exactly, and what compares poses with its cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from capture.scene import look_at
from scipy import ndimage

from robir.capture.camera import Camera
from robir.capture.frames import FrameSet

SIZE = (320, 240)
FOCAL = 340.0
TARGET = np.array([0.0, 0.0, 0.35])
RADIUS = 0.6  # of the boulder, which is a ball half sunk into the floor

COUNT = 20  # photographs of a walk


@dataclass(frozen=True)
class Walk:
    """Photographs in a folder, and the truth about them."""

    folder: Path  # holds p00.png and so on, and masks
    cameras: list[Camera]  # truth
    pictures: list[np.ndarray]  # pixels
    masks: list[np.ndarray]  # of the boulder


@dataclass(frozen=True)
class Registered:
    """Frames found, the messages on the way, and the folder they were found in."""

    frames: FrameSet
    messages: list[str]
    work: Path


def ring(count: int, size: tuple[int, int] = SIZE, focal: float = FOCAL) -> list[Camera]:
    """Cameras around the boulder at two heights in turn, about 2.7 from it."""
    width, height = size
    lens = {"fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2}
    cameras = []
    for i in range(count):
        azimuth, elevation = 2 * np.pi * i / count, np.radians((30.0, 48.0)[i % 2])
        flat = np.array([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
        position = TARGET + (2.7 + 0.2 * np.sin(5 * azimuth)) * np.append(flat, np.sin(elevation))
        pose = look_at(position, TARGET)
        cameras.append(Camera(width=width, height=height, camera_to_world=pose, **lens))
    return cameras


def photograph(camera: Camera, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Picture (H, W, 3) uint8 and the boulder's mask; the seed decides the pattern."""
    rng = np.random.default_rng(seed)
    lattices = [rng.random((64, 64, 64), dtype=np.float32) for _ in range(2)]
    colours = rng.uniform(0.3, 1.0, (2, 3))
    image = np.zeros((camera.height * camera.width, 3))
    mask = np.zeros(camera.height * camera.width)
    for offset in ((-0.25, -0.25), (0.25, 0.25)):
        origins, directions = camera.rays(camera.pixel_centres() + np.array(offset))
        floor = -origins[:, 2] / directions[:, 2]
        b = (origins * directions).sum(axis=1)
        root = b * b - (origins**2).sum(axis=1) + RADIUS**2
        ball = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
        is_ball = (ball < floor) | (floor < 0) & np.isfinite(ball)
        distance = np.where(is_ball, ball, np.where(floor > 0, np.minimum(floor, 50.0), 50.0))
        points = origins + distance[:, None] * directions
        for kind, chosen in enumerate((~is_ball, is_ball)):
            value = pattern(lattices[kind], points[chosen])
            image[chosen] += 0.5 * value[:, None] * colours[kind]
        mask += 0.5 * is_ball
    shape = (camera.height, camera.width)
    picture = np.rint(255 * image.reshape(*shape, 3)).clip(0, 255).astype(np.uint8)
    return picture, np.rint(255 * mask.reshape(shape)).astype(np.uint8)


def pattern(lattice: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Solid noise in [0, 1], three octaves, (N,) values at (N, 3) points."""
    total = np.zeros(len(points))
    for octave, weight in ((5.0, 0.35), (11.0, 0.4), (23.0, 0.25)):
        at = np.mod(points * octave + 7.3 * octave, 63)
        total += weight * ndimage.map_coordinates(lattice, at.T, order=1, mode="grid-wrap")
    return np.clip(2.2 * (total - 0.5) + 0.5, 0, 1)


def align(found: Sequence[np.ndarray], truth: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Errors of camera-to-world matrices after the similarity that fits the positions best.

    Umeyama 1991, equations 40 to 42.

    Returns:
        Angles in degrees (N,) and distances in the truth's unit (N,).
    """
    a = np.array([pose[:3, 3] for pose in found])
    b = np.array([pose[:3, 3] for pose in truth])
    ca, cb = a - a.mean(axis=0), b - b.mean(axis=0)
    u, s, vt = np.linalg.svd(cb.T @ ca)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = (s * np.diag(sign)).sum() / (ca**2).sum()
    distances = np.linalg.norm(cb - scale * ca @ rotation.T, axis=1)
    angles = []
    for one, other in zip(found, truth, strict=True):
        left = other[:3, :3].T @ rotation @ one[:3, :3]
        angles.append(np.degrees(np.arccos(np.clip((np.trace(left) - 1) / 2, -1, 1))))
    return np.array(angles), distances
