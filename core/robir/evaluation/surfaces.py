# SPDX-License-Identifier: Apache-2.0
"""What cameras see of a mesh, and a mesh as the photographs around a camera show it.

What such a picture lacks is the fault of the surface, of the poses, or of what changes with the
view, for no light and no material is in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.transport.observe import Observations, observe

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleSurface:
    """First hits of a camera's pixel-centre rays on a mesh."""

    hit: Mask  # (H, W) whether the ray meets the mesh
    position: Array  # (H, W, 3), frame of the mesh; 0 where missed
    normal: Array  # (H, W, 3), interpolated vertex normals, unit; 0 where missed
    uv: Array  # (H, W, 2), v upwards; 0 where missed or where the mesh is not unwrapped


class MeshCaster:
    """A mesh ready to be looked at by many cameras; `tracer` is its acceleration structure."""

    def __init__(self, mesh: Mesh) -> None:
        """Build the acceleration structure of a mesh in the cameras' frame."""
        self._mesh = mesh
        self.tracer = EmbreeTracer(mesh.vertices, mesh.faces)

    def cast(self, camera: Camera) -> VisibleSurface:
        """What the camera sees, one ray through every pixel's centre."""
        origins, directions = camera.rays(camera.pixel_centres())
        found = self.tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        hit = found.face >= 0
        mesh, faces = self._mesh, found.face[hit]
        weights = found.barycentric[hit].astype(np.float64)
        shape = (camera.height, camera.width)

        def image(values: Array) -> Array:
            full = np.zeros((len(hit), values.shape[1]))
            full[hit] = values
            return full.reshape(*shape, -1)

        def blend(corners: Array) -> Array:
            return np.einsum("nk,nkc->nc", weights, corners)

        normal = blend(mesh.normals[mesh.faces[faces]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        unwrapped = mesh.is_unwrapped
        uv = blend(mesh.uvs[mesh.uv_faces[faces]]) if unwrapped else np.zeros((len(faces), 2))
        return VisibleSurface(
            hit=hit.reshape(shape),
            position=image(blend(mesh.vertices[mesh.faces[faces]])),
            normal=image(normal),
            uv=image(uv),
        )


def intersection_over_union(estimate: Mask, truth: Mask) -> float:
    """Pixels in both masks over pixels in either; all views together, any equal shapes."""
    either = np.count_nonzero(estimate | truth)
    return float(np.count_nonzero(estimate & truth) / either) if either else 1.0


Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

NEAREST = 4  # photographs that are blended at a point; the next one's angle has weight 0
LEAST_ANGLE = 1e-3  # radians below which photographs count as equally near
CHUNK = 1 << 15  # points that are blended at a time; memory limits them


@dataclass(frozen=True, slots=True, kw_only=True)
class Warped:
    """One camera's view of a surface, RGBA codes; alpha is 0 where no photograph shows it."""

    nearest: Picture  # (H, W, 4), photographs from the most similar directions, blended
    mean: Picture  # (H, W, 4), plain mean of the display values of all that show the point


def warped_views(
    mesh: Mesh, photographs: Sequence[View], cameras: Sequence[Camera], offset: float
) -> Iterator[Warped]:
    """What photographs show at each camera's pixels, by a mesh; rays start `offset` above it."""
    caster = MeshCaster(mesh)
    seen = [caster.cast(camera) for camera in cameras]
    position = np.concatenate([one.position[one.hit] for one in seen]).astype(np.float32)
    normal = np.concatenate([one.normal[one.hit] for one in seen]).astype(np.float32)
    read = observe(caster.tracer, position, normal, tuple(photographs), offset)
    start = 0
    for one, camera in zip(seen, cameras, strict=True):
        chosen = slice(start, start + int(one.hit.sum()))
        start = chosen.stop
        nearest, mean, known = _blended(read, position, chosen, camera.position)
        yield Warped(nearest=_picture(one.hit, nearest, known), mean=_picture(one.hit, mean, known))


def _picture(hit: NDArray[np.bool_], colour: Floats, known: NDArray[np.bool_]) -> Picture:
    """RGBA codes of the pixels (M) that meet the surface."""
    codes = np.zeros((*hit.shape, 4), np.uint8)
    codes[hit, :3] = np.rint(colour)
    codes[hit, 3] = 255 * known
    return codes


def _blended(
    read: Observations, position: Floats, chosen: slice, eye: NDArray[np.float64]
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Blend of the nearest photographs and mean of all (M, 3), and where there is one, (M,)."""
    nearest, mean, known = [], [], []
    for start in range(chosen.start, chosen.stop, CHUNK):
        part = slice(start, min(start + CHUNK, chosen.stop))
        display = read.display[part].astype(np.float32)
        shown = read.weight[part] > 0
        angle = np.where(shown, _angles(position[part], read.positions, eye), np.inf)
        weight = nearness(angle)
        nearest.append(np.einsum("nv,nvc->nc", weight, display))
        count = shown.sum(1)
        mean.append(np.einsum("nv,nvc->nc", shown, display) / np.maximum(count, 1)[:, None])
        known.append(count > 0)
    if not known:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, bool)
    return np.concatenate(nearest), np.concatenate(mean), np.concatenate(known)


def _angles(position: Floats, cameras: Floats, eye: NDArray[np.float64]) -> Floats:
    """Angles (N, V), radians, at points (N, 3) between the directions to an eye and to cameras."""
    towards = eye.astype(np.float32) - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = np.empty((len(position), len(cameras)), np.float32)
    for index, camera in enumerate(cameras):
        other = camera - position
        cosine[:, index] = np.einsum("nd,nd->n", towards, other) / np.linalg.norm(other, axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def nearness(angle: Floats) -> Floats:
    """Weights (N, V) of photographs by the angle at which they see a point beside the wanted view.

    The smaller the angle the heavier, and 0 from that of the first photograph that is not among the
    NEAREST, so that nothing jumps where another one comes in (Buehler et al. 2001, "Unstructured
    lumigraph rendering"). Angles in radians, infinite where a photograph does not show the point;
    weights sum to 1, or to 0 where none shows it.
    """
    limit = np.full(len(angle), np.inf, np.float32)
    if angle.shape[1] > NEAREST:
        limit = np.partition(angle, NEAREST, axis=1)[:, NEAREST]
    limit = np.where(np.isfinite(limit), limit, np.float32(np.pi))[:, None]
    weight = np.clip(1 - angle / np.maximum(limit, LEAST_ANGLE), 0, None)
    weight /= np.maximum(angle, LEAST_ANGLE)
    weight[~np.isfinite(angle)] = 0.0
    total = weight.sum(1, keepdims=True)
    return (weight / np.maximum(total, 1e-12)).astype(np.float32)
