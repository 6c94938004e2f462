# SPDX-License-Identifier: Apache-2.0
"""Meshes handed in with photographs of a known shape: taken, turned, placed, or refused."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from geometry.scenes import capture_of, checker
from scipy.spatial.transform import Rotation

from robir.capture.capture import Bounds, Finding
from robir.errors import CaptureError
from robir.geometry.config import GeometryConfig
from robir.geometry.given.placing import better_place, covering
from robir.geometry.given.surface import Handed, hand_in
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import LIGHT, mesh_for_light
from robir.maths.similarity import AS_IT_IS


class Quiet:
    """A reporter that nobody listens to."""

    def progress(self, fraction, message):
        assert 0.0 <= fraction <= 1.0

    def warn(self, message):
        raise AssertionError(message)

    def metric(self, name, value):
        raise AssertionError(name)


def statue() -> trimesh.Trimesh:
    """A shape that looks alike from no two sides, and whose mirror image is another."""
    parts = []
    for size, place in (
        ((0.9, 0.5, 0.2), (0.0, 0.0, -0.4)),
        ((0.2, 0.3, 0.8), (-0.3, 0.05, 0.0)),
        ((0.7, 0.15, 0.15), (0.1, 0.2, 0.3)),
        ((0.15, 0.5, 0.15), (0.4, -0.1, -0.2)),
    ):
        part = trimesh.creation.box(size)
        part.apply_translation(place)
        parts.append(part.subdivide())
    return trimesh.util.concatenate(parts)


def paint(points: np.ndarray) -> np.ndarray:
    """Cubes of paint, in none of whose sides a side of the statue lies."""
    return checker(points + 0.037)


CENTRE, RADIUS = np.array([3.0, -1.0, 2.0]), 2.5


@pytest.fixture(scope="module")
def capture():
    """In a frame of its own: the unit frame scaled and shifted."""
    unit = capture_of(statue(), views=14, side=96, low=-0.6, paint=paint)
    views = []
    for view in unit.views:
        pose = view.camera.camera_to_world.copy()
        pose[:3, 3] = pose[:3, 3] * RADIUS + CENTRE
        views.append(replace(view, camera=replace(view.camera, camera_to_world=pose)))
    bounds = Bounds(centre=CENTRE, radius=RADIUS, origin="made")
    return replace(unit, views=tuple(views), bounds=bounds)


def placed(solid: trimesh.Trimesh) -> trimesh.Trimesh:
    """A shape of the unit frame in the capture's."""
    moved = solid.copy()
    moved.apply_scale(RADIUS)
    moved.apply_translation(CENTRE)
    return moved


def hand(capture, solid: trimesh.Trimesh, folder: Path, **changes) -> Handed:
    path = folder / "scan.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(solid))
    config = GeometryConfig(**changes)
    captures = (capture, capture.normalised())
    return hand_in(path, captures, config, folder / "mesh_fit.png", Quiet())


def test_a_mesh_in_its_place_is_taken_as_it_is(capture, tmp_path):
    handed = hand(capture, placed(statue()), tmp_path)
    assert handed.light is None
    assert handed.views is None
    assert handed.metrics["outline_agreement"] > 0.97
    true = statue().triangles
    assert handed.mesh.vertices[handed.mesh.faces] == pytest.approx(true, abs=1e-5)
    assert handed.mesh.is_unwrapped
    (note,) = handed.notes
    assert "new texture coordinates: it has none" in note
    assert not (tmp_path / "mesh_fit.png").exists()


def test_what_is_inside_out_is_turned_part_by_part(capture, tmp_path):
    solid = statue()
    first = len(trimesh.creation.box().subdivide().faces)
    solid.faces[:first] = solid.faces[:first, ::-1]
    handed = hand(capture, placed(solid), tmp_path)
    share = "25% of the mesh's faces showed their back"
    assert any(share in note for note in handed.notes)
    mesh = handed.mesh
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(statue().volume)


MISPLACED = {
    "another frame": np.block(
        [
            [7e7 * Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([[4], [5], [-9]])],
            [np.zeros((1, 3)), 1],
        ]
    ),
    "shifted a little": np.array([[1.0, 0, 0, 0.4], [0, 1, 0, 0], [0, 0, 1, -0.3], [0, 0, 0, 1]]),
}


