# SPDX-License-Identifier: Apache-2.0
"""Spots of a ball that mirror a known surroundings, and photographs that predict over it."""

from __future__ import annotations

import numpy as np
import pytest
from geometry.scenes import ball, capture_of
from geometry.test_refine import RADIUS, SIDE, sphere

from robir.geometry import prediction
from robir.geometry.prediction import Predictions, lead, learnt_map, mirrored_cells
from robir.geometry.rays import reduce_view

CELLS = prediction._SIDE**2


def directions(count: int, seed: int = 0) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def about(away: np.ndarray) -> np.ndarray:
    """A surroundings with a bright side, (..., 3)."""
    light = np.exp(4.0 * (away @ np.array([0.6, 0.0, 0.8]) - 1.0))
    return light[..., None] * np.array([0.5, 0.4, 0.2])


def test_cells_part_the_sphere_into_pieces_of_like_directions():
    normals = directions(200_000)
    cells = mirrored_cells(normals, normals)
    assert cells.max() < CELLS
    share = np.bincount(cells, minlength=CELLS) / len(cells)
    assert share.min() > 0 and share.max() * CELLS < 2.5
    # straight on, what is mirrored is the normal: a cell's directions lie together
    means = np.stack([np.bincount(cells, part, CELLS) for part in normals.T], axis=1)
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    assert np.degrees(np.arccos((means[cells] * normals).sum(1).clip(-1, 1))).max() < 10


def test_what_is_mirrored_is_the_reflection():
    normals, towards = directions(500), directions(500, 1)
    towards *= np.sign((normals * towards).sum(1, keepdims=True))
    # Householder: the plane's reflection, turned round
    mirrored = [
        -(np.eye(3) - 2 * np.outer(n, n)) @ t for n, t in zip(normals, towards, strict=True)
    ]
    wanted = mirrored_cells(np.array(mirrored), np.array(mirrored))
    cells = mirrored_cells(normals, towards)
    grazing = (normals * towards).sum(1) <= prediction._GRAZING
    np.testing.assert_array_equal(cells[~grazing], wanted[~grazing])
    assert grazing.any() and (cells[grazing] == CELLS).all()


def test_the_map_is_learnt_beside_the_spots_own_colours():
    rng = np.random.default_rng(0)
    normals, eyes = directions(4000), 3.0 * directions(20, 1)
    towards = eyes[None] - normals[:, None]
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    cosine = (towards * normals[:, None]).sum(2)
    mirrored = 2 * cosine[..., None] * normals[:, None] - towards
    own = rng.uniform(0.1, 0.5, (4000, 1, 3))
    colours = own + about(mirrored)
    cells = mirrored_cells(
        np.broadcast_to(normals[:, None], towards.shape).reshape(-1, 3),
        towards.reshape(-1, 3),
    ).reshape(cosine.shape)
    found = learnt_map(colours, (cosine > 0).astype(float), cells)
    assert found.shape == (CELLS + 1, 3) and (found[CELLS] == 0).all()
    test = directions(3000, 2)
    wanted, told = about(test), found[mirrored_cells(test, test)]
    # a constant goes over from the map to the spots
    apart = told - wanted - (told - wanted).mean(0)
    # held to nothing where little is seen, so it is flatter than the truth
    assert np.sqrt((apart**2).mean()) < 0.5 * np.sqrt(((wanted - wanted.mean(0)) ** 2).mean())
    assert np.corrcoef(told[:, 0], wanted[:, 0])[0, 1] > 0.95


def polished(points: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    cosine = (normals * towards).sum(1, keepdims=True)
    return 0.1 + 1.5 * about(2 * cosine * normals - towards)


@pytest.fixture(scope="module")
def predictions():
    """Of photographs of a ball that mirrors its surroundings."""
    capture = capture_of(ball(RADIUS, (0, 0, 0)), views=24, side=SIDE)
    photos = [reduce_view(view, SIDE) for view in capture.train]
    for photo in photos:
        inside = photo.coverage > 0
        pixels = np.argwhere(inside)[:, ::-1] + 0.5
        origins, rays = photo.camera.rays(pixels)
        near = -(origins * rays).sum(1) - np.sqrt(
            np.maximum((origins * rays).sum(1) ** 2 - (origins**2).sum(1) + RADIUS**2, 0.0)
        )
        points = origins + near[:, None] * rays
        normals = points / np.linalg.norm(points, axis=1, keepdims=True)
        photo.premultiplied_display[inside] = (
            polished(points, normals, -rays) * photo.coverage[inside, None]
        )
    return Predictions(photos)


def test_photographs_of_a_mirror_prefer_the_smooth_surface(predictions):
    assert predictions.mirroring(sphere()) > 3
    smooth, dented = (predictions.errors(sphere(dents=dents)) for dents in (0.0, 0.04))
    assert lead(dented, smooth) > 2


def test_of_paint_nothing_mirrored_is_proven():
    capture = capture_of(ball(RADIUS, (0, 0, 0)), views=16, side=SIDE)
    photos = [reduce_view(view, SIDE) for view in capture.train]
    assert Predictions(photos).mirroring(sphere()) < 1
