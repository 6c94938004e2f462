# SPDX-License-Identifier: Apache-2.0
"""What photographs say of a vertex' shift along its normal: by patches, and by outlines.

Patches about the vertices, tilted as the surface is, are read from every photograph that
sees them and compared by normalised cross-correlation (Furukawa and Ponce 2010, "Accurate, dense,
and robust multi-view stereopsis"), which is indifferent to exposure. Only the photographs that
agree best count, so that a highlight or what hides the patch in a few does no harm.

Batch letters: B vertices, V views, D shifts, P points of a patch, K views a vertex.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from robir.capture.camera import Camera
from robir.geometry.hull import mask_distance
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import ReducedPhoto
from robir.geometry.stereo.sweep import StereoPicture
from robir.maths.vectors import orthonormal_frame
from robir.workers import blocks, side_by_side

Floats = NDArray[np.float32]

CHUNK = 2048  # vertices that are judged at a time: their patches then take 100 MB


_LEAST_COSINE = 0.25  # between normal and view, from which a photograph judges it
_BORDER = 3.0  # distance from a picture's border below which it judges nothing (pixels)
_VIEWS = 8  # most photographs that judge a vertex
_WINDOW = 3  # half side of the patches that are compared, pixels
_NOISE = 0.012  # standard deviation of display values that no texture explains
_GRAZING = 0.2  # cosine between normal and view below which a vertex does
_NEAR = 3.0  # distance of an outline in the picture up to which it is the vertex' own (pixels)
# height above the surface at which rays along the view must be free on both sides (pixels)
_CLEARANCE = 2.5
# share of a vertex' photographs that must agree; the rest may be hidden by what the mesh lacks or
# hold a highlight
_AGREEING = 0.6


def projection(camera: Camera) -> Tensor:
    """(3, 4) matrix from homogeneous points to pixels, with depths above 0 before the camera."""
    lens = np.array(
        [[camera.fx, 0, -camera.cx], [0, -camera.fy, -camera.cy], [0, 0, -1.0]], np.float64
    )
    rotation = camera.camera_to_world[:3, :3].T
    whole = lens @ np.concatenate([rotation, -(rotation @ camera.position)[:, None]], axis=1)
    return torch.from_numpy(whole).float()


def seen_by(
    mesh: Mesh,
    tracer: EmbreeTracer,
    pictures: list[StereoPicture],
    offset: float,
) -> Floats:
    """Cosine (Nv, V) between normals and views; 0 where a photograph does not show a vertex.

    Rays start at `offset` above the surface.
    """
    table = np.zeros((len(mesh.vertices), len(pictures)), np.float32)
    for index, picture in enumerate(pictures):
        camera = picture.camera
        towards = camera.position - mesh.vertices
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.einsum("nd,nd->n", towards, mesh.normals)
        rows = np.flatnonzero(cosine > _LEAST_COSINE)
        places, depth = camera.project(mesh.vertices[rows].astype(np.float64))
        size = np.array([camera.width, camera.height])
        held = (depth > 0) & (places > _BORDER).all(1)
        held &= (places < size - _BORDER).all(1)
        rows, pixel = rows[held], places[held].astype(int)
        rows = rows[picture.whole[pixel[:, 1], pixel[:, 0]]]
        start = mesh.vertices[rows] + offset * mesh.normals[rows]
        free = ~tracer.is_blocked(start, towards[rows].astype(np.float32))
        table[rows[free], index] = cosine[rows[free]]
    return table


def agreement(patches: Tensor, valid: Tensor, share: float) -> Tensor:
    """Mean correlation (B, D) of the `share` of the photographs of a patch that agree best.

    Of zero-mean patches (B, K, D, P) of about unit length, valid (B, K) or not; each photograph's
    mean with all others; 0 where fewer than two show the patch.
    """
    total = (patches * valid[..., None, None]).sum(1, keepdim=True)
    count = valid.sum(1)
    own = patches.square().sum(-1)
    with_others = ((patches * total).sum(-1) - own) / (count - 1).clamp(min=1)[:, None, None]
    ranked = with_others.masked_fill(valid[..., None] == 0, -2.0).sort(1, descending=True).values
    kept = (share * count).ceil().clamp(min=2)
    rank = torch.arange(patches.shape[1])
    use = (rank < kept[:, None]) & (rank < count[:, None])
    mean = (ranked * use[..., None]).sum(1) / use.sum(1).clamp(min=1)[:, None]
    return torch.where(count[:, None] >= 2, mean, 0.0)


class SurfacePatches:
    """Square patches tangent to a mesh's vertices, as photographs show them."""

    def __init__(self, mesh: Mesh, spacing: float, half: int) -> None:
        self._middle = torch.from_numpy(mesh.vertices)
        self._normal = torch.from_numpy(mesh.normals)
        steps = spacing * torch.arange(-half, half + 1).float()
        first, second = (
            part.reshape(-1, 1) for part in torch.meshgrid(steps, steps, indexing="ij")
        )
        self._first, self._second = first, second

    def read(self, picture: StereoPicture, rows: Tensor, shifts: Tensor, noise: float) -> Tensor:
        """Patches (B, D, P), their mean taken out, divided by their length and that of noise."""
        normal = self._normal[rows]
        one, two = orthonormal_frame(normal)
        across = self._first * one[:, None] + self._second * two[:, None]
        matrix = projection(picture.camera)
        middle = self._middle[rows, None] + shifts[:, None] * normal[:, None]
        centre = middle @ matrix[:, :3].T + matrix[:, 3]
        around = across @ matrix[:, :3].T
        right, down, depth = (
            centre[:, :, None, axis] + around[:, None, :, axis] for axis in range(3)
        )
        height, width = picture.grey.shape
        places = torch.stack(
            [right / depth * (2 / width) - 1, down / depth * (2 / height) - 1], dim=-1
        )
        values = grid_sample(
            picture.grey[None, None],
            places.view(1, len(rows), -1, 2),
            padding_mode="border",
            align_corners=False,
        ).view(right.shape)
        values = values - values.mean(-1, keepdim=True)
        return values / (values.square().sum(-1, keepdim=True) + right.shape[2] * noise**2).sqrt()