@pytest.mark.slow
@pytest.mark.parametrize("how", MISPLACED)
def test_a_misplaced_mesh_is_told_how_it_would_fit_and_brought_there(capture, tmp_path, how):
    solid = placed(statue())
    solid.apply_transform(MISPLACED[how])
    with pytest.raises(CaptureError, match=r"does not fit the photographs.*--fit-mesh"):
        hand(capture, solid, tmp_path)
    assert (tmp_path / "mesh_fit.png").stat().st_size > 1000
    handed = hand(capture, solid, tmp_path, fit_mesh=True)
    apart = handed.mesh.vertices[handed.mesh.faces] - statue().triangles
    assert np.linalg.norm(apart, axis=-1).max() < 0.02
    assert any("was turned by" in note for note in handed.notes)


@pytest.mark.slow
def test_the_least_size_takes_nothing_from_finding_the_place(capture, tmp_path):
    solid = placed(statue())
    solid.apply_scale(1e-12)
    handed = hand(capture, solid, tmp_path, fit_mesh=True)
    apart = handed.mesh.vertices[handed.mesh.faces] - statue().triangles
    assert np.linalg.norm(apart, axis=-1).max() < 0.02


@pytest.mark.slow
def test_a_soup_costs_few_rays_before_it_is_refused(thorough, capture):
    """Each meets the boxes of many triangles: 30,000 large ones took half a minute."""
    rays = []

    class Counted(EmbreeTracer):
        def is_blocked(self, origins, directions, reach=None):
            rays.append(len(origins))
            return super().is_blocked(origins, directions, reach)

    generator = np.random.default_rng(0)
    triangles = generator.normal(size=(500, 1, 3)) + generator.normal(size=(500, 3, 3))
    corners = triangles.reshape(-1, 3) / np.linalg.norm(triangles, axis=2).max()
    soup = Counted(corners.astype(np.float32), np.arange(1500, dtype=np.int32).reshape(-1, 3))
    _, then = better_place(corners, soup, capture.normalised().train, AS_IT_IS)
    assert then.share < 0.75
    assert sum(rays) < 2e7


def test_a_soup_of_large_faces_is_refused_before_it_is_placed(capture, tmp_path):
    soup = np.random.default_rng(0).uniform(-1, 1, size=(90_000, 3))
    begin = time.process_time()
    with pytest.raises(CaptureError, match=r"no surface.*without loose faces"):
        hand(capture, trimesh.Trimesh(soup, np.arange(90_000).reshape(-1, 3)), tmp_path)
    assert time.process_time() - begin < 5


def test_slivers_of_a_disc_are_a_surface():
    """As programs for parts of machines write them: all meet in one corner."""
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    turned = Rotation.from_rotvec([0.6, 0.6, 0.2]).apply(rim)
    rising = np.arange(1, 1999)
    disc = np.stack([0 * rising, rising, rising + 1], axis=1).astype(np.int32)
    covering(turned, disc)
    covering(turned, np.repeat(disc[900:901], 50_000, axis=0))  # equal ones count once


