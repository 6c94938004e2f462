# SPDX-License-Identifier: Apache-2.0
"""Our own re-renders of views: what the model says a camera would see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.texture.texels import TexelAlbedo, Texels, radiance_towards
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.transport.observe import off_axis_codes
from robir.transport.surfels import interpolate
from robir.workers import side_by_side

Floats = NDArray[np.float32]

MOST_POINTS = 1 << 20  # points of several views that are shaded together; memory limits them

_PIXEL_RAYS = 2  # rays along each side of a pixel


class AtlasLookup:
    """Texel values at points of the mesh."""

    def __init__(self, mesh: Mesh, inside: NDArray[np.bool_]) -> None:
        """Number the texels `inside` (T, T) charts of an unwrapped mesh, row 0 at v = 1."""
        self._mesh = mesh
        self._side = len(inside) // mesh.cells  # of a tile; neighbours are looked for in it only
        self._number = np.full(inside.shape, -1, np.int64)
        self._number[inside] = np.arange(inside.sum())
        # Points on a chart's rim may fall just outside it: the nearest texel within takes over.
        rows, columns = np.nonzero(inside)
        self._inside = np.stack([rows, columns], axis=1)

    def __call__(self, face: NDArray[np.int32], barycentric: Floats) -> NDArray[np.int64]:
        """Index of the texel under each point, (N,)."""
        corners = self._mesh.uvs[self._mesh.uv_faces[face]]
        uv = np.einsum("nc,ncd->nd", barycentric, corners)
        size = len(self._number)
        column = np.clip((uv[:, 0] * size).astype(int), 0, size - 1)
        row = np.clip(((1 - uv[:, 1]) * size).astype(int), 0, size - 1)
        found = self._number[row, column]
        for shift_row, shift_column in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1)):
            missing = found < 0
            near = (
                self._beside(row[missing], shift_row),
                self._beside(column[missing], shift_column),
            )
            found[missing] = self._number[near]
        return found

    def _beside(self, texel: NDArray[np.int64], shift: int) -> NDArray[np.int64]:
        """Rows or columns beside some, in the same tile."""
        first = texel // self._side * self._side
        return np.clip(texel + shift, first, first + self._side - 1)


class TexturedSurface(NamedTuple):
    """A surface with its texture."""

    mesh: Mesh  # unwrapped, unit frame, with the normals that it is rendered with
    tracer: EmbreeTracer  # of the mesh
    lookup: AtlasLookup  # of its texels
    values: TexelAlbedo  # of the texels


@dataclass(frozen=True, slots=True)
class _ViewPoints:
    """Points that rays through the object's pixels of one view meet."""

    view: View
    rows: NDArray[np.int64]  # (M,) rows of the pixels
    columns: NDArray[np.int64]  # (M,) their columns
    pixel: NDArray[np.int64]  # (N,) pixel of each point
    texel: NDArray[np.int64]  # (N,) texel under it
    points: Texels  # where the points lie
    towards: Floats  # (N, 3) float32, unit, towards the camera
    pixel_rays: int  # rays of each pixel

    @classmethod
    def of(cls, view: View, surface: TexturedSurface, rays: int) -> _ViewPoints:
        """Cast the rays of a view, so many along each side of a pixel."""
        mesh, tracer, lookup, _ = surface
        x, y = np.meshgrid(*2 * [(np.arange(rays) + 0.5) / rays])
        within = np.stack([x.ravel(), y.ravel()], axis=1)
        rows, columns = np.nonzero(view.mask > 127)
        places = np.stack([columns, rows], axis=1).astype(np.float64)[:, None] + within
        origins, directions = view.camera.rays(places.reshape(-1, 2))
        hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        texel = np.full(len(directions), -1, np.int64)
        struck = np.flatnonzero(hits.face >= 0)
        texel[struck] = lookup(hits.face[struck], hits.barycentric[struck])
        kept = np.flatnonzero(texel >= 0)
        position, normal = interpolate(mesh, hits.face[kept], hits.barycentric[kept])
        return cls(
            view,
            rows,
            columns,
            kept // len(within),
            texel[kept],
            Texels(position=position, normal=normal),
            -directions[kept].astype(np.float32),
            len(within),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedView:
    """What a view shows."""

    image: NDArray[np.uint8]  # (H, W, 3) uint8, display codes
    # (H, W, 3) uint8, the same of the matt texture: albedo times irradiance over pi, also where the
    # material is metal or glossy
    diffuse: NDArray[np.uint8]
    alpha: NDArray[np.uint8]  # (H, W) uint8, how much of each pixel the asset covers, in 255ths


def render_views(
    problem: Problem,
    light: Light,
    specular: SpecularMaterial,
    views: Sequence[View],
    surface: TexturedSurface,
) -> Iterator[RenderedView]:
    """Render the object's pixels of views with the recovered asset, light and tone curve."""
    *_, values = surface
    largest = max((view.mask.size for view in views), default=1)
    together = max(1, MOST_POINTS // (_PIXEL_RAYS**2 * largest))
    for start in range(0, len(views), together):
        group = views[start : start + together]
        seen = side_by_side(lambda view: _ViewPoints.of(view, surface, _PIXEL_RAYS), group)
        ends = np.cumsum([len(one.texel) for one in seen])[:-1]
        whole, matt = (
            np.split(radiance, ends)
            for radiance in _radiance(problem, light, specular, seen, values)
        )
        for one, radiance, diffuse in zip(seen, whole, matt, strict=True):
            image, alpha = _picture(problem, one, radiance)
            matt_image, _ = _picture(problem, one, diffuse)
            yield RenderedView(image=image, diffuse=matt_image, alpha=alpha)


def _radiance(
    problem: Problem,
    light: Light,
    specular: SpecularMaterial,
    seen: list[_ViewPoints],
    values: TexelAlbedo,
) -> tuple[Floats, Floats]:
    """Radiance (N, 3), linear Rec.709, of the points of all views, and of their matt texture."""
    # views share most of the surface, so what arrives at it, the costly part, is found once
    points = Texels(
        position=np.concatenate([one.points.position for one in seen]),
        normal=np.concatenate([one.points.normal for one in seen]),
    )
    texel = np.concatenate([one.texel for one in seen])
    towards = np.concatenate([one.towards for one in seen])
    material = values.albedo[texel], values.metallic[texel, None]
    return radiance_towards((problem, light, specular), points, (slice(None), towards), material)


def _picture(
    problem: Problem, seen: _ViewPoints, radiance: Floats
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Display image (H, W, 3) of the radiance (N, 3) of a view's points, and its alpha (H, W)."""
    # a pixel is the mean radiance over its square, as on a sensor, and then through the curve
    view, rows, columns = seen.view, seen.rows, seen.columns
    count = np.bincount(seen.pixel, minlength=len(rows))
    filled = np.flatnonzero(count)
    sums = [np.bincount(seen.pixel, radiance[:, channel], len(rows)) for channel in range(3)]
    mean = np.stack(sums, axis=1)[filled] / count[filled, None]
    centres = np.stack([columns[filled], rows[filled]], axis=1) + 0.5
    normals = np.stack(
        [np.bincount(seen.pixel, part, len(rows))[filled] for part in seen.points.normal.T], axis=1
    )
    # sums over no points at all are whole numbers
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-6)
    first = torch.zeros(len(filled), dtype=torch.int64)
    off_axis = off_axis_codes(view.camera, centres)
    gain = problem.gains.at((view.name,), off_axis, normals.astype(np.float32), first)
    shown = problem.curve.display_from_linear(gain * torch.from_numpy(mean.astype(np.float32)))
    image = np.zeros((*view.mask.shape, 3), np.uint8)
    image[rows[filled], columns[filled]] = np.rint(255 * shown.clamp(0, 1).numpy())
    alpha = np.zeros(view.mask.shape, np.uint8)
    alpha[rows, columns] = 255 * count // seen.pixel_rays
    return image, alpha
