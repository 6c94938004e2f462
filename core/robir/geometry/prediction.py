# SPDX-License-Identifier: Apache-2.0
"""How well a surface lets photographs predict each other.

A pixel is carried over a surface into the photographs beside it. Where the surface is right they
show the same thing, whatever it is made of; so this judges surfaces that were found in different
ways, without truth, light or material.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import Photo
from robir.maths.vectors import farthest_points

JUDGES = 12
"""Photographs that are predicted; they lie far from each other."""

NEAREST = 4
"""Photographs, the nearest to a judge, that predict it."""

WHOLE = 0.95
"""Coverage from which a pixel is object."""

OUTLINE = 2
"""Pixels from the outline within which masks are not believed."""

SLACK = 0.01
"""Distance, unit frame, by which a ray may end before the surface it is to see."""


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
        self._judges = farthest_points(positions, JUDGES)
        self._nearest = {own: np.argsort(-alike[own])[:NEAREST] for own in self._judges}

    def errors(self, mesh: Mesh) -> list[NDArray[np.float32]]:
        """Squared errors of the judges' pixels, one flat array a judge.

        Args:
            mesh: Surface, unit frame.

        Returns:
            Mean squared display error of every pixel that is wholly object; NaN where the surface
            shows it to no other photograph. Well inside the object, where there is no surface, it
            is that of knowing no more than the object's mean colour.
        """
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        return [self._judged(tracer, own) for own in self._judges]

    def _judged(self, tracer: EmbreeTracer, own: int) -> NDArray[np.float32]:
        """Errors of one judge."""
        camera, layers = self._cameras[own], self._layers[own]
        rows, columns = np.nonzero(layers[..., 3].numpy() > WHOLE)
        origins, directions = camera.rays(np.stack([columns + 0.5, rows + 0.5], axis=1))
        distance = tracer.first_hits(
            origins.astype(np.float32), directions.astype(np.float32)
        ).distance
        met = np.isfinite(distance)
        points = (origins + np.where(met, distance, 0.0)[:, None] * directions)[met]
        total, weight = torch.zeros(len(points), 3), torch.zeros(len(points), 1)
        for other in self._nearest[own]:
            colour, sure = self._shown(tracer, other, points)
            total += sure * colour
            weight += sure
        shown = layers[rows, columns, :3][torch.from_numpy(met)]
        error = ((total / weight.clamp(min=1e-6) - shown) ** 2).mean(1)
        display = layers[rows, columns, :3].numpy()
        inner = _within(layers[..., 3].numpy() > WHOLE)[rows, columns]
        blind = ((display - display.mean(0)) ** 2).mean(1)
        result = np.where(inner, blind, np.nan).astype(np.float32)
        result[met] = torch.where(weight[:, 0] > 0, error, float("nan")).numpy()
        return result

    def _shown(
        self, tracer: EmbreeTracer, other: int, points: NDArray[np.float64]
    ) -> tuple[Tensor, Tensor]:
        """Colours (P, 3) of points in a photograph, and 1 or 0 (P, 1) for whether it shows them."""
        camera, layers = self._cameras[other], self._layers[other]
        away = points - camera.position
        distance = np.linalg.norm(away, axis=1)
        origins = np.broadcast_to(camera.position, away.shape).astype(np.float32)
        reach = (distance - SLACK).astype(np.float32)
        free = ~tracer.is_blocked(origins, (away / distance[:, None]).astype(np.float32), reach)
        values, held = _read(layers, camera, points)
        sure = held & (values[:, 3] > WHOLE) & torch.from_numpy(free)
        return values[:, :3], sure.float()[:, None]


def _within(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels (H, W) of a mask that lie further than OUTLINE from what is not of it."""
    square = np.ones((2 * OUTLINE + 1, 2 * OUTLINE + 1), np.uint8)
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
