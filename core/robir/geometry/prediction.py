# SPDX-License-Identifier: Apache-2.0
"""How well a surface lets photographs predict each other.

A pixel is carried over a surface into the photographs beside it. Where the surface is right they
show the same thing, so this judges surfaces that were found in different ways, without truth, light
or material. What is polished shows each photograph something else: there a map of what is mirrored,
see mirror_map.py, goes along wherever it helps to predict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mirror_map import learnt_map, mirrored_cells, nothing_mirrored
from robir.geometry.rays import Photo
from robir.maths.vectors import farthest_points

_JUDGES = 12  # photographs that are predicted; they lie far from each other
_NEAREST = 4  # photographs, the nearest to a judge, that predict it
_WHOLE = 0.95  # coverage from which a pixel is object
_OUTLINE = 2  # distance from the outline within which masks are not believed (pixels)
_LEARNT_POINTS = 6000  # points of the surface by which what is mirrored is learnt
_SLACK = 0.01  # distance by which a ray may end before the surface it is to see (unit frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spots:
    """Where the pixels of a judge meet a surface.

    Attributes:
        rows: Of the pixels that are wholly object.
        columns: Likewise.
        met: (N,) bool, which of them meet it.
        points: (P, 3) where.
        normals: (P, 3) unit.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    met: NDArray[np.bool_]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class Predictions:
    """Photographs that predict some of their number over surfaces.

    Args:
        photos: Training photographs, unit frame.
    """

    def __init__(self, photos: list[Photo]) -> None:
        positions = np.stack([photo.camera.position for photo in photos])
        towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
        alike = towards @ towards.T
        np.fill_diagonal(alike, -2.0)
        self._cameras = [photo.camera for photo in photos]
        self._layers = [
            torch.from_numpy(np.dstack([photo.premultiplied_display, photo.coverage]))
            for photo in photos
        ]
        self._judges = farthest_points(positions, _JUDGES)
        self._nearest = {own: np.argsort(-alike[own])[:_NEAREST] for own in self._judges}

    def errors(self, mesh: Mesh) -> list[NDArray[np.float32]]:
        """Squared errors of the judges' pixels, one flat array a judge.

        Args:
            mesh: Surface, unit frame.

        Returns:
            Mean squared display error of every pixel that is wholly object; NaN where the surface
            shows it to no other photograph. Well inside the object, where there is no surface, it
            is that of knowing no more than the object's mean colour. What the surface mirrors is
            part of the prediction if it makes it better by more than a standard error.
        """
        carried, told = self._both(mesh)
        return told if lead(carried, told) > 1.0 else carried

    def mirroring(self, mesh: Mesh) -> float:
        """By how many standard errors photographs predict better with what a surface mirrors.

        Args:
            mesh: Surface, unit frame.
        """
        return lead(*self._both(mesh))

    def _both(self, mesh: Mesh) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
        """Errors without and with what the surface mirrors."""
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        spots = {own: self._spots(tracer, mesh, own) for own in self._judges}
        maps = self._maps(tracer, list(spots.values()))
        nothing = nothing_mirrored()
        pairs = [self._judged(tracer, own, spots[own], (nothing, maps[own])) for own in spots]
        return [without for without, _ in pairs], [told for _, told in pairs]

    def _spots(self, tracer: EmbreeTracer, mesh: Mesh, own: int) -> _Spots:
        camera = self._cameras[own]
        rows, columns = np.nonzero(self._layers[own][..., 3].numpy() > _WHOLE)
        origins, directions = camera.rays(np.stack([columns + 0.5, rows + 0.5], axis=1))
        hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        met = np.isfinite(hits.distance)
        corners = mesh.normals[mesh.faces[hits.face[met]]].astype(np.float64)
        normals = (corners * hits.barycentric[met][:, :, None]).sum(1)
        return _Spots(
            rows=rows,
            columns=columns,
            met=met,
            points=origins[met] + hits.distance[met][:, None] * directions[met],
            normals=normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9),
        )

    def _maps(self, tracer: EmbreeTracer, spots: list[_Spots]) -> dict[int, NDArray[np.floating]]:
        """What is mirrored as all photographs but a judge tell it, for each judge."""
        total = sum(len(one.points) for one in spots)
        every = max(1, total // _LEARNT_POINTS)
        points = np.concatenate([one.points for one in spots])[::every]
        normals = np.concatenate([one.normals for one in spots])[::every]
        shown = [self._shown(tracer, other, points, normals) for other in range(len(self._cameras))]
        colours, seen, cells = (np.stack(column, axis=1) for column in zip(*shown, strict=True))
        maps = {}
        for own in self._judges:
            told = seen.copy()
            told[:, own] = 0.0
            maps[own] = learnt_map(colours, told, cells)
        return maps

    def _judged(
        self,
        tracer: EmbreeTracer,
        own: int,
        spots: _Spots,
        maps: tuple[NDArray[np.floating], ...],
    ) -> list[NDArray[np.float32]]:
        """Errors of one judge by what the others show, for each map of what is mirrored."""
        layers = self._layers[own].numpy()
        totals = [np.zeros((len(spots.points), 3)) for _ in maps]
        weight = np.zeros((len(spots.points), 1))
        for other in self._nearest[own]:
            colours, seen, cells = self._shown(tracer, other, spots.points, spots.normals)
            for total, mirrored in zip(totals, maps, strict=True):
                total += seen[:, None] * (colours - mirrored[cells])
            weight += seen[:, None]
        towards = _unit(self._cameras[own].position - spots.points)
        cells = mirrored_cells(spots.normals, towards)
        display = layers[spots.rows, spots.columns, :3]
        inner = _within(layers[..., 3] > _WHOLE, _OUTLINE)
        inner = inner[spots.rows, spots.columns]
        blind = ((display - display.mean(0)) ** 2).mean(1)
        results = []
        for total, mirrored in zip(totals, maps, strict=True):
            predicted = total / np.maximum(weight, 1e-6) + mirrored[cells]
            error = ((predicted - display[spots.met]) ** 2).mean(1)
            result = np.where(inner, blind, np.nan).astype(np.float32)
            result[spots.met] = np.where(weight[:, 0] > 0, error, np.nan)
            results.append(result)
        return results

    def _shown(
        self,
        tracer: EmbreeTracer,
        other: int,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """Colours (P, 3) of points in a photograph, 1 (P,) where it shows them, mirrored cells."""
        camera, layers = self._cameras[other], self._layers[other]
        away = points - camera.position
        distance = np.linalg.norm(away, axis=1)
        origins = np.broadcast_to(camera.position, away.shape).astype(np.float32)
        reach = (distance - _SLACK).astype(np.float32)
        directions = away / distance[:, None]
        free = ~tracer.is_blocked(origins, directions.astype(np.float32), reach)
        values, held = _read(layers, camera, points)
        sure = (held & (values[:, 3] > _WHOLE)).numpy() & free
        cells = mirrored_cells(normals, -directions)
        return values[:, :3].numpy(), sure.astype(np.float32), cells


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _within(inside: NDArray[np.bool_], outline: int) -> NDArray[np.bool_]:
    """The pixels (H, W) of a mask that lie further than `outline` from what is not of it."""
    square = np.ones((2 * outline + 1, 2 * outline + 1), np.uint8)
    return cv2.erode(inside.astype(np.uint8), square, borderValue=1) == 1


def _read(layers: Tensor, camera: Camera, points: NDArray[np.float64]) -> tuple[Tensor, Tensor]:
    """Values (P, C) of a picture where a camera sees points, and whether it holds them (P,)."""
    places, depth = camera.project(points)
    size = np.array([camera.width, camera.height])
    held = (depth > 0) & (places > 0).all(1) & (places < size).all(1)
    grid = torch.from_numpy(places * (2 / size) - 1).float()[None, None]
    values = grid_sample(
        layers.permute(2, 0, 1)[None], grid, padding_mode="border", align_corners=False
    )
    return values[0, :, 0].T, torch.from_numpy(held)


def lead(errors: list[NDArray[np.float32]], others: list[NDArray[np.float32]]) -> float:
    """By how many of its standard errors the second surface predicts better than the first.

    Args:
        errors: Of the first surface, from `Predictions.errors`.
        others: Of the second.

    Returns:
        Mean over the judges of the difference of log mean errors, of pixels that both surfaces
        show, over its standard error; 0 where fewer than two judges can tell.
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
