# SPDX-License-Identifier: Apache-2.0
"""Small meshes and cameras whose transport is known in closed form."""

from __future__ import annotations

import numpy as np

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.geometry.mesh.triangles import Mesh


def mesh_of(*parts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Mesh:
    """One mesh of several parts (vertices, faces, normals)."""
    starts = np.cumsum([0, *(len(part[0]) for part in parts)])
    return Mesh(
        vertices=np.concatenate([part[0] for part in parts]).astype(np.float32),
        faces=np.concatenate(
            [part[1] + start for part, start in zip(parts, starts[:-1], strict=True)]
        ).astype(np.int32),
        normals=np.concatenate([part[2] for part in parts]).astype(np.float32),
        uvs=np.zeros((0, 2), np.float32),
        uv_faces=np.zeros((0, 3), np.int32),
    )


def patch(corner, first, second, count: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parallelogram from a corner along two edges, count x count cells; normal first x second."""
    corner, first, second = (np.asarray(vector, float) for vector in (corner, first, second))
    steps = np.linspace(0, 1, count + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    vertices = corner + u[:, None] * first + v[:, None] * second
    index = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    low, right = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    up, far = index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([low, right, far], 1), np.stack([low, far, up], 1)])
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal)
    return vertices, faces, np.broadcast_to(normal, vertices.shape)


def box(low, high) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Sides and top of an axis-aligned box, outward; open below."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    return [
        patch((x0, y0, z1), (dx, 0, 0), (0, dy, 0)),
        patch((x0, y0, z0), (dx, 0, 0), (0, 0, dz)),
        patch((x0, y1, z0), (0, 0, dz), (dx, 0, 0)),
        patch((x0, y0, z0), (0, 0, dz), (0, dy, 0)),
        patch((x1, y0, z0), (0, dy, 0), (0, 0, dz)),
    ]


def looking_at(position, target=(0, 0, 0), size: int = 64, focal: float = 1.4) -> Camera:
    """Square camera; the focal length is in image widths."""
    position, target = np.asarray(position, float), np.asarray(target, float)
    back = position - target
    back /= np.linalg.norm(back)
    helper = np.array([0, 0, 1.0]) if abs(back[2]) < 0.99 else np.array([0, 1.0, 0])
    right = np.cross(helper, back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = position
    return Camera(
        width=size,
        height=size,
        fx=focal * size,
        fy=focal * size,
        cx=size / 2,
        cy=size / 2,
        camera_to_world=pose,
    )


def photograph(tracer, shade, camera: Camera, name: str = "view") -> View:
    """View whose pixels are shade(points (N, 3), face (N,), view_dir (N, 3)) in 0..1 display."""
    origins, directions = camera.rays(camera.pixel_centres())
    hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    image = np.zeros((len(origins), 3))
    struck = hits.face >= 0
    points = origins[struck] + hits.distance[struck, None] * directions[struck]
    image[struck] = shade(points, hits.face[struck], -directions[struck])
    shape = (camera.height, camera.width)
    return View(
        name=name,
        image_display=np.rint(255 * image.clip(0, 1)).astype(np.uint8).reshape(*shape, 3),
        mask=np.where(struck, 255, 0).astype(np.uint8).reshape(shape),
        camera=camera,
        split="train",
    )
