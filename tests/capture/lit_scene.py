# SPDX-License-Identifier: Apache-2.0
"""The test scene under one lamp that stays, for checks of blur and exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from capture.scene import BALL, BOX_HIGH, BOX_LOW, CENTRE, cameras, trace

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, View

BOUNDS = Bounds(centre=CENTRE, radius=1.05, origin="hand")
SUN = np.array([0.5, 0.3, 0.8])


def photograph(camera: Camera, name: str):
    """A view of the scene with sharp patches, a soft highlight and hard shadows."""
    origins, rays = camera.rays(camera.pixel_centres())
    distance = trace(origins, rays)
    hit = np.isfinite(distance)
    points = (origins + np.where(hit, distance, 0.0)[:, None] * rays)[hit]
    normals = _normals(points - CENTRE)
    light = SUN / np.linalg.norm(SUN)
    to_lamp = trace(points + 1e-4 * normals, np.broadcast_to(light, points.shape))
    # What lies behind the start is no obstacle.
    lit = np.isinf(to_lamp) | (to_lamp < 0)
    half = light - rays[hit]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = np.maximum((normals * half).sum(axis=1), 0) ** 40
    local = points - CENTRE
    albedo = 0.4 + 0.15 * np.sign(np.sin(12 * local) * np.sin(17 * local[:, [1, 2, 0]]))
    strength = np.maximum(normals @ light, 0) * lit
    values = albedo * (0.3 + 0.1 * normals[:, 2] + 1.0 * strength)[:, None]
    values = values + (0.2 * gloss * lit)[:, None]
    image = np.full((camera.width * camera.height, 3), 20, dtype=np.uint8)
    image[hit] = np.rint(255 * np.clip(values, 0, 1) ** (1 / 2.2))
    shape = (camera.height, camera.width)
    return View(
        name=name,
        image_display=image.reshape(*shape, 3),
        mask=np.where(hit, 255, 0).astype(np.uint8).reshape(shape),
        camera=camera,
        split="train",
    )


def photographs(count: int = 30) -> list[View]:
    """Views from all around."""
    return [
        photograph(replace(camera, fx=105.0, fy=105.0), f"v{i:02d}")
        for i, camera in enumerate(cameras(count, size=(80, 80)))
    ]


def exposed(view: View, steps: float) -> View:
    """The same photograph with another exposure."""
    linear = (view.image_display / 255.0) ** 2.2 * 2.0**steps
    image = np.rint(255 * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return replace(view, image_display=image)


def _normals(local: np.ndarray) -> np.ndarray:
    """Outward normals at points of the ball and the box, relative to the scene's centre."""
    middle, size = 0.5 * (BOX_LOW + BOX_HIGH), 0.5 * (BOX_HIGH - BOX_LOW)
    inside = (local - middle) / size
    axis = np.argmax(np.abs(inside), axis=1)
    box = np.zeros_like(local)
    rows = np.arange(len(local))
    box[rows, axis] = np.sign(inside[rows, axis])
    radius = np.linalg.norm(local, axis=1, keepdims=True)
    return np.where(np.abs(radius - BALL) < 1e-6, local / radius, box)
