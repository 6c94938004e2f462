# SPDX-License-Identifier: Apache-2.0
"""Cameras turned by known angles are turned back; exact ones and the frame stay."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from robir.capture.capture import Capture
from robir.capture.store import load_settled, save_capture, save_turned
from robir.errors import StorageError
from robir.geometry.config import GeometryConfig
from robir.geometry.fit import pose_trial
from robir.geometry.fit.alignment import Alignment, image_motion_of_turns, turned
from robir.geometry.fit.field_preview import Present, Renderer
from robir.geometry.fit.pose_trial import CamerasChangedError, PoseTrial
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import RaySampler, reduce_view
from robir.geometry.stage import reconstruct
from robir.jobs.paths import JobPaths
from tests.geometry.mesh.test_isosurface import Silent
from tests.geometry.scenes import ball, camera_at, capture_of

SIDE = 96


def painted(points: np.ndarray) -> np.ndarray:
    """Smooth colours in [0, 255]."""
    return 128.0 + 110.0 * np.sin(7.0 * points + [0.0, 1.0, 2.0])


def solid() -> trimesh.Trimesh:
    parts = [ball(0.4, (0.1, 0.0, 0.0)), ball(0.25, (-0.3, 0.2, 0.25))]
    return trimesh.util.concatenate(parts)


def exact(mesh: trimesh.Trimesh) -> Renderer:
    """Draws what the photographs of `capture_of` show."""
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(mesh)

    def render(origins: torch.Tensor, directions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        eye, ahead = origins.double().numpy(), directions.double().numpy()
        across = np.cross(ahead, [0.3, -0.5, 0.8])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = np.cross(ahead, across)
        shown = np.zeros((len(eye), 4))
        for i, j in np.ndindex(3, 3):  # of the same nine parts of a pixel
            fine = ahead + ((i - 1) * across + (j - 1) * along) / (3 * 1.35 * SIDE)
            places, ray, _ = caster.intersects_location(eye, fine, multiple_hits=False)
            shown[ray, :3] += painted(places) / 255.0 / 9.0
            shown[ray, 3] += 1.0 / 9.0
        rgb = shown[:, :3] / np.maximum(shown[:, 3:], 1e-6)
        return torch.from_numpy(rgb).float(), torch.from_numpy(shown[:, 3]).float()

    return render


def spoilt(capture: Capture, degrees: float, seed: int) -> tuple[Capture, np.ndarray]:
    """Cameras turned at random about their own centres, and by how much (V, 3), radians."""
    rng = np.random.default_rng(seed)
    turns = np.radians(degrees) / np.sqrt(3.0) * rng.standard_normal((len(capture.views), 3))
    views = tuple(
        replace(view, camera=turned(view.camera, turn))
        for view, turn in zip(capture.views, turns, strict=True)
    )
    return replace(capture, views=views), turns


def left_over(before: Capture, after: Capture) -> np.ndarray:
    """(V,) degrees between the orientations of cameras."""
    pairs = zip(before.views, after.views, strict=True)
    between = [
        a.camera.camera_to_world[:3, :3].T @ b.camera.camera_to_world[:3, :3] for a, b in pairs
    ]
    return np.degrees(Rotation.from_matrix(np.stack(between)).magnitude())


def apart(alignment: Alignment, turns: np.ndarray) -> float:
    """Root mean square shift by turns of cameras, pixels, up to a motion of the world."""
    frame = alignment._frame
    moved = np.einsum("vkw,vw->vk", frame._turning, turns).ravel()
    moving = frame._moving.reshape(len(moved), -1)
    shared, *_ = np.linalg.lstsq(moving, moved, rcond=None)
    return float(np.sqrt(2.0 * np.mean((moved - moving @ shared) ** 2)))


@pytest.fixture(scope="module")
def capture() -> Capture:
    return capture_of(solid(), views=16, side=SIDE, low=-0.6, paint=painted)


def test_motion_of_the_image_is_that_of_finite_turns() -> None:
    camera = replace(camera_at(0.7, 0.4, SIDE), cx=40.0, fy=150.0)
    pixels = np.random.default_rng(0).uniform(0.0, SIDE, (20, 2))
    motion = image_motion_of_turns(camera, pixels)
    origins, directions = camera.rays(pixels)
    for axis, step in enumerate(1e-5 * np.eye(3)):
        seen, _ = turned(camera, step).project(origins + 2.0 * directions)
        np.testing.assert_allclose(motion[..., axis], (seen - pixels) / 1e-5, rtol=1e-3, atol=0.05)


def test_turned_cameras_are_turned_back(capture: Capture) -> None:
    wrong, turns = spoilt(capture, 0.6, seed=1)
    alignment = Alignment(wrong.views, 0)
    first = alignment.improve(exact(solid()), "cpu").mean()
    for _ in range(9):
        last = alignment.improve(exact(solid()), "cpu").mean()
    assert last < 0.6 * first
    assert apart(alignment, turns) > 1.0
    assert apart(alignment, turns + alignment.turns) < 0.15


def test_a_motion_of_the_world_is_no_turn_of_cameras(capture: Capture) -> None:
    frame = Alignment(capture.views, 0)._frame
    push = np.array([0.02, -0.01, 0.015])
    follow = (
        np.stack(
            [
                np.cross(view.camera.camera_to_world[:3, :3].T @ push, [0.0, 0.0, 1.0])
                for view in capture.views
            ]
        )
        / -3.2
    )  # looks after a point at the origin that is pushed
    assert np.sqrt((frame.shifts(follow) ** 2).mean()) > 0.5
    assert frame.shifts(frame.kept(follow)).max() < 0.1 * frame.shifts(follow).max()


def test_cameras_that_are_far_off_do_not_move_the_others(capture: Capture) -> None:
    frame = Alignment(capture.views, 0)._frame
    off = np.zeros((len(capture.views), 3))
    off[:3] = 0.05
    kept = frame.shifts(frame.kept(off))
    assert kept[:3].min() > 3.0
    assert kept[3:].max() < 0.3


def look_on(trial: PoseTrial, render: Renderer) -> None:
    """A fit whose field is known from the start."""
    photos = [reduce_view(view, SIDE) for view in trial.capture.train]
    sampler = RaySampler(photos, "cpu", torch.Generator().manual_seed(0))
    for step in range(0, pose_trial._LAST_STEP + 50, 25):
        trial.look(step, render, sampler)


def test_exact_cameras_stay_as_they_are(capture: Capture) -> None:
    trial = PoseTrial(capture, 0, "cpu")
    look_on(trial, exact(solid()))
    assert trial.capture is capture
    assert not trial.turns.any()


def test_wrong_cameras_are_turned_and_kept_if_the_next_fit_is_better(capture: Capture) -> None:
    wrong, _ = spoilt(capture, 0.6, seed=2)
    trial = PoseTrial(wrong, 0, "cpu")
    with pytest.raises(CamerasChangedError):
        look_on(trial, exact(solid()))
    look_on(trial, exact(solid()))
    found = trial.capture
    assert np.median(left_over(capture, found)) < 0.5 * np.median(left_over(capture, wrong))
    for view, given in zip(found.views, wrong.views, strict=True):
        np.testing.assert_array_equal(view.camera.position, given.camera.position)


def test_cameras_are_given_up_if_the_next_fit_is_no_better(capture: Capture) -> None:
    wrong, _ = spoilt(capture, 0.6, seed=2)
    trial = PoseTrial(wrong, 0, "cpu")
    with pytest.raises(CamerasChangedError):
        look_on(trial, exact(solid()))

    def worse(origins: torch.Tensor, directions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        rgb, coverage = exact(solid())(origins, directions)
        return 1.0 - rgb, coverage

    with pytest.raises(CamerasChangedError):
        look_on(trial, worse)
    assert not trial.turns.any()
    for view, given in zip(trial.capture.views, wrong.views, strict=True):
        np.testing.assert_array_equal(view.camera.camera_to_world, given.camera.camera_to_world)
    look_on(trial, worse)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.0, 0.7])
def test_a_fit_turns_cameras_back(capture: Capture, degrees: float) -> None:
    wrong, turns = spoilt(capture, degrees, seed=3)
    config = GeometryConfig(  # what other surfaces would do after the fit is not asked here
        level_cells=(40,), level_steps=(300,), rays=1024, face_budget=800, without=("rivals",)
    )
    trial = PoseTrial(wrong, 0, "cpu")
    steps = config.level_steps[0]

    def watch(share: float, present: Present, sampler: RaySampler) -> None:
        trial.look(round(share * steps), present.render, sampler)

    def fitted() -> Mesh:
        return reconstruct(trial.capture, config, 0, "cpu", Silent(), watch).mesh

    if not degrees:
        mesh = fitted()
        assert trial.capture is wrong
        untried = reconstruct(wrong, config, 0, "cpu", Silent()).mesh
        np.testing.assert_array_equal(mesh.vertices, untried.vertices)
        return
    for _ in range(pose_trial._MOST_ROUNDS + 1):
        with contextlib.suppress(CamerasChangedError):
            fitted()
            break
    alignment = Alignment(capture.views, 0)
    assert apart(alignment, turns) > 1.0
    assert apart(alignment, turns + trial.turns) < 0.3


def test_short_fits_try_no_cameras(capture: Capture) -> None:
    wrong, _ = spoilt(capture, 0.6, seed=2)
    trial = PoseTrial(wrong, 0, "cpu")
    photos = [reduce_view(view, SIDE) for view in wrong.train]
    sampler = RaySampler(photos, "cpu", torch.Generator())
    trial.look(pose_trial._TRIAL_STEP - 1, exact(solid()), sampler)
    assert trial.capture is wrong


def test_later_stages_read_the_turned_cameras(tmp_path: Path, capture: Capture) -> None:
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), capture)
    given = load_settled(paths)
    for view, same in zip(given.views, capture.views, strict=True):
        np.testing.assert_array_equal(view.camera.camera_to_world, same.camera.camera_to_world)
    wrong, _ = spoilt(capture, 5.0, seed=4)
    save_turned(paths, {view.name: view.camera for view in wrong.normalised().views})
    for view, same in zip(load_settled(paths).views, wrong.views, strict=True):
        np.testing.assert_array_equal(view.camera.camera_to_world, same.camera.camera_to_world)
    paths.turned_cameras.write_text("{}", encoding="utf-8")
    with pytest.raises(StorageError, match="geometry stage"):
        load_settled(paths)
