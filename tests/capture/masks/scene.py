# SPDX-License-Identifier: Apache-2.0
"""A striped ball and box on a speckled table in a coloured room, traced exactly."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.frames import Distortion

BALL, RADIUS = np.array([0.0, 0.0, 0.5]), 0.5
BOX_LOW, BOX_HIGH = np.array([0.2, -0.3, 0.0]), np.array([0.9, 0.3, 0.35])
TABLE = 3.0


@dataclass(frozen=True)
class Posed:
    """A photograph with truth."""

    name: str
    image_display: np.ndarray
    camera: Camera
    truth: np.ndarray


def cameras(count: int, size: tuple[int, int] = (160, 120)) -> list[Camera]:
    """Cameras on two rings about the object, aimed a little beside its middle."""
    found = []
    for k in range(count):
        turn, rise = 2 * np.pi * k / count, (0.45, 0.9)[k % 2]
        way = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        position, target = 3.2 * way, np.array([0.25, 0.1, 0.3])
        back = (position - target) / np.linalg.norm(position - target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
        lens = {"fx": 1.1 * size[0], "fy": 1.1 * size[0], "cx": size[0] / 2, "cy": size[1] / 2}
        found.append(Camera(width=size[0], height=size[1], camera_to_world=pose, **lens))
    return found


def _noise(points: np.ndarray, scale: float) -> np.ndarray:
    """A repeatable number in [0, 1] for each little cube of space, (N,)."""
    cell = np.floor(points * scale).astype(np.int64)
    mixed = (cell @ np.array([73856093, 19349663, 83492791])) & 0xFFFFFFFF
    return ((mixed * 2654435761) & 0xFFFFFFFF) / 2**32


def _hit(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance to the object, infinite beside it, (N,)."""
    local = origins - BALL
    b = (local * directions).sum(axis=1)
    root = b * b - ((local**2).sum(axis=1) - RADIUS**2)
    ball = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
    with np.errstate(divide="ignore"):
        slabs = np.stack([(BOX_LOW - origins) / directions, (BOX_HIGH - origins) / directions])
    near, far = slabs.min(axis=0).max(axis=1), slabs.max(axis=0).min(axis=1)
    return np.minimum(ball, np.where((near < far) & (near > 0), near, np.inf))


def surface(camera: Camera) -> np.ndarray:
    """Points (N, 3) of the object that a camera's pixels show."""
    origins, directions = camera.rays(camera.pixel_centres())
    distance = _hit(origins, directions)
    hit = np.isfinite(distance)
    return origins[hit] + distance[hit, None] * directions[hit]


def colours(
    camera: Camera, pixels: np.ndarray, has_camouflage: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Display colours (N, 3) in [0, 1] and object hits (N,) at image points."""
    origins, directions = camera.rays(pixels)
    distance = _hit(origins, directions)
    hit = np.isfinite(distance)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_table = -origins[:, 2] / directions[:, 2]
    points = origins + np.where(hit, distance, 0)[:, None] * directions
    floor = origins + np.where(to_table > 0, to_table, 0)[:, None] * directions
    on_table = (to_table > 0) & (np.hypot(floor[:, 0], floor[:, 1]) < TABLE)
    room = np.array([0.35, 0.45, 0.6]) + 0.1 * _noise(4 * directions, 1.0)[:, None]
    wood = np.array([0.6, 0.45, 0.3]) * (0.8 + 0.35 * _noise(floor, 12.0))[:, None]
    paint = np.array([0.75, 0.15, 0.2]) * (0.5 + 0.6 * _noise(points, 10.0))[:, None]
    if has_camouflage:
        paint = np.array([0.6, 0.45, 0.3]) * (0.8 + 0.35 * _noise(points, 12.0))[:, None]
        room = np.array([0.6, 0.45, 0.3]) * (0.8 + 0.35 * _noise(9 * directions, 1.0))[:, None]
    behind = np.where(on_table[:, None], wood, room)
    return np.where(hit[:, None], paint, behind), hit


@functools.cache
def photographs(
    count: int,
    has_camouflage: bool = False,
    distortion: Distortion | None = None,
    size: tuple[int, int] = (160, 120),
) -> list[Posed]:
    """Photographs of the scene, not to be written to; with `distortion`, as its lens bends them."""
    found = []
    for k, camera in enumerate(cameras(count, size)):
        total, cover = 0.0, 0.0
        for dx in (-0.25, 0.25):
            for dy in (-0.25, 0.25):
                pixels = camera.pixel_centres() + np.array([dx, dy])
                if distortion is not None:
                    pixels = straight(camera, pixels, distortion)
                shade, hit = colours(camera, pixels, has_camouflage)
                total, cover = total + 0.25 * shade, cover + 0.25 * hit
        shape = (camera.height, camera.width)
        image = np.rint(255 * np.clip(total, 0, 1)).astype(np.uint8).reshape(*shape, 3)
        found.append(Posed(f"{k:03d}", image, camera, cover.reshape(shape) > 0.5))
    return found


def straight(camera: Camera, pixels: np.ndarray, distortion: Distortion) -> np.ndarray:
    """Where a pinhole camera sees what a lens puts at these pixels, by Newton's method."""
    size = np.array([camera.fx, camera.fy])
    middle = np.array([camera.cx, camera.cy])
    goal = (pixels - middle) / size
    at = goal.copy()
    for _ in range(8):
        value = np.stack(distortion.apply(*at.T), axis=1)
        step = 1e-6
        by_x = (np.stack(distortion.apply(at[:, 0] + step, at[:, 1]), axis=1) - value) / step
        by_y = (np.stack(distortion.apply(at[:, 0], at[:, 1] + step), axis=1) - value) / step
        jacobian = np.stack([by_x, by_y], axis=2)
        at -= np.linalg.solve(jacobian, (value - goal)[..., None])[..., 0]
    return at * size + middle


def save_nerfstudio(root: Path, shots: list[Posed], distortion: Distortion | None = None) -> Path:
    """The photographs as a nerfstudio capture without masks."""
    (root / "images").mkdir(parents=True)
    frames = []
    for shot in shots:
        Image.fromarray(shot.image_display).save(root / "images" / f"{shot.name}.png")
        pose = shot.camera.camera_to_world.tolist()
        frames.append({"file_path": f"images/{shot.name}.png", "transform_matrix": pose})
    camera = shots[0].camera
    facts = {
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "w": camera.width,
        "h": camera.height,
        "frames": frames,
    }
    if distortion is not None:
        k1, k2 = distortion.radial[:2]
        facts |= {"camera_model": "OPENCV", "k1": k1, "k2": k2, "p1": 0.0, "p2": 0.0}
    (root / "transforms.json").write_text(json.dumps(facts))
    return root


def overlap(one: np.ndarray, two: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((one & two).sum() / (one | two).sum())
