# SPDX-License-Identifier: Apache-2.0
"""Flat parts are found, made flat and sharp; curved ones are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from robir.geometry.lattice import Lattice
from robir.geometry.mesh.facets import find_facets, flattened
from robir.geometry.mesh.isosurface import extract, taubin
from robir.geometry.mesh.triangles import Mesh, face_geometry

TURN = torch.tensor(Rotation.from_euler("xyz", [0.3, 0.5, 0.2]).as_matrix()).float()
LATTICE = Lattice.around(np.full(3, -0.75), np.full(3, 0.75), 64)
POINTS = LATTICE.nodes() @ TURN


def noisy(sdf: torch.Tensor, cells: float) -> Mesh:
    """Surface of a field with Gaussian noise of so many cells, smoothed as the stage does."""
    noise = torch.randn(len(sdf), generator=torch.Generator().manual_seed(0))
    return taubin(extract(LATTICE, sdf + cells * LATTICE.cell * noise), 5)


def box(half: list[float]) -> torch.Tensor:
    """Exact signed distance of a box along the turned axes."""
    outside = POINTS.abs() - torch.tensor(half)
    return outside.clamp(min=0.0).norm(dim=1) + outside.amax(dim=1).clamp(max=0.0)


def slant(mesh: Mesh) -> float:
    """Mean angle, by area, between faces and the nearest of the turned axes, degrees."""
    normals, areas = face_geometry(mesh.vertices.astype(np.float64), mesh.faces)
    nearest = np.abs(normals @ TURN.numpy()).max(axis=1).clip(max=1.0)
    return float((np.degrees(np.arccos(nearest)) * areas).sum() / areas.sum())


def test_a_noisy_box_becomes_flat_and_sharp() -> None:
    half = [0.5, 0.3, 0.4]
    mesh = noisy(box(half), 0.15)
    facets = find_facets(mesh, LATTICE.cell)
    assert len(facets) == 6
    for facet in facets:
        axis = np.abs(facet.normal @ TURN.numpy())
        assert axis.max() > np.cos(np.radians(0.5))
        assert abs(facet.offset - half[int(axis.argmax())]) < 0.1 * LATTICE.cell
    flat, part = flattened(mesh, LATTICE.cell, facets, follows=True)
    assert set(part) - {-1} == set(range(6))
    assert slant(mesh) > 6.0
    assert slant(flat) < 2.0
    reach = np.abs(flat.vertices @ TURN.numpy()).max(axis=0)
    np.testing.assert_allclose(reach, half, atol=0.4 * LATTICE.cell)
    # the edges are there: vertices lie on two planes at once, one to a cell of edge or more
    on_plane = np.abs(np.abs(flat.vertices @ TURN.numpy()) - half) < 0.05 * LATTICE.cell
    assert (on_plane.sum(axis=1) >= 2).sum() > 4 * (1.0 + 0.6 + 0.8) / LATTICE.cell


def test_curved_surfaces_have_no_facets_but_their_flat_ends() -> None:
    ball = POINTS.norm(dim=1) - 0.6
    for cells in (0.0, 0.15):
        assert find_facets(noisy(ball, cells), LATTICE.cell) == []
    radial = POINTS[:, :2].norm(dim=1) - 0.4
    drum = noisy(torch.maximum(radial, POINTS[:, 2].abs() - 0.5), 0.1)
    ends = find_facets(drum, LATTICE.cell)
    assert len(ends) == 2
    for facet in ends:
        assert abs(facet.normal @ TURN.numpy()[:, 2]) > np.cos(np.radians(1.0))


def test_a_shallow_dome_is_not_a_facet() -> None:
    # rises by 0.9 cells over 40: all of it lies within the noise band of a plane
    radius = 0.5 * (20.0**2 / 0.9 + 0.9) * LATTICE.cell
    dome = (POINTS + torch.tensor([0.0, 0.0, radius])).norm(dim=1) - radius
    side = POINTS[:, :2].norm(dim=1) - 20.0 * LATTICE.cell
    mesh = noisy(torch.maximum(torch.maximum(dome, side), -0.4 - POINTS[:, 2]), 0.0)
    up = TURN.numpy()[:, 2]
    assert not any(facet.normal @ up > 0.9 for facet in find_facets(mesh, LATTICE.cell))


def test_without_facets_nothing_moves() -> None:
    ball = noisy(POINTS.norm(dim=1) - 0.6, 0.15)
    flat, part = flattened(ball, LATTICE.cell, [], follows=True)
    assert flat is ball
    assert set(part) == {-1}


def test_what_adjoins_a_flat_part_follows_without_a_step() -> None:
    """A lid raised by a width on a drum: its side is drawn along over two widths."""
    radial = POINTS[:, :2].norm(dim=1) - 0.4
    drum = noisy(torch.maximum(radial, POINTS[:, 2].abs() - 0.5), 0.0)
    lid = max(find_facets(drum, LATTICE.cell), key=lambda facet: facet.offset)
    raised = replace(lid, offset=lid.offset + LATTICE.cell)
    edges = np.concatenate([drum.faces[:, [0, 1]], drum.faces[:, [1, 2]]])

    def steps(*, follows: bool) -> np.ndarray:
        flat = flattened(drum, LATTICE.cell, [raised], follows=follows).mesh
        motion = np.linalg.norm(flat.vertices - drum.vertices, axis=1)
        assert motion.max() > 0.8 * LATTICE.cell
        return np.sort(np.abs(np.diff(motion[edges], axis=1))[:, 0])[::-1]

    followed, alone = steps(follows=True), steps(follows=False)
    # of the edges across the rim
    assert followed[:100].mean() < 0.75 * alone[:100].mean()
