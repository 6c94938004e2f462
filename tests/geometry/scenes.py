# SPDX-License-Identifier: Apache-2.0
"""Small analytic captures for the geometry tests: shapes ray-cast with flat colours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, View
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import detect
from robir.geometry.hull import carve, hull_of
from robir.geometry.lattice import Lattice
from robir.geometry.rays import ReducedPhoto, reduce_view


class Silent:
    """A reporter that nobody listens to."""

    def progress(self, fraction: float, message: str) -> None:
        assert 0.0 <= fraction <= 1.0 and message

    def warn(self, message: str) -> None:
        pass

    def metric(self, name: str, value: object) -> None:
        pass


def camera_at(azimuth: float, elevation: float, side: int, distance: float = 3.2) -> Camera:
    """Camera on a sphere that looks at the origin, z up; angles in radians."""
    back = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = distance * back
    focal = 1.35 * side
    half = 0.5 * side
    return Camera(
        width=side, height=side, fx=focal, fy=focal, cx=half, cy=half, camera_to_world=pose
    )


def checker(points: np.ndarray) -> np.ndarray:
    """A colour for each point: cubes of two colours, so that surfaces have texture."""
    odd = np.floor(points * 5.0).sum(axis=1) % 2 > 0.5
    return np.where(odd[:, None], [220.0, 90.0, 60.0], [70.0, 120.0, 200.0])


def capture_of(
    solid: trimesh.Trimesh,
    views: int = 16,
    side: int = 64,
    low: float = 0.2,
    paint: Callable[[np.ndarray], np.ndarray] = checker,
) -> Capture:
    """Photographs of a mesh in the unit sphere, without light, seen from above.

    Args:
        solid: The mesh.
        views: Number of photographs.
        side: Pixels of each side.
        low: Lowest elevation of a camera, radians.
        paint: Colours in [0, 255] of points on the mesh.

    Returns:
        The capture; its frame is the unit frame.
    """
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(solid)
    out = []
    for number in range(views):
        share = (number + 0.5) / views
        elevation = np.arcsin(np.sin(low) + share * (np.sin(1.25) - np.sin(low)))
        camera = camera_at(2.399963 * number, elevation, side)
        fine = camera.resized(3 * side, 3 * side)
        origins, directions = fine.rays(fine.pixel_centres())
        places, ray, _ = caster.intersects_location(origins, directions, multiple_hits=False)
        image = np.zeros((9 * side * side, 4))
        image[ray, :3], image[ray, 3] = paint(places), 255.0
        blocks = image.reshape(side, 3, side, 3, 4).mean(axis=(1, 3))
        colour = blocks[..., :3] * 255.0 / np.maximum(blocks[..., 3:], 1.0)
        out.append(
            View(
                name=f"view_{number:03d}",
                image_display=np.round(colour).astype(np.uint8),
                mask=np.round(blocks[..., 3]).astype(np.uint8),
                camera=camera,
                split="train",
            )
        )
    bounds = Bounds(centre=np.zeros(3), radius=1.0, origin="made")
    return Capture(source=Path("made"), format="made", views=tuple(out), bounds=bounds)


def ground_of(
    scene: trimesh.Trimesh, paint: Callable[[np.ndarray], np.ndarray]
) -> tuple[Ground, list[ReducedPhoto], Lattice, torch.Tensor]:
    """Ground of a scene as the masks show it, photographs, lattice, and their hull (N,) on it."""
    capture = capture_of(scene, views=32, side=128, low=0.12, paint=paint)
    photos = [reduce_view(view, 128) for view in capture.views]
    lattice, hull = carve(hull_of(photos), 64)
    plane = detect(photos, lattice, hull, torch.Generator().manual_seed(0))
    assert plane is not None
    return Ground(plane, photos, lattice, hull), photos, lattice, hull


def disc(radius: float = 0.9, top: float = -0.3) -> trimesh.Trimesh:
    """A round plate, its upper side at height `top`."""
    plate = trimesh.creation.cylinder(radius=radius, height=0.03, sections=96)
    plate.apply_translation([0.0, 0.0, top - 0.015])
    return plate


def drum(half: float, low: float, high: float) -> trimesh.Trimesh:
    """An upright cylinder between two heights."""
    part = trimesh.creation.cylinder(half, high - low)
    part.apply_translation([0.0, 0.0, 0.5 * (low + high)])
    return part


def ball(radius: float, centre: tuple[float, float, float]) -> trimesh.Trimesh:
    """A sphere."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    sphere.apply_translation(centre)
    return sphere
