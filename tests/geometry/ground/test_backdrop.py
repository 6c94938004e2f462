# SPDX-License-Identifier: Apache-2.0
"""Room in front of the ground, freed below an overhang and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.geometry.ground.backdrop import (
    Backdrop,
    pixel_noise,
)
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import detect
from robir.geometry.hull import carve, hull_of
from robir.geometry.lattice import Lattice
from robir.geometry.rays import ReducedPhoto, reduce_view
from tests.geometry.scenes import capture_of, checker, disc

TOP = -0.3  # height of the ground's surface


def table() -> trimesh.Trimesh:
    """A round table on the ground: a thin foot below a wide top."""
    foot = trimesh.creation.cylinder(0.06, 0.2)
    foot.apply_translation([0.0, 0.0, TOP + 0.1])
    board = trimesh.creation.cylinder(0.3, 0.06)
    board.apply_translation([0.0, 0.0, TOP + 0.23])
    return trimesh.util.concatenate([disc(), foot, board])


def red_above(points: np.ndarray) -> np.ndarray:
    """Checkered ground, red things."""
    return np.where(points[:, 2:] > TOP + 0.01, [200.0, 30.0, 20.0], checker(points))


def started(solid: trimesh.Trimesh, **options: object) -> tuple[Lattice, np.ndarray, np.ndarray]:
    """Lattice, its nodes and the values with and without the room in front of the ground."""
    capture = capture_of(solid, views=32, side=96, **options)  # type: ignore[arg-type]
    photos: list[ReducedPhoto] = [reduce_view(view, 96) for view in capture.views]
    lattice, hull = carve(hull_of(photos), 48)
    plane = detect(photos, lattice, hull, torch.Generator().manual_seed(0))
    assert plane is not None
    ground = Ground(plane, photos, lattice, hull)
    backdrop = Backdrop(ground, photos)
    flat = ground.flatten(lattice, hull, ground.start & ~backdrop.foreign)
    return lattice, flat.numpy(), backdrop.clear(lattice, flat).numpy()


def test_room_below_a_table_is_freed_and_the_table_stays() -> None:
    lattice, flat, free = started(table(), paint=red_above)
    nodes = lattice.nodes().numpy()
    radius, height = np.hypot(nodes[:, 0], nodes[:, 1]), nodes[:, 2] - TOP
    below = (radius > 0.15) & (radius < 0.27) & (height > 0.05) & (height < 0.15)
    assert (flat[below] < 0).mean() > 0.9
    assert (free[below] < 0).mean() < 0.2
    board = (radius < 0.27) & (np.abs(height - 0.23) < 0.02)
    assert (free[board] < 0).all()
    foot = (radius < 0.04) & (height > 0.0) & (height < 0.2)
    assert (free[foot] < 0).all()
    under = (radius < 0.4) & (height < -0.01) & (height > -0.03)
    assert (free[under] < 0).all()


def test_what_has_the_colours_of_the_ground_is_not_cut_away() -> None:
    box = trimesh.creation.box(extents=(0.3, 0.25, 0.3))
    box.apply_translation([0.0, 0.0, TOP + 0.15])
    lattice, _, free = started(trimesh.util.concatenate([disc(), box]))
    nodes = lattice.nodes().numpy()
    solid = (np.abs(nodes[:, 0]) < 0.13) & (np.abs(nodes[:, 1]) < 0.1)
    solid &= (nodes[:, 2] > TOP) & (nodes[:, 2] < TOP + 0.27)
    # the same two colours all over: the fit must find a core that it can bring the rest back to
    assert (free[solid] < 0).mean() > 0.4


NOISE = 0.03  # standard deviation of the noise in the tests, display


def noisy(photo: ReducedPhoto, rng: np.random.Generator) -> ReducedPhoto:
    """The photograph with noise wherever it shows something."""
    grain = NOISE * rng.standard_normal(photo.premultiplied_display.shape)
    display = photo.premultiplied_display + grain * (photo.coverage[..., None] > 0)
    return replace(photo, layers=np.dstack([display.clip(0, 1), photo.coverage]).astype(np.float32))


def small_photo(display: NDArray[np.floating]) -> ReducedPhoto:
    """A photograph that shows something everywhere."""
    height, width = display.shape[:2]
    camera = Camera(
        width=width, height=height, fx=1.0, fy=1.0, cx=0.0, cy=0.0, camera_to_world=np.eye(4)
    )
    layers = np.dstack([display, np.ones((height, width))]).astype(np.float32)
    return ReducedPhoto(camera=camera, layers=layers)


def test_noise_is_measured_whatever_the_shades_and_most_of_the_texture() -> None:
    across = np.linspace(0.0, 1.0, 120)
    shades = 0.5 + 0.3 * np.sin(4.0 * across[:, None] + 3.0 * across)[..., None] * [1.0, 0.5, -1.0]
    picture = shades.copy()
    picture[:, :60] += 0.15 * (-1.0) ** np.arange(60)[:, None]  # a half with stripes
    picture[:50, 60:] += 0.1 * np.random.default_rng(2).choice([-1.0, 1.0], (50, 60, 3))
    assert pixel_noise([small_photo(picture)]) < 0.002
    rng = np.random.default_rng(3)
    spoilt = [noisy(small_photo(shades), rng) for _ in range(2)]
    assert pixel_noise(spoilt) == pytest.approx(NOISE, rel=0.05)
    assert pixel_noise([noisy(small_photo(picture), rng)]) == pytest.approx(NOISE, rel=0.3)