def correlations(
    mesh: Mesh, pictures: list[StereoPicture], cosine: Floats, shifts: Floats
) -> Floats:
    """Agreement (Nv, D) of the photographs about every vertex at shifts (D,); 0 by fewer than two.

    `cosine` (Nv, V) is of `seen_by`.
    """
    patches = SurfacePatches(mesh, pixel_size([picture.camera for picture in pictures]), _WINDOW)
    count = min(_VIEWS, len(pictures))
    order = np.argsort(-cosine, axis=1, kind="stable")[:, :count]
    visible = np.take_along_axis(cosine, order, axis=1) > 0
    tried, points = torch.from_numpy(shifts), (2 * _WINDOW + 1) ** 2

    def agreement_of(part: slice) -> Floats:
        chosen, valid = order[part], visible[part]
        held = torch.zeros(len(chosen), count, len(shifts), points)
        for view in np.unique(chosen[valid]):
            row, slot = np.nonzero((chosen == view) & valid)
            rows = torch.from_numpy(row + part.start)
            held[row, slot] = patches.read(pictures[view], rows, tried, _NOISE)
        told = torch.from_numpy(valid.astype(np.float32))
        return agreement(held, told, _AGREEING).numpy()

    return np.concatenate(side_by_side(agreement_of, blocks(len(cosine), CHUNK)))


def pixel_size(cameras: list[Camera]) -> float:
    """Width of a pixel at the middle of the scene, unit frame, median over cameras."""
    return float(np.median([np.linalg.norm(one.position) / one.fx for one in cameras]))


def outline_shifts(
    mesh: Mesh, tracer: EmbreeTracer, photos: list[ReducedPhoto], pixel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean shifts (Nv,) along normals that put vertices on the outlines they form.

    Also the number of photographs (Nv,) in whose outline a vertex lies.
    """
    total, count = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
    for photo in photos:
        camera = photo.camera
        towards = camera.position - mesh.vertices
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.abs(np.einsum("nd,nd->n", towards, mesh.normals))
        rows = np.flatnonzero(cosine < _GRAZING)
        places, depth = camera.project(mesh.vertices[rows].astype(np.float64))
        size = np.array([camera.width, camera.height])
        held = (depth > 0) & (places > 1).all(1) & (places < size - 1).all(1)
        rows, depth, pixels = rows[held], depth[held], places[held].astype(int)
        away = -mask_distance(photo.coverage)[pixels[:, 1], pixels[:, 0]]
        near = np.abs(away) < _NEAR
        rows, depth, away = rows[near], depth[near], away[near]
        above = _CLEARANCE * pixel * mesh.normals[rows]
        start = (mesh.vertices[rows] + above).astype(np.float32)
        ray = towards[rows].astype(np.float32)
        alone = ~tracer.is_blocked(start, ray) & ~tracer.is_blocked(start, -ray)
        total[rows[alone]] += away[alone] * depth[alone] / camera.fx
        count[rows[alone]] += 1
    return total / np.maximum(count, 1), count
