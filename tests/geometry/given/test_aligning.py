# SPDX-License-Identifier: Apache-2.0
"""Cameras in a frame of ours, brought to a mesh that stays: found from all turns, or refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from geometry.given.test_surface import Quiet, paint, statue
from geometry.scenes import capture_of
from scipy.spatial.transform import Rotation

from robir.capture.capture import Bounds, Capture
from robir.capture.mesh_file import Given
from robir.capture.store import load_bounds, load_settled, save_capture, save_frame
from robir.errors import CaptureError, StorageError
from robir.geometry.config import GeometryConfig
from robir.geometry.given.surface import Aligned, aligned, hand_in
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths.similarity import AS_IT_IS, Similarity

SIDE = 72  # pixels of the photographs: the unit sphere covers about 60 of them


@pytest.fixture(scope="module")
def capture() -> Capture:
    """Photographs alone of the statue, the frame of their cameras the unit frame."""
    return of(statue())


def of(solid: trimesh.Trimesh) -> Capture:
    seen = capture_of(solid, views=12, side=SIDE, low=-0.6, paint=paint)
    return replace(seen, format="photos")


def known(seed: int) -> Similarity:
    """Any turn, from a twentieth of the size to four hundred times it, and far away."""
    rng = np.random.default_rng(seed)
    scale = float(np.exp(rng.uniform(-3.0, 6.0)))
    turn = Rotation.random(random_state=seed).as_matrix()
    return Similarity(turn=turn, scale=scale, shift=30.0 * scale * rng.normal(size=3))


def given(solid: trimesh.Trimesh, place: Similarity) -> Given:
    """The mesh as a file has it: the cameras' frame brought to the user's."""
    vertices = place(np.asarray(solid.vertices, np.float64))
    uvs = np.full((len(vertices), 2), np.nan)
    return Given(vertices=vertices, faces=np.asarray(solid.faces, np.int32), uvs=uvs)


def bring(capture: Capture, solid: trimesh.Trimesh, place: Similarity, folder: Path) -> Aligned:
    return aligned(given(solid, place), capture, GeometryConfig(), folder / "fit.png")


def apart(found: Aligned, place: Similarity) -> tuple[float, float, float]:
    """Degrees, share of the scale, and share of the radius by which a place was missed."""
    assert found.frame is not None
    turn = Rotation.from_matrix(found.frame.turn.T @ place.turn).magnitude()
    middle = found.frame(np.zeros((1, 3))) - place(np.zeros((1, 3)))
    return (
        float(np.degrees(turn)),
        abs(found.frame.scale / place.scale - 1.0),
        float(np.linalg.norm(middle)) / place.scale,
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9])  # a turn of half a round
def test_cameras_come_to_the_mesh_from_anywhere(thorough, capture, tmp_path, seed):
    place = known(seed)
    # the sphere of a hull may be far too large, as where all photographs are from one side
    bounds = Bounds(centre=np.array([1.5, -2.0, 1.0]), radius=4.0, origin="an open hull")
    found = bring(replace(capture, bounds=bounds), statue(), place, tmp_path)
    degrees, scale, middle = apart(found, place)
    assert degrees < 0.6
    assert scale < 0.006
    assert middle < 0.006
    assert found.agreement.share > 0.97
    (told,) = found.notes
    assert "brought to the mesh" in told
    assert (tmp_path / "fit.png").exists()
    assert np.linalg.norm(found.capture.bounds.centre - place.shift) < 0.3 * place.scale
    assert found.capture.bounds.radius == pytest.approx(0.68 * place.scale, rel=0.1)
    # cameras see the mesh where they saw the statue
    corner = np.asarray(statue().vertices[:4])
    for view, was in zip(found.capture.views, capture.views, strict=True):
        pixels, _ = view.camera.project(place(corner))
        assert pixels == pytest.approx(was.camera.project(corner)[0], abs=0.6)


def test_a_mesh_that_stands_right_is_left_there(capture, tmp_path):
    found = bring(capture, statue(), AS_IT_IS, tmp_path)
    assert found.frame is None
    assert found.capture is capture
    assert not found.notes


@pytest.mark.slow
def test_a_mirrored_mesh_is_refused(capture, tmp_path):
    mirror = Similarity(turn=np.diag([-1.0, 1.0, 1.0]), scale=2.0, shift=np.ones(3))
    with pytest.raises(CaptureError, match="the mesh is mirrored"):
        bring(capture, statue(), mirror, tmp_path)
    assert (tmp_path / "fit.png").exists()


@pytest.mark.slow
def test_the_mesh_stays_and_later_stages_have_the_cameras_there(thorough, capture, tmp_path):
    place = known(1)
    solid = statue()
    solid.vertices = place(solid.vertices)
    path = tmp_path / "scan.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(solid))
    pair = (capture, capture.normalised())
    handed = hand_in(path, pair, GeometryConfig(), tmp_path / "fit.png", Quiet())
    assert handed.frame is not None
    paths = JobPaths(tmp_path / "out")
    save_capture(paths.stage("capture"), capture)
    save_frame(paths, *handed.frame)
    settled, bounds = load_settled(paths), load_bounds(paths)
    assert settled.bounds.radius == bounds.radius
    corners = handed.mesh.vertices[handed.mesh.faces] * bounds.radius + bounds.centre
    assert corners == pytest.approx(solid.triangles, abs=1e-5 * bounds.radius)
    view, was = settled.views[3].camera, capture.views[3].camera
    at = np.array([[0.1, 0.2, 0.3]])
    assert view.project(place(at))[0] == pytest.approx(was.project(at)[0], abs=0.6)
    turned = view.camera_to_world[:3, :3] @ was.camera_to_world[:3, :3].T
    assert Rotation.from_matrix(turned.T @ place.turn).magnitude() < np.radians(0.6)


@pytest.mark.parametrize(
    "changed",
    [
        {"turn": np.diag([-1.0, 1, 1]).tolist()},
        {"turn": (2 * np.eye(3)).tolist()},
        {"scale": 0.0},
        {"shift": [1.0, 2.0]},
    ],
)
def test_a_damaged_frame_is_said(capture, tmp_path, changed):
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), capture)
    save_frame(paths, AS_IT_IS, capture.bounds)
    assert load_settled(paths).bounds.radius == capture.bounds.radius
    write_json(paths.frame, read_json(paths.frame) | changed)
    with pytest.raises(StorageError, match="Run the geometry stage again"):
        load_settled(paths)
