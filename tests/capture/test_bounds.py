# SPDX-License-Identifier: Apache-2.0
"""The bounding sphere holds the object and little more; masks find their photographs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.scene import cameras, shoot, surface_points

from robir.capture.bounds import enclosing, enclosing_sphere, sphere_from_masks
from robir.capture.capture import PHOTOGRAPHS_ALONE, View
from robir.capture.checks.findings import place_object
from robir.capture.config import CaptureConfig
from robir.capture.frames import Frame, FrameSet, Lens
from robir.capture.masks.given import from_folder
from robir.capture.recognise import read_capture
from robir.errors import CaptureError

SLACK = 1.08


def views_of(shots: list) -> list[View]:
    return [
        View(
            name=str(i),
            image_display=shot.rgba[:, :, :3],
            mask=shot.rgba[:, :, 3],
            camera=shot.camera,
            split="train",
        )
        for i, shot in enumerate(shots)
    ]


def assert_tight(centre: np.ndarray, radius: float) -> None:
    points = surface_points()
    assert np.linalg.norm(points - centre, axis=1).max() <= radius
    assert radius <= SLACK * enclosing_sphere(points)[1]


def test_enclosing_sphere_of_known_points():
    generator = np.random.default_rng(2)
    direction = generator.normal(size=(400, 3))
    points = 3 + 2 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    centre, radius = enclosing_sphere(points)
    np.testing.assert_allclose(centre, 3, atol=0.05)
    assert 1.98 <= radius <= 2.01
    flat, half = enclosing_sphere(np.array([[x, y, 0.0] for x in range(9) for y in range(5)]))
    np.testing.assert_allclose(flat, [4, 2, 0], atol=0.05)
    assert half == pytest.approx(np.hypot(4, 2), rel=0.01)


def test_sphere_is_tight_from_masks_alone():
    lenses = [replace(c, fx=120.0, fy=120.0) for c in cameras(16, size=(96, 96))]
    shots = [shoot(camera, samples=2) for camera in lenses]
    hull = sphere_from_masks(views_of(shots), None)
    assert hull is not None
    assert hull.strict > 0.99
    assert_tight(hull.sphere.centre, hull.sphere.radius)


def test_the_object_stays_in_the_sphere_when_thin_parts_vanish_as_cells_are_divided():
    """What guessed masks share of a table: needles of coarse cells, of which only one tip stays."""
    half = 0.05
    ticks = np.arange(-1.6 + half, 1.6, 2 * half)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    in_ball = np.linalg.norm(grid, axis=1) < 0.6
    in_needles = (np.abs(grid[:, 1:]) < 2 * half).all(axis=1)

    def carved(cells, half):
        tip = np.linalg.norm(cells - [1.55, 0.0, 0.0], axis=1) < 0.05 + half
        return tip | (np.linalg.norm(cells, axis=1) < 0.6 + half)

    found = enclosing(carved, grid[in_ball | in_needles], half)
    points = np.concatenate([grid[in_ball], [[1.55, 0.0, 0.0]]])
    assert np.linalg.norm(points - found.centre, axis=1).max() < found.radius + 0.1
    assert found.radius < 1.2


@pytest.mark.parametrize(
    "write", [writers.neus, lambda root, s: writers.colmap(root, s, binary=True)]
)
def test_the_formats_own_bounds_are_refined_by_masks(write, tmp_path):
    shots = [shoot(camera) for camera in cameras(20, odd_lens=True)]
    write(tmp_path, shots)
    bounds = read_capture(tmp_path, None, CaptureConfig()).bounds
    assert "visual hull" in bounds.origin
    points = surface_points()
    assert np.linalg.norm(points - bounds.centre, axis=1).max() <= bounds.radius
    # 48 pixels a side: a pixel is 6 % of the radius.
    assert bounds.radius <= 1.12 * enclosing_sphere(points)[1]


def test_objects_cut_off_by_the_picture_stay_whole():
    """Photographs that show only the middle do not carve what they do not show."""
    wide = [shoot(camera, samples=2) for camera in cameras(16)]
    near = [shoot(replace(camera, fx=190.0, fy=190.0), samples=2) for camera in cameras(8)]
    hull = sphere_from_masks(views_of(wide + near), None)
    assert hull is not None
    points = surface_points()
    assert np.linalg.norm(points - hull.sphere.centre, axis=1).max() <= hull.sphere.radius


def test_one_wrong_mask_is_found_out(tmp_path):
    shots = [shoot(camera) for camera in cameras(20, odd_lens=True)]
    wrong = shots[5].rgba.copy()
    wrong[:, :] = (90, 80, 70, 0)
    wrong[2:12, 2:12, 3] = 255
    shots[5] = type(shots[5])(shots[5].camera, wrong)
    writers.neus(tmp_path, shots)
    capture = read_capture(tmp_path, None, CaptureConfig())
    odd = next(f for f in capture.findings if f.code == "odd-masks")
    assert odd.files == ("000005",)
    points = surface_points()
    outside = np.linalg.norm(points - capture.bounds.centre, axis=1) > capture.bounds.radius
    assert outside.mean() < 0.01


@pytest.mark.parametrize("form", [PHOTOGRAPHS_ALONE, "colmap"])
def test_a_photograph_that_we_put_in_a_wrong_place_is_left_out(tmp_path, form):
    views = views_of([shoot(camera) for camera in cameras(20)])
    camera = views[5].camera
    views[5] = replace(views[5], camera=replace(camera, cx=camera.cx + 0.15 * camera.width))
    frames = FrameSet(root=tmp_path, format=form, frames=())
    kept, bounds, findings = place_object(frames, tuple(views))
    codes = {finding.code: finding for finding in findings}
    if form == PHOTOGRAPHS_ALONE:
        assert [view.name for view in kept] == [str(k) for k in range(20) if k != 5]
        assert codes["misplaced"].files == ("5",) and "odd-masks" not in codes
        assert_tight(bounds.centre, bounds.radius)
    else:  # the user says where they are
        assert len(kept) == 20 and codes["odd-masks"].files == ("5",)


def _frames(*names: str) -> list[Frame]:
    return [
        Frame(
            name=n.replace("/", "_"),
            image=Path(n),
            relative=n,
            lens=Lens(angle_x=1.0),
            camera_to_world=np.eye(4),
        )
        for n in names
    ]


@pytest.mark.parametrize(
    ("photographs", "masks"),
    [
        (("a.jpg", "b.jpg"), ("a.png", "b.png")),
        (("images/a.JPG", "images/b.JPG"), ("a.jpg.png", "b.jpg.png")),
        (("a.jpg", "b.jpg"), ("a_mask.png", "b_mask.png")),
        (("a.jpg", "b.jpg"), ("mask_a.png", "mask_b.png")),
        (("image/000001.png", "image/000012.png"), ("001.png", "012.png")),
        (("1.jpg", "10.jpg"), ("1-removebg-preview.png", "10-removebg-preview.png")),
        (("train/r_0.png", "test/r_0.png"), ("train/r_0.png", "test/r_0.png")),
        (("train/r_0", "train/r_1"), ("r_0.png", "r_1.png")),
        (("left/a.png", "right/a.png"), ("left/a_mask.png", "right/a_mask.png")),
    ],
)
def test_namings_of_masks(photographs, masks, tmp_path):
    for mask in masks:
        (tmp_path / mask).parent.mkdir(exist_ok=True)
        (tmp_path / mask).touch()
    frames = _frames(*photographs)
    found = from_folder(tmp_path, frames)
    assert [found[f.name].relative_to(tmp_path).as_posix() for f in frames] == list(masks)


def test_masks_that_fit_two_photographs_are_refused(tmp_path):
    (tmp_path / "r_0.png").touch()
    with pytest.raises(CaptureError, match="share a mask"):
        from_folder(tmp_path, _frames("train/r_0.png", "test/r_0.png"))


@pytest.mark.parametrize("write", [writers.nerf_synthetic, writers.nerfstudio])
def test_given_masks_win_over_the_captures_own(write, shots, tmp_path):
    write(tmp_path, shots)
    wide = [
        type(s)(s.camera, np.dstack([s.rgba[:, :, :3], _grown(s.rgba[:, :, 3])])) for s in shots
    ]
    masks = tmp_path / "drawn"
    writers.save_masks(masks, wide, [f"r_{i}_mask.png" for i in range(8)])
    if write is writers.nerfstudio:
        for i in range(8):
            (masks / f"r_{i}_mask.png").rename(masks / f"frame_{i:05d}_mask.png")
    capture = read_capture(tmp_path, masks, CaptureConfig())
    for view, shot in zip(capture.views, wide, strict=True):
        assert np.array_equal(view.mask, shot.rgba[:, :, 3])


def _grown(mask: np.ndarray) -> np.ndarray:
    """One pixel wider."""
    padded = np.pad(mask, 1)
    return np.max(
        [padded[1 + dy : 49 + dy, 1 + dx : 49 + dx] for dx in (-1, 0, 1) for dy in (-1, 0, 1)],
        axis=0,
    )
