# SPDX-License-Identifier: Apache-2.0
"""How well a surface lets photographs predict each other.

A pixel is carried over a surface into the photographs beside it. Where the surface is right they
show the same thing, so this compares surfaces that were found in different ways, without truth,
light or material.

A polished thing shows every photograph another colour of the same spot, and a surface full of pits
explains that as well as any. But on the surface that is right all spots mirror one surroundings: a
map learnt at some spots, from some photographs, tells what others show. It goes along wherever it
helps to predict.

Batch letters: P points, J photographs, C cells of the map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import sparse
from torch.nn.functional import grid_sample

from robir.capture.images.opencv import cv2
from robir.geometry.mesh.tracer import EmbreeTracer, Hits
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import ReducedPhoto
from robir.maths.vectors import farthest_points
from robir.workers import side_by_side

Array = NDArray[np.floating]

_TARGETS = 12  # photographs that are predicted; they lie far from each other
_NEAREST = 4  # photographs, the nearest to a target, that predict it
_WHOLE = 0.95  # coverage from which a pixel is object
_MOST_PIXELS = 30_000  # of a target that are predicted, in every n-th row and column
_OUTLINE = 2  # distance from the outline within which masks are not believed (pixels)
_LEARNT_POINTS = 3000  # points of the surface by which what is mirrored is learnt
_SLACK = 0.01  # distance by which a ray may end before the surface it is to see (unit frame)

# cells along each side of the map; 24 are 8 degrees wide in the middle, as fine as normals are
# known
_SIDE = 24
# cosine of the view below which a normal a few degrees off mirrors quite another direction
_GRAZING = 0.15
_HELD = 20.0  # observations by which a cell is held to mirror nothing
_ROUNDS = 6  # turns of solving spots and map after each other
_LEAST_VIEWS = 3  # photographs that must show a spot from which the map is learnt
_LEAST_VIEWS_OF_SPREAD = 4  # photographs that must show a vertex before their differences count


class _Seen(NamedTuple):
    """What the pixels of a target photograph see."""

    pixels: tuple[NDArray[np.int64], ...]  # rows and columns (N,) of those that are wholly object
    rays: tuple[NDArray[np.float64], NDArray[np.float64]]  # origins and directions (N, 3)
    hits: Hits  # where these first meet a surface


class _Spots(NamedTuple):
    """Where the pixels of a target photograph meet a surface."""

    pixels: tuple[NDArray[np.int64], ...]  # rows and columns (N,) of those that are wholly object
    met: NDArray[np.bool_]  # (N,) which of them meet it
    points: NDArray[np.float64]  # (P, 3) where
    normals: NDArray[np.float64]  # (P, 3) unit


class Predictions:
    """Training photographs, unit frame, some of which the others predict over surfaces."""

    def __init__(self, photos: list[ReducedPhoto]) -> None:
        positions = np.stack([photo.camera.position for photo in photos])
        towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
        alike = towards @ towards.T
        np.fill_diagonal(alike, -2.0)
        self._cameras = [photo.camera for photo in photos]
        self._layers = [torch.from_numpy(photo.layers) for photo in photos]
        self._targets = farthest_points(positions, _TARGETS)
        self._nearest = {own: np.argsort(-alike[own])[:_NEAREST] for own in self._targets}

    def errors(self, mesh: Mesh) -> list[NDArray[np.float32]]:
        """Squared display errors of the target photographs' pixels, one flat array each.

        NaN where the surface shows a pixel to no other photograph. Well inside the object, where
        there is no surface, it is that of the object's mean colour. What the surface mirrors is
        part of the prediction if it makes it better by more than a standard error.
        """
        carried, told = self._both(mesh)
        return told if lead(carried, told) > 1.0 else carried

    def leads(self, meshes: tuple[Mesh, Mesh], part: NDArray[np.int64]) -> list[float]:
        """By how many standard errors photographs predict better over parts of a second mesh.

        `part` (Nf,) are the parts, from 0 on, of the faces that both have; -1 for none.
        """
        before, after = (self.errors(mesh) for mesh in meshes)
        tracer = EmbreeTracer(meshes[0].vertices, meshes[0].faces)

        def parts_of(own: int) -> NDArray[np.int64]:
            hits = self._seen(tracer, own).hits
            return np.where(np.isfinite(hits.distance), part[hits.face], -1)

        parts = side_by_side(parts_of, self._targets)

        def of_part(errors: list[NDArray[np.float32]], number: int) -> list[NDArray[np.float32]]:
            pairs = zip(errors, parts, strict=True)
            return [np.where(at == number, error, np.float32(np.nan)) for error, at in pairs]

        numbers = range(part.max(initial=-1) + 1)
        return [lead(of_part(before, number), of_part(after, number)) for number in numbers]

    def mirroring(self, mesh: Mesh) -> float:
        """By how many standard errors photographs predict better with what a surface mirrors."""
        return lead(*self._both(mesh))

    def spread(
        self, meshes: tuple[Mesh, Mesh], rows: NDArray[np.int64]
    ) -> tuple[float, float] | None:
        """How far photographs differ about vertices (N,) of two meshes with the same faces.

        The median difference from the median over the photographs that show a vertex on both,
        display units, in the mean over the vertices; None where too few show any.
        """
        shown = []
        for mesh in meshes:
            tracer = EmbreeTracer(mesh.vertices, mesh.faces)
            points = mesh.vertices[rows].astype(np.float64)
            normals = mesh.normals[rows].astype(np.float64)
            parts = side_by_side(
                lambda other, at=(points, normals), tracer=tracer: self._shown(tracer, other, *at),
                range(len(self._cameras)),
            )
            colours, seen, cells = (np.stack(x, axis=1) for x in zip(*parts, strict=True))
            shown.append((colours, (seen > 0) & (cells < _SIDE * _SIDE)))  # not along the surface
        (first, on_first), (second, on_second) = shown
        both = on_first & on_second
        known = both.sum(1) >= _LEAST_VIEWS_OF_SPREAD
        if not known.any():
            return None
        before, after = (
            np.where(both[..., None], colours, np.nan)[known] for colours in (first, second)
        )
        return _spread(before), _spread(after)

    def _both(self, mesh: Mesh) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
        """Errors without and with what the surface mirrors."""
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        found = side_by_side(lambda own: self._spots(tracer, mesh, own), self._targets)
        spots = dict(zip(self._targets, found, strict=True))
        maps = self._maps(tracer, list(spots.values()))
        nothing = np.zeros((_SIDE * _SIDE + 1, 3))
        pairs = side_by_side(
            lambda own: self._errors_of(tracer, own, spots[own], (nothing, maps[own])), spots
        )
        return [without for without, _ in pairs], [told for _, told in pairs]

    def _seen(self, tracer: EmbreeTracer, own: int) -> _Seen:
        """What a target sees at its pixels that are predicted."""
        whole = self._layers[own][..., 3].numpy() > _WHOLE
        every = int(np.ceil(np.sqrt(whole.sum() / _MOST_PIXELS)))
        rows, columns = (every * place for place in np.nonzero(whole[::every, ::every]))
        rays = self._cameras[own].rays(np.stack([columns + 0.5, rows + 0.5], axis=1))
        return _Seen(
            (rows, columns), rays, tracer.first_hits(*(r.astype(np.float32) for r in rays))
        )

    def _spots(self, tracer: EmbreeTracer, mesh: Mesh, own: int) -> _Spots:
        pixels, (origins, directions), hits = self._seen(tracer, own)
        met = np.isfinite(hits.distance)
        corners = mesh.normals[mesh.faces[hits.face[met]]].astype(np.float64)
        normals = (corners * hits.barycentric[met][:, :, None]).sum(1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        points = origins[met] + hits.distance[met][:, None] * directions[met]
        return _Spots(pixels, met, points, normals)

    def _maps(self, tracer: EmbreeTracer, spots: list[_Spots]) -> dict[int, Array]:
        """What is mirrored as all photographs but a target show it, for each target."""
        total = sum(len(one.points) for one in spots)
        every = max(1, total // _LEARNT_POINTS)
        points = np.concatenate([one.points for one in spots])[::every]
        normals = np.concatenate([one.normals for one in spots])[::every]
        shown = side_by_side(
            lambda other: self._shown(tracer, other, points, normals), range(len(self._cameras))
        )
        colours, seen, cells = (np.stack(column, axis=1) for column in zip(*shown, strict=True))

        def learnt(own: int) -> Array:
            told = seen.copy()
            told[:, own] = 0.0
            return learnt_map(colours, told, cells)

        return dict(zip(self._targets, side_by_side(learnt, self._targets), strict=True))

    def _errors_of(
        self, tracer: EmbreeTracer, own: int, spots: _Spots, maps: tuple[Array, ...]
    ) -> list[NDArray[np.float32]]:
        """Errors of one target by what the others show, for each map of what is mirrored."""
        layers = self._layers[own].numpy()
        totals = [np.zeros((len(spots.points), 3)) for _ in maps]
        weight = np.zeros((len(spots.points), 1))
        for other in self._nearest[own]:
            colours, seen, cells = self._shown(tracer, other, spots.points, spots.normals)
            for total, mirrored in zip(totals, maps, strict=True):
                total += seen[:, None] * (colours - mirrored[cells])
            weight += seen[:, None]
        towards = self._cameras[own].position - spots.points
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cells = mirrored_cells(spots.normals, towards)
        display = layers[spots.pixels][:, :3]
        square, whole = np.ones((2 * _OUTLINE + 1,) * 2, np.uint8), layers[..., 3] > _WHOLE
        inner = cv2.erode(whole.astype(np.uint8), square, borderValue=1)[spots.pixels]
        blind = ((display - display.mean(0)) ** 2).mean(1)
        results = []
        for total, mirrored in zip(totals, maps, strict=True):
            predicted = total / np.maximum(weight, 1e-6) + mirrored[cells]
            error = ((predicted - display[spots.met]) ** 2).mean(1)
            result = np.where(inner == 1, blind, np.nan).astype(np.float32)
            result[spots.met] = np.where(weight[:, 0] > 0, error, np.nan)
            results.append(result)
        return results

    def _shown(
        self, tracer: EmbreeTracer, other: int, points: Array, normals: Array
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """Colours (P, 3) of points in a photograph, 1 (P,) where it shows them, mirrored cells."""
        camera, layers = self._cameras[other], self._layers[other]
        away = points - camera.position
        distance = np.linalg.norm(away, axis=1)
        origins = np.broadcast_to(camera.position, away.shape).astype(np.float32)
        reach = (distance - _SLACK).astype(np.float32)
        directions = away / distance[:, None]
        free = ~tracer.is_blocked(origins, directions.astype(np.float32), reach)
        places, depth = camera.project(points)
        size = np.array([camera.width, camera.height])
        held = (depth > 0) & (places > 0).all(1) & (places < size).all(1)
        grid = torch.from_numpy(places * (2 / size) - 1).float()[None, None]
        planes = layers.permute(2, 0, 1)[None]
        shown = grid_sample(planes, grid, padding_mode="border", align_corners=False)[0, :, 0]
        colours, coverage = shown[:3].T.numpy(), shown[3].numpy()
        seen = (held & free & (coverage > _WHOLE)).astype(np.float32)
        return colours, seen, mirrored_cells(normals, -directions)


def _spread(colours: Array) -> float:
    """Mean over points of the median difference from the median of colours (P, J, 3) with NaN."""
    apart = np.abs(colours - np.nanmedian(colours, axis=1, keepdims=True)).mean(2)
    return float(np.nanmedian(apart, axis=1).mean())


def lead(errors: list[NDArray[np.float32]], others: list[NDArray[np.float32]]) -> float:
    """By how many of its standard errors the second surface predicts better than the first.

    Mean over the target photographs of the difference of log mean errors, of pixels that both
    surfaces show; 0 where fewer than two can tell.
    """
    leads = []
    for first, second in zip(errors, others, strict=True):
        both = np.isfinite(first) & np.isfinite(second)
        if both.any():
            leads.append(np.log(first[both].mean() + 1e-8) - np.log(second[both].mean() + 1e-8))
    if len(leads) < 2:
        return 0.0
    spread = float(np.std(leads, ddof=1)) / len(leads) ** 0.5
    return float(np.mean(leads)) / max(spread, 1e-6)


def mirrored_cells(normals: Array, towards: Array) -> NDArray[np.int64]:
    """Cells (P,) of the directions that points mirror, by an octahedral map.

    Of unit normals and directions towards the camera (P, 3); the number of cells where it looks
    along the surface or from behind (Meyer et al. 2010, "On floating-point normal vectors").
    """
    cosine = (normals * towards).sum(1, keepdims=True)
    mirrored = 2.0 * cosine * normals - towards
    flat = mirrored / np.maximum(np.abs(mirrored).sum(1, keepdims=True), 1e-9)
    x, y, z = flat.T
    signs = np.where(flat[:, :2] >= 0, 1.0, -1.0)
    folded = (1.0 - np.abs(flat[:, 1::-1])) * signs
    place = np.where((z < 0)[:, None], folded, np.stack([x, y], axis=1))
    row, column = np.clip(((place + 1.0) * (_SIDE / 2)).astype(np.int64), 0, _SIDE - 1).T
    return np.where(cosine[:, 0] > _GRAZING, row * _SIDE + column, _SIDE * _SIDE)


def learnt_map(colours: Array, seen: Array, cells: NDArray[np.int64]) -> Array:
    """What each direction adds to a spot's own colour, by alternating least squares.

    Of display colours (P, J, 3), seen (P, J) 0 or 1, and cells (P, J): a map (C + 1, 3), about 0.
    """
    known, number = seen.sum(1) >= _LEAST_VIEWS, _SIDE * _SIDE
    seen, cells = seen[known].astype(np.float64), cells[known]
    shown = colours[known] * seen[:, :, None]
    point, photograph = np.nonzero(seen)
    place = point, cells[point, photograph]
    # (P, C + 1): how often a point mirrors a cell
    mirrors = sparse.csr_array((np.ones(len(point)), place), shape=(len(seen), number + 1))
    by_point, views = shown.sum(1), seen.sum(1)[:, None]
    by_cell = np.stack(
        [np.bincount(place[1], part, number + 1) for part in shown[point, photograph].T], axis=1
    )
    count = mirrors.sum(0)[:, None]
    result = np.zeros((number + 1, 3))
    for _ in range(_ROUNDS):
        own = (by_point - mirrors @ result) / views
        result = (by_cell - mirrors.T @ own) / (count + _HELD)
        result[number] = 0.0
    return result
