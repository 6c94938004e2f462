# SPDX-License-Identifier: Apache-2.0
"""A mat on the ground lies where the photographs agree, not in the ground's plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
import trimesh

from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.terraces import terraces
from robir.geometry.lattice import Lattice
from robir.geometry.rays import Photo
from tests.geometry.scenes import disc, ground_of

TOP = -0.3
"""Height of the ground's surface."""

MAT = 0.55
"""Radius of the mat."""

HEIGHT = 0.02
"""Of the mat, above the ground: half of a step between columns here."""


def striped(points: np.ndarray) -> np.ndarray:
    """A pale blue ground, a tan mat; stripes of a darker shade, as of shadows, on both."""
    on_mat = np.hypot(points[:, 0], points[:, 1])[:, None] < MAT + 0.001
    dark = np.floor((points[:, 0] + 0.4 * points[:, 1]) * 4.0) % 2 > 0.5
    return np.where(on_mat, [200.0, 160.0, 90.0], [170.0, 180.0, 200.0]) * np.where(
        dark[:, None], 0.6, 1.0
    )


def plain(points: np.ndarray) -> np.ndarray:
    """The same without stripes."""
    on_mat = np.hypot(points[:, 0], points[:, 1])[:, None] < MAT + 0.001
    return np.where(on_mat, [200.0, 160.0, 90.0], [170.0, 180.0, 200.0])


@dataclass
class Swept:
    """A ground with a mat on it, as the geometry stage sees it before the fit.

    Attributes:
        ground: The ground.
        radius: Distance of its columns from the middle, the columns' shape.
        tops: Heights of its bare surface, in the plane, the columns' shape.
        photos: Photographs.
        lattice: Lattice of the visual hull.
        hull: (N,) signed distances of the hull.
    """

    ground: Ground
    radius: np.ndarray
    tops: np.ndarray
    photos: list[Photo]
    lattice: Lattice
    hull: torch.Tensor


def swept(height: float, paint: Callable[[np.ndarray], np.ndarray]) -> Swept:
    """Ground with a mat of some height on it, all of it taken for bare."""
    mat = trimesh.creation.cylinder(MAT, 0.03 + height, sections=96)
    mat.apply_translation([0.0, 0.0, TOP + 0.5 * (height - 0.03)])
    scene = trimesh.util.concatenate([disc(), mat])
    ground, photos, lattice, hull = ground_of(scene, paint)
    columns = ground.columns
    feet = columns.plane.world(np.column_stack([columns.feet, np.zeros(len(columns.feet))]))
    return Swept(
        ground=ground,
        radius=np.hypot(feet[:, 0], feet[:, 1]).reshape(columns.shape),
        tops=np.where(columns.inside, 0.0, -np.inf),
        photos=photos,
        lattice=lattice,
        hull=hull,
    )


@pytest.mark.parametrize(("paint", "error"), [(striped, 0.15), (plain, 0.7)])
def test_a_mat_is_found_at_its_height(
    paint: Callable[[np.ndarray], np.ndarray], error: float
) -> None:
    # of a plain one the border alone tells, whose columns are mixed with those of the ground
    seen = swept(HEIGHT, paint)
    columns = seen.ground.columns
    level = terraces(columns, columns.inside, seen.tops, seen.photos)
    on_mat = columns.inside & (seen.radius < MAT - 0.06)
    beside = columns.inside & (seen.radius > MAT + 0.06)
    assert np.abs(level[on_mat] - HEIGHT).mean() < error * HEIGHT
    assert np.abs(level[beside]).max() == 0.0


@pytest.mark.parametrize("paint", [striped, plain])
def test_a_flat_ground_stays_flat(paint: Callable[[np.ndarray], np.ndarray]) -> None:
    seen = swept(0.0, paint)
    columns = seen.ground.columns
    assert not terraces(columns, columns.inside, seen.tops, seen.photos).any()


def test_no_ground_has_no_terraces() -> None:
    seen = swept(0.0, striped)
    nothing = np.zeros_like(seen.ground.columns.inside)
    assert not terraces(seen.ground.columns, nothing, seen.tops, seen.photos).any()


def test_ground_is_flattened_to_its_terraces() -> None:
    seen = swept(HEIGHT, striped)
    ground, inside = seen.ground, seen.ground.columns.inside
    ground.find_terraces(seen.tops, inside)
    top = ground.heights(seen.lattice, ground.flatten(seen.lattice, seen.hull, inside))
    on_mat, beside = inside & (seen.radius < MAT - 0.1), inside & (seen.radius > MAT + 0.1)
    assert np.median(top[on_mat]) == pytest.approx(HEIGHT, abs=0.004)
    assert np.median(top[beside & (seen.radius < 0.8)]) == pytest.approx(0.0, abs=0.004)


def test_height_is_that_above_the_terrace() -> None:
    seen = swept(HEIGHT, striped)
    seen.ground.find_terraces(seen.tops, seen.ground.columns.inside)
    height = seen.ground.above(np.array([[0.0, 0.0, TOP + 0.1], [0.75, 0.0, TOP + 0.1]]))
    assert height == pytest.approx([0.1 - HEIGHT, 0.1], abs=0.005)
