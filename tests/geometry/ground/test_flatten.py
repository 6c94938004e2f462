# SPDX-License-Identifier: Apache-2.0
"""What stands on the ground, or hangs over it, is not taken for ground."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
import trimesh

from robir.geometry.ground.backdrop import Backdrop
from robir.geometry.ground.plane import commonest
from tests.geometry.scenes import disc, drum, ground_of

TOP = -0.3  # height of the ground's surface

RIM = (0.4, 0.6)  # inner and outer radius of a plate's rim that overhangs the ground


def pale(points: np.ndarray) -> np.ndarray:
    """Ground and things, pale and without texture."""
    return np.where(points[:, 2:] > TOP + 0.01, [205.0, 205.0, 205.0], [160.0, 165.0, 170.0])


def flattened(
    solid: trimesh.Trimesh,
    left_over: trimesh.Trimesh | None = None,
    paint: Callable[[np.ndarray], np.ndarray] = pale,
    dug: trimesh.Trimesh | None = None,
    *,
    below: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The true surface of a solid on the ground, flattened by what the photographs show.

    Args:
        solid: What stands on the ground.
        left_over: What the surface has although it is in no photograph, or None.
        paint: Display colours of points.
        dug: What the surface lacks although it is there, or None.
        below: Whether what hangs over the ground has bumps under it cut.

    Returns:
        Nodes (N, 3) with heights above the ground, values before and values after, (N,).
    """
    scene = trimesh.util.concatenate([disc(), solid])
    ground, photos, lattice, hull = ground_of(scene, paint)
    nodes = lattice.nodes().double().numpy()
    inside = solid.contains(nodes) | (np.hypot(*nodes.T[:2]) < 0.9) & (nodes[:, 2] < TOP)
    if left_over is not None:
        inside |= left_over.contains(nodes)
    if dug is not None:
        inside &= ~dug.contains(nodes)
    before = torch.from_numpy(np.where(inside, -1.0, 1.0) * lattice.cell).float()
    backdrop = Backdrop(ground, photos)
    backdrop.clear(lattice, ground.flatten(lattice, hull, ground.start))
    settled = ground.settled(ground.heights(lattice, before), backdrop.known)
    overhung = ground.overhung(lattice, before, settled) if below else None
    after = ground.flatten(lattice, before, settled, overhung)
    return nodes - [0.0, 0.0, TOP], before.numpy(), after.numpy()


def brown_board(points: np.ndarray) -> np.ndarray:
    """A board of one brown on pale ground."""
    return np.where(points[:, 2:] > TOP + 0.01, [110.0, 70.0, 50.0], [160.0, 165.0, 170.0])


def test_the_border_of_a_brown_board_is_no_ground() -> None:
    nodes, before, after = flattened(drum(0.6, TOP, TOP + 0.06), paint=brown_board)
    radius = np.hypot(nodes[:, 0], nodes[:, 1])
    border = (before < 0) & (radius > 0.5) & (radius < 0.58) & (nodes[:, 2] > 0.02)
    assert border.sum() > 200
    assert (after[border] < 0).mean() > 0.95


def test_lumps_beside_a_rim_are_ground_though_the_rim_hides_their_feet() -> None:
    plate = trimesh.util.concatenate(
        [drum(RIM[0], TOP, TOP + 0.05), drum(RIM[1], TOP + 0.04, TOP + 0.12)]
    )
    lumps = [trimesh.creation.box(extents=(0.14, 0.14, 0.06)) for _ in range(8)]
    for number, lump in enumerate(lumps):
        turn = 2.0 * np.pi * number / len(lumps)
        lump.apply_translation([0.72 * np.cos(turn), 0.72 * np.sin(turn), TOP + 0.03])
    nodes, before, after = flattened(plate, trimesh.util.concatenate(lumps))
    radius = np.hypot(nodes[:, 0], nodes[:, 1])
    lump = (before < 0) & (radius > RIM[1] + 0.03) & (nodes[:, 2] > 0.01)
    assert lump.sum() > 200
    # the borders of pieces stay; asked through the rim, five sixths stayed
    assert (after[lump] > 0).mean() > 0.55
    rim = (before < 0) & (radius < RIM[1] - 0.05) & (nodes[:, 2] > 0.02)
    assert (after[rim] < 0).mean() > 0.95


def test_a_pit_below_a_table_is_filled() -> None:
    table = trimesh.util.concatenate([drum(0.1, TOP, TOP + 0.3), drum(0.5, TOP + 0.29, TOP + 0.4)])
    pit = drum(0.08, TOP - 0.1, TOP + 0.02)
    pit.apply_translation([0.3, 0.0, 0.0])
    nodes, before, after = flattened(table, dug=pit)
    wall = (np.hypot(nodes[:, 0] - 0.3, nodes[:, 1]) < 0.08) & (nodes[:, 2] > -0.04)
    hole = wall & (nodes[:, 2] < -0.005)
    assert hole.sum() >= 8
    assert (before[hole] > 0).all()
    assert (after[hole] < 0).all()


def test_a_bump_below_a_table_is_cut_and_the_table_stays() -> None:
    table = trimesh.util.concatenate([drum(0.1, TOP, TOP + 0.3), drum(0.5, TOP + 0.29, TOP + 0.4)])
    bump = trimesh.creation.box(extents=(0.16, 0.16, 0.08))
    bump.apply_translation([0.3, 0.0, TOP + 0.04])
    nodes, before, after = flattened(table, bump, below=True)
    height, radius = nodes[:, 2], np.hypot(nodes[:, 0], nodes[:, 1])
    raised = (before < 0) & (height > 0.01) & (height < 0.2) & (radius > 0.15)
    assert raised.sum() >= 8
    assert (after[raised] > 0).mean() > 0.9
    stands = (before < 0) & (height > 0.01) & ((radius < 0.08) | (height > 0.29))
    assert (after[stands] < 0).all()


@pytest.mark.parametrize("lower", [0.9, 0.93])
def test_a_thick_ground_is_found_at_its_upper_edge(lower: float) -> None:
    outline = [[0.0, TOP - 0.1], [lower, TOP - 0.1], [0.9, TOP], [0.0, TOP]]
    board = trimesh.creation.revolve(outline, sections=96)
    ground, _, lattice, _ = ground_of(
        trimesh.util.concatenate([board, drum(0.2, TOP - 0.01, TOP + 0.3)]), pale
    )
    height = float(ground.columns.plane.origin @ [0.0, 0.0, 1.0])
    assert height == pytest.approx(TOP, abs=0.4 * lattice.cell)


def test_the_commonest_value_is_the_mean_of_the_densest_window() -> None:
    values = np.array([-3.0, 0.0, 0.1, 2.0, 2.1, 2.2, 5.0])
    assert commonest(values, 0.3) == pytest.approx(2.1)
    assert commonest(values[:0], 0.3) == 0.0


def test_a_bowl_is_no_ground_and_bumps_above_the_plane_are() -> None:
    bowl = trimesh.util.concatenate([disc(), drum(0.1, TOP, TOP + 0.3)])
    ground, _, lattice, _ = ground_of(bowl, pale)
    inside = ground.columns.inside
    few = np.zeros_like(inside)
    few[np.nonzero(inside)[0][0], np.nonzero(inside)[1][0]] = True
    for height, is_flat in ((-np.inf, False), (-2.0, False), (0.0, True), (3.0, True)):
        top = np.where(few, -np.inf, height * lattice.cell)
        assert ground.is_flat(lattice.cell, top, few) == is_flat
