# SPDX-License-Identifier: Apache-2.0
"""A wall below a rim is taken away, and nothing that stands."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
import torch
import trimesh

from robir.geometry import settling
from robir.geometry.config import GeometryConfig
from robir.geometry.ground.backdrop import Backdrop
from robir.geometry.ground.pixel_rays import pixels_of
from robir.geometry.ground.undercut import undercut
from robir.geometry.lattice import Lattice
from robir.geometry.stage import reconstruct
from robir.geometry.stereo.config import StereoConfig
from tests.geometry.scenes import camera_at, capture_of, disc, drum, ground_of

TOP = -0.3
"""Height of the ground's surface."""


def grey_below(points: np.ndarray) -> np.ndarray:
    """Plain ground, darker towards the middle as in shade; red things."""
    shade = np.clip(0.5 + 0.5 * np.hypot(points[:, 0], points[:, 1]) / 0.9, 0.0, 1.0)
    ground = shade[:, None] * np.array([150.0, 155.0, 160.0])
    return np.where(points[:, 2:] > TOP + 0.01, [200.0, 30.0, 20.0], ground)


def solid_box(nodes: np.ndarray, half: float, low: float, high: float) -> np.ndarray:
    """Signed distance, roughly, of an upright cylinder."""
    radius = np.hypot(nodes[:, 0], nodes[:, 1])
    return np.maximum(np.maximum(radius - half, nodes[:, 2] - high), low - nodes[:, 2])


def cut(scene: trimesh.Trimesh, surface: list[tuple[float, float, float]]) -> tuple[Lattice, ...]:
    """The lattice, and values of a made-up surface on a ground before and after the cut.

    Args:
        scene: What the photographs show.
        surface: Half width, lower and upper end of the cylinders that were made of it.
    """
    ground, photos, lattice, hull = ground_of(scene, grey_below)
    nodes = lattice.nodes().double().numpy()
    parts = [solid_box(nodes, 0.9, TOP - 0.1, TOP)]
    parts += [solid_box(nodes, *part) for part in surface]
    before = torch.from_numpy(np.min(parts, axis=0)).float()
    backdrop = Backdrop(ground, photos)
    backdrop.clear(lattice, ground.flatten(lattice, hull, ground.start))
    bare = ground.settled(ground.heights(lattice, before), backdrop.known)
    return lattice, before, undercut(backdrop, bare, lattice, before)  # type: ignore[return-value]


def test_a_wall_below_a_rim_is_freed() -> None:
    plate = [drum(0.12, TOP, TOP + 0.14), drum(0.5, TOP + 0.14, TOP + 0.2)]
    lattice, before, after = cut(
        trimesh.util.concatenate([disc(), *plate]), [(0.5, TOP, TOP + 0.2)]
    )
    nodes = lattice.nodes().numpy()
    radius, height = np.hypot(nodes[:, 0], nodes[:, 1]), nodes[:, 2] - TOP
    wall = (radius > 0.45) & (radius < 0.49) & (height > 0.04) & (height < 0.1)
    assert (before[wall] < 0).all()
    assert (after[wall] > 0).float().mean() > 0.6
    rim = (radius < 0.46) & (np.abs(height - 0.17) < 0.02)
    assert (after[rim] < 0).all()
    below = (radius < 0.8) & (height < -0.02) & (height > -0.08)
    assert (after[below] < 0).all()


def test_a_wall_that_is_there_stays() -> None:
    lattice, _, after = cut(
        trimesh.util.concatenate([disc(), drum(0.5, TOP, TOP + 0.2)]), [(0.5, TOP, TOP + 0.2)]
    )
    nodes = lattice.nodes().numpy()
    radius, height = np.hypot(nodes[:, 0], nodes[:, 1]), nodes[:, 2] - TOP
    wall = (radius < 0.47) & (height > 0.03) & (height < 0.17)
    assert (after[wall] < 0).all()


def test_a_foot_below_a_rim_is_looked_up_in_every_photograph_that_shows_it() -> None:
    camera = camera_at(0.3, 0.15, 96)
    spots = np.column_stack([np.linspace(-0.9, 0.9, 400), np.zeros(400), np.full(400, TOP)])
    pixel = pixels_of(camera, spots)
    # a grazing view shows several spots in a pixel; every spot of the picture has its pixel
    image, _ = camera.project(spots)
    held = ((image > 0) & (image < 96)).all(axis=1)
    assert held.sum() > 300
    np.testing.assert_array_equal(pixel >= 0, held)
    rows, columns = pixel[held] // 96, pixel[held] % 96
    assert np.abs(columns + 0.5 - image[held, 0]).max() <= 0.5
    assert np.abs(rows + 0.5 - image[held, 1]).max() <= 0.5
    coarse = pixels_of(camera, spots, 2)[held]
    assert (coarse // 96 % 2 == 0).all() and (coarse % 2 == 0).all()
    behind = 2.0 * camera.position[None]
    assert pixels_of(camera, behind)[0] == -1


def test_room_is_freed_at_the_end_of_every_level(monkeypatch: pytest.MonkeyPatch) -> None:
    cells: list[float] = []

    def record(
        backdrop: Backdrop, bare: np.ndarray, lattice: Lattice, sdf: torch.Tensor
    ) -> torch.Tensor:
        assert bare.shape == backdrop.ground.columns.shape and bare.any()
        cells.append(lattice.cell)
        return sdf

    monkeypatch.setattr(settling, "undercut", record)
    scene = trimesh.util.concatenate([disc(), drum(0.3, TOP, TOP + 0.2)])
    capture = capture_of(scene, views=24, side=64, low=0.12, paint=grey_below)
    config = GeometryConfig(
        level_cells=(32, 48),
        level_steps=(30, 30),
        rays=512,
        face_budget=800,
        stereo=StereoConfig(image_side=0),  # which would end so short a fit
    )
    reconstruct(capture, config, 0, "cpu", Mock())
    assert len(cells) == 2 and cells[0] > 1.4 * cells[1]