def without_a_part(solid: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(solid.vertices, solid.faces[len(solid.faces) // 2 :])


@pytest.mark.slow
def test_a_mesh_that_cannot_fit_is_refused(capture, tmp_path):
    with pytest.raises(CaptureError, match="does not belong to these photographs"):
        hand(capture, placed(trimesh.creation.torus(0.8, 0.02)), tmp_path, fit_mesh=True)
    assert (tmp_path / "mesh_fit.png").exists()


@pytest.mark.slow
def test_a_mesh_without_a_photographed_part_is_taken_and_told(capture, tmp_path):
    handed = hand(capture, placed(without_a_part(statue())), tmp_path)
    assert any("it lacks" in note for note in handed.notes)


def test_corners_that_are_no_numbers_cost_their_faces(capture, tmp_path):
    solid = placed(statue())
    corners = solid.triangles.reshape(-1, 3).copy()
    corners[0], corners[31] = np.nan, np.inf
    faces = np.arange(len(corners)).reshape(-1, 3)
    broken = trimesh.Trimesh(corners, faces, process=False)
    handed = hand(capture, broken, tmp_path)
    assert any("2 of 192 faces of the mesh have corners" in note for note in handed.notes)
    kept = np.delete(statue().triangles, [0, 10], axis=0)
    assert handed.mesh.vertices[handed.mesh.faces] == pytest.approx(kept, abs=1e-5)


def with_layout(solid: trimesh.Trimesh, layout) -> trimesh.Trimesh:
    """The shape with every face apart, and texture coordinates of its corners."""
    corners = solid.triangles.reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    visual = trimesh.visual.TextureVisuals(uv=layout(len(faces)))
    return trimesh.Trimesh(corners, faces, visual=visual, process=False)


def grid(count: int) -> np.ndarray:
    """A layout in which every triangle has a square of its own."""
    side = int(np.ceil(np.sqrt(count)))
    cell = np.stack(np.divmod(np.arange(count), side), axis=1)
    return ((cell[:, None] + np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])) / side).reshape(-1, 2)


@pytest.mark.parametrize(
    ("layout", "fault"),
    [
        (grid, None),
        (lambda n: np.where(np.arange(3 * n)[:, None] < 30, np.nan, grid(n)), "have none"),
    ],
)
def test_a_good_layout_is_kept_and_any_other_replaced(capture, tmp_path, layout, fault):
    solid = with_layout(placed(statue()), layout)
    (tmp_path / "scan.glb").write_bytes(y_up(solid).export(file_type="glb"))
    captures = (capture, capture.normalised())
    picture = tmp_path / "mesh_fit.png"
    handed = hand_in(tmp_path / "scan.glb", captures, GeometryConfig(), picture, Quiet())
    mesh = handed.mesh
    kept = np.allclose(mesh.uvs[mesh.uv_faces].reshape(-1, 2), layout(len(mesh.faces)), atol=1e-6)
    assert kept == (fault is None)
    assert fault is None or any(fault in note for note in handed.notes)
    assert mesh.vertices[mesh.faces] == pytest.approx(statue().triangles, abs=1e-5)


def y_up(solid: trimesh.Trimesh) -> trimesh.Trimesh:
    turned = solid.copy()
    turned.vertices = np.stack(
        [solid.vertices[:, 0], solid.vertices[:, 2], -solid.vertices[:, 1]], axis=1
    )
    return turned


def test_light_is_solved_on_a_copy_of_a_mesh_with_many_faces(capture, tmp_path):
    solid = statue().subdivide().subdivide().subdivide()
    budget = len(solid.faces) // 64
    fine = with_layout(placed(solid), grid)
    (tmp_path / "scan.glb").write_bytes(y_up(fine).export(file_type="glb"))
    handed = hand_in(
        tmp_path / "scan.glb", (capture, capture.normalised()), GeometryConfig(face_budget=budget),
        tmp_path / "mesh_fit.png", Quiet(),
    )  # fmt: skip
    assert len(handed.mesh.faces) == len(solid.faces)
    assert handed.light is not None
    assert len(handed.light.faces) <= 4 * budget
    assert handed.light.is_whole()
    handed.mesh.save(tmp_path / "mesh.npz")
    handed.light.save(tmp_path / LIGHT)
    assert (mesh_for_light(tmp_path).faces == handed.light.faces).all()
    cosine = np.einsum("fcd,fd->fc", handed.mesh.normals[handed.mesh.faces], solid.face_normals)
    assert np.median(cosine) > 0.99


def test_guessed_masks_give_way_to_the_outline(capture, tmp_path):
    guessed = Finding(level="note", code="guessed-masks", message="")
    eaten = tuple(
        replace(view, mask=np.where(np.arange(96)[:, None] < 50, view.mask, 0).astype(np.uint8))
        for view in capture.views[:1]
    )
    worse = replace(capture, views=(*eaten, *capture.views[1:]), findings=(guessed,))
    handed = hand(worse, placed(statue()), tmp_path)
    assert handed.views is not None
    for view, true in zip(handed.views, capture.views, strict=True):
        differs = (view.mask > 127) != (true.mask > 127)
        assert differs.sum() < 0.03 * (true.mask > 127).sum()
