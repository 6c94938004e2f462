# SPDX-License-Identifier: Apache-2.0
"""Textures as fine as the photographs: detail that shading cannot explain is albedo.

Albedo is solved on texels of a moderate size. What a photograph shows finer than these,

    d(p) = log linear(p) - log mean of linear about p over one solved texel,

is free of exposure and of all light that varies slowly. The few photographs that resolve a spot
best agree on it, and albedo is multiplied by exp d, as in multi-band blending (Burt and Adelson
1983, "A multiresolution spline with application to image mosaics"; Allene, Pons and Keriven 2008,
"Seamless image-based texture atlases using multi-band blending").

Batch letters: N fine texels, M of them in one view, K views a texel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample

from robir.appearance.texture.texels import MAX_ALBEDO, MIN_ALBEDO, TexelAlbedo
from robir.capture.capture import Bounds, View
from robir.capture.checks.coverage import relative_sharpness
from robir.capture.images.loading import resize_view
from robir.geometry.mesh.tiles import sample_texture
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh, face_geometry
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import MASK_INSIDE, clean_pixels
from robir.transport.surfels import interpolate
from robir.workers import blocks, side_by_side

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

BLOCK = 1 << 21  # texels that are worked on at a time; each takes some hundred bytes

_BEST_VIEWS = 4  # whose detail is blended at a texel
# best at a corner of a triangle that its texels are looked up in: more than are blended, for the
# order differs from spot to spot
_CANDIDATES = 6
_STEEPNESS = 4.0  # power of a view's pixels on a unit of surface by which it counts against others
_DEPTH_SIDE = 400  # longer side of the pictures by which is told what hides a texel (pixels)
# difference of depth, unit frame, up to which a texel is the surface that a pixel sees
_DEPTH_TOLERANCE = 0.015
_LEAST_COSINE = 0.3  # views flatter than this blur all detail
# of the logarithm of radiance: most that a spot may differ from its surroundings
_MOST_DETAIL = 1.5
# difference of detail between views, natural logarithm, from which they count as disagreeing: a
# highlight's edge is in one of them only
_DISAGREEMENT = 0.1
_TOGETHER = 4  # photographs read at a time: each holds all texels
_ROUNDS = 3  # how often the mean is found anew without those that disagree


class SharpestViews:
    """The photographs, and which of them resolve a spot of the surface best."""

    def __init__(
        self,
        surface: tuple[Mesh, EmbreeTracer],
        views: Sequence[View],
        curve: AbstractToneCurve,
    ) -> None:
        """Of an unwrapped mesh, unit frame, with its tracer, and views, unit frame."""
        self.mesh, tracer = surface
        unit = Bounds(centre=np.zeros(3), radius=1.0, origin="")
        sharp = np.minimum(relative_sharpness(views, unit), 1.0)
        self._lenses = [
            _Lens(view, tracer, curve, float(factor))
            for view, factor in zip(views, sharp, strict=True)
        ]
        self._area = float(face_geometry(self.mesh.vertices, self.mesh.faces)[1].sum())

    def texel(self, count: int) -> float:
        """Width, unit frame, of so many texels that fill the charts."""
        return math.sqrt(self._area / max(1, count))

    @cached_property
    def _best(self) -> Mask:
        """Which photographs (F, V) may be among the best of a triangle's texels.

        Those best at one of its corners; all of them where corners are seen by too few.
        """
        mesh, lenses = self.mesh, self._lenses
        if len(lenses) <= _CANDIDATES:
            return np.ones((len(mesh.faces), len(lenses)), bool)
        vertices, normals = mesh.vertices.astype(np.float32), mesh.normals.astype(np.float32)
        weight = np.stack(
            side_by_side(lambda lens: lens.weights(vertices, normals), lenses), axis=1
        )
        least = np.partition(weight, -_CANDIDATES, axis=1)[:, -_CANDIDATES]
        best = ((weight > 0) & (weight >= least[:, None]))[mesh.faces].any(axis=1)
        best[best.sum(axis=1) < _BEST_VIEWS] = True
        return best

    def details(
        self, where: tuple[NDArray[np.int32], Floats], widths: tuple[float, float]
    ) -> tuple[Floats, Floats]:
        """Weights (N, K) and logs (N, K, 3) of what the best views show over what lies about.

        Of points by face (N,) and barycentric coordinates (N, 3), as means over squares of the
        first width over those of the second, unit frame; 0 where fewer show the point well.
        """
        face, barycentric = where
        position, normal = interpolate(self.mesh, face, barycentric)
        best = self._best  # here, as threads would find it each for itself
        weight = np.zeros((len(position), _BEST_VIEWS), np.float32)
        detail = np.zeros((len(position), _BEST_VIEWS, 3), np.float32)
        for some in blocks(len(self._lenses), _TOGETHER):
            least = weight.min(1)

            def read(
                number: int, least: Floats = least
            ) -> tuple[NDArray[np.int64], Floats, Floats]:
                asked = np.flatnonzero(best[face, number])
                points = position[asked], normal[asked]
                texel, counts, own = self._lenses[number].read(points, least[asked], widths)
                return asked[texel], counts, own

            for texel, counts, own in side_by_side(read, range(len(self._lenses))[some]):
                slot = weight[texel].argmin(1)
                better = counts > weight[texel, slot]
                texel, slot = texel[better], slot[better]
                weight[texel, slot] = counts[better]
                detail[texel, slot] = own[better]
        return weight, detail


def finer(
    values: TexelAlbedo, inside: Mask, views: SharpestViews, side: int
) -> tuple[Mask, TexelAlbedo]:
    """Texture values with the photographs' detail, and the filled texels (side, side).

    Of values as solved and the texels (T, T) they belong to. A side of no more than T leaves all
    as it is.
    """
    if side <= len(inside):
        return inside, values
    face, barycentric = rasterise_atlas(views.mesh, side)
    held = face >= 0
    rows, columns = np.nonzero(held)
    uv = np.stack([(columns + 0.5) / side, 1.0 - (rows + 0.5) / side], axis=1)
    fine = _upsampled(values, inside, uv, views.mesh.cells)
    face, barycentric = face[held], barycentric[held].astype(np.float32)
    widths = views.texel(len(face)), views.texel(int(inside.sum()))
    albedo = fine.albedo.copy()
    for start in range(0, len(rows), BLOCK):
        part = slice(start, start + BLOCK)
        detail = agreed(*views.details((face[part], barycentric[part]), widths))
        detail[fine.metallic[part] > 0.5] = 0.0
        made = albedo[part] * np.exp(detail)
        albedo[part] = made.clip(MIN_ALBEDO, MAX_ALBEDO)
    return held, replace(fine, albedo=albedo)


def agreed(weight: Floats, detail: Floats) -> Floats:
    """Mean detail (N, 3) of log (N, K, 3) by weights (N, K); what stands alone counts little."""
    weight = weight / np.maximum(weight.max(1, keepdims=True), 1e-20)
    share = weight
    mean = np.zeros((len(weight), 3), np.float32)
    for _ in range(_ROUNDS):
        total = np.maximum(share.sum(1, keepdims=True), 1e-9)
        mean = np.einsum("nk,nkc->nc", share / total, detail)
        apart = np.abs(detail - mean[:, None]).mean(2)
        share = weight / (1.0 + (apart / _DISAGREEMENT) ** 2)
    return mean


def _upsampled(
    values: TexelAlbedo, inside: Mask, uv: NDArray[np.float64], cells: int
) -> TexelAlbedo:
    """The values at points (N, 2) of the atlas, read between texels of their own cell."""

    def at(column: NDArray[np.generic]) -> Floats:
        full = np.zeros((*inside.shape, *column.shape[1:]), np.float32)
        full[inside] = column
        layer = full.reshape(*inside.shape, -1)
        blocks = [
            sample_texture(layer, uv[start : start + BLOCK], inside, cells).astype(np.float32)
            for start in range(0, len(uv), BLOCK)
        ]
        return np.concatenate(blocks).reshape(len(uv), *column.shape[1:])

    return TexelAlbedo(
        albedo=at(values.albedo),
        coverage=np.rint(at(values.coverage)).astype(np.int64),
        read=at(values.read),
        uncertainty=at(values.uncertainty),
        roughness=at(values.roughness),
        metallic=(at(values.metallic) > 0.5).astype(np.float32),
    )


@dataclass(frozen=True, slots=True)
class _Levels:
    """A photograph and its means over ever larger squares."""

    # (1, 4, H, W) float32 each, half as large as the one before: radiance times what counts, and
    # what counts
    layers: tuple[Tensor, ...]

    @classmethod
    def of(cls, radiance: Tensor, counts: Tensor, most: float) -> _Levels:
        """Levels of a picture (H, W, 3) up to one of which a pixel is `most` pixels wide."""
        layer = torch.cat([radiance * counts[..., None], counts[..., None]], dim=2)
        layers = [layer.permute(2, 0, 1)[None]]
        while 2 ** (len(layers) - 1) < most and min(layers[-1].shape[2:]) > 2:
            layers.append(avg_pool2d(layers[-1], 2, ceil_mode=True, count_include_pad=False))
        return cls(tuple(layers))

    def read(self, place: Tensor, width: Tensor) -> Tensor:
        """Means (M, 4) over squares of some widths (M,), pixels, about places (M, 2)."""
        level = width.clamp(min=1.0).log2().clamp(max=len(self.layers) - 1)
        found = torch.zeros(len(place), 4)
        for number, layer in enumerate(self.layers):
            share = (1.0 - (level - number).abs()).clamp(min=0.0)
            rows = share.nonzero()[:, 0]
            if not len(rows):
                continue
            # a layer's last pixel may stand for less than the others, and they for as much as ever
            size = torch.tensor([layer.shape[3], layer.shape[2]]) * float(2**number)
            at = (2.0 * place[rows] / size - 1.0)[None, None]
            shown = grid_sample(layer, at, padding_mode="border", align_corners=False)
            found[rows] += share[rows, None] * shown[0, :, 0].T
        return found


class _Lens:
    """One photograph, ready to tell detail."""

    def __init__(
        self,
        view: View,
        tracer: EmbreeTracer,
        curve: AbstractToneCurve,
        sharpness: float,
    ) -> None:
        self._view, self._tracer, self._curve = view, tracer, curve
        self._sharpness = sharpness

    @cached_property
    def _depth(self) -> Tensor:
        """(1, 2, h, w) inverse depth, and whether no outline is near, of a small copy."""
        small = resize_view(self._view, _DEPTH_SIDE)
        clean, inverse = clean_pixels(self._tracer, small)
        return torch.from_numpy(np.stack([inverse, clean]).astype(np.float32))[None]

    def _levels(self, most: float) -> _Levels:
        """Radiance and where it can be told: wholly on the object and not clipped."""
        image = torch.from_numpy(self._view.image_display)
        counts = (torch.from_numpy(self._view.mask) > MASK_INSIDE) & (image < 255).all(2)
        radiance = self._curve.linear_from_codes(image, counts)
        return _Levels.of(radiance, counts.float(), most)

    def read(
        self, points: tuple[Floats, Floats], least: Floats, widths: tuple[float, float]
    ) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Texels (M,) that the photograph shows, their weights (M,), and their detail (M, 3).

        Of those, by position and normal (N, 3), whose weight is above a least one (N,) only:
        others cost time and count nothing.
        """
        texel, place, scale, counts = self._shown(*points)
        above = counts > torch.from_numpy(least[texel])
        texel, counts = texel[above.numpy()], counts[above]
        place, scale = place[above], scale[above]
        if not len(texel):
            return texel, np.zeros(0, np.float32), np.zeros((0, 3), np.float32)
        levels = self._levels(widths[1] * float(scale.max()))
        fine, coarse = (levels.read(place, width * scale) for width in widths)
        kept = (fine[:, 3] > 0.99) & (coarse[:, 3] > 0.5)
        logs = [
            (layer[kept, :3] / layer[kept, 3:]).clamp(min=1e-4).log() for layer in (fine, coarse)
        ]
        detail = (logs[0] - logs[1]).clamp(-_MOST_DETAIL, _MOST_DETAIL)
        return texel[kept.numpy()], counts[kept].numpy(), detail.numpy()

    def weights(self, position: Floats, normal: Floats) -> Floats:
        """Weights (N,) of the photograph at points, 0 where it does not show them."""
        weights = np.zeros(len(position), np.float32)
        texel, _, _, counts = self._shown(position, normal)
        weights[texel] = counts.numpy()
        return weights

    def _shown(
        self, position: Floats, normal: Floats
    ) -> tuple[NDArray[np.int64], Tensor, Tensor, Tensor]:
        """Texels the camera sees: numbers, places, pixels per unit of length, and weights."""
        camera = self._view.camera
        towards = camera.position.astype(np.float32) - position
        cosine = np.einsum("nd,nd->n", towards, normal) / np.linalg.norm(towards, axis=1)
        texel = np.flatnonzero(cosine > _LEAST_COSINE)
        pixels, depth = camera.project(position[texel].astype(np.float64))
        kept = camera.in_picture(pixels, depth)
        texel, depth = texel[kept], torch.from_numpy(depth[kept]).float()
        place = torch.from_numpy(pixels[kept]).float()
        size = torch.tensor([camera.width, camera.height])
        seen = grid_sample(
            self._depth, (2.0 * place / size - 1.0)[None, None], align_corners=False
        )[0, :, 0]
        apart = (1.0 / depth - seen[0]).abs() * depth**2
        near = (seen[1] > 0.99) & (apart < _DEPTH_TOLERANCE)
        scale = 0.5 * (camera.fx + camera.fy) / depth[near]
        facing = torch.from_numpy(cosine[texel[near.numpy()]])
        counts = (facing * (scale * self._sharpness) ** 2) ** _STEEPNESS
        return texel[near.numpy()], place[near], scale, counts
