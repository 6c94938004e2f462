# SPDX-License-Identifier: Apache-2.0
"""Photographs cut to their object: cameras, masks and everything that asks beyond the picture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture.scene import CENTRE, cameras, shoot, surface_points
from PIL import Image

from robir.capture.bounds import enclosing_sphere, sphere_from_points
from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.capture.checks.findings import check_masks, mask_share
from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion, Frame, Lens, posed_otherwise
from robir.capture.images.reading import LEAST_SAVED, MARGIN, drawn_mask, object_box, read_view
from robir.capture.recognise import read_capture
from robir.capture.store import load_capture, save_capture
from robir.cli import main

LENS = Lens(width=640, height=480, fx=600.0, fy=590.0, cx=311.0, cy=255.0)
BENT = replace(LENS, distortion=Distortion(radial=(-0.2, 0.05, 0.0, 0.0)))


def camera_of(lens: Lens = LENS) -> Camera:
    return lens.camera(np.eye(4), 640, 480)


def pattern() -> np.ndarray:
    """A picture of which every pixel tells where it is."""
    y, x = np.mgrid[:480, :640]
    smooth = [128 + 90 * np.sin(x / 40), 128 + 90 * np.cos(y / 30), 128 + 90 * np.sin((x + y) / 50)]
    return np.rint(np.stack(smooth, axis=2)).astype(np.uint8)


def spot(left: int, top: int, right: int, bottom: int) -> np.ndarray:
    mask = np.zeros((480, 640), np.uint8)
    mask[top:bottom, left:right] = 255
    return mask


def write_small_object(folder: Path, count: int = 12, side: int = 400) -> list[Camera]:
    """A NeRF-synthetic capture whose object takes a third of the picture; its cameras."""
    folder.mkdir(parents=True)
    taken = [
        replace(camera, fx=1.1 * side, fy=1.1 * side)
        for camera in cameras(count, size=(side, side))
    ]
    frames = []
    for number, camera in enumerate(taken):
        Image.fromarray(shoot(camera, samples=1).rgba).save(folder / f"{number:02d}.png")
        pose = camera.camera_to_world.tolist()
        frames.append({"file_path": f"./{number:02d}", "transform_matrix": pose})
    table = {"camera_angle_x": 2 * float(np.arctan(0.5 / 1.1)), "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(table))
    return taken


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> tuple[Capture, Capture]:
    """The same photographs as they are read, and as they would be if none were cut."""
    folder = tmp_path_factory.mktemp("small") / "capture"
    write_small_object(folder)
    cut = read_capture(folder, None, CaptureConfig(max_side=200))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robir.capture.images.reading.object_box", lambda mask: None)
        whole = read_capture(folder, None, CaptureConfig(max_side=400))
    return cut, whole


def test_the_box_holds_the_object_and_a_margin():
    left, top, right, bottom = object_box(spot(300, 200, 400, 280)) or (0, 0, 0, 0)
    assert (left, top, right, bottom) == (295, 195, 405, 285)
    assert 300 - left == pytest.approx(MARGIN * 100)
    # where the picture ends, so does the box
    assert object_box(spot(0, 200, 100, 480)) == (0, 186, 114, 480)


def test_what_saves_little_stays_whole():
    assert object_box(np.zeros((480, 640), np.uint8)) is None
    assert object_box(np.full((480, 640), 255, np.uint8)) is None
    side = round((1 - LEAST_SAVED) * 640)
    assert object_box(spot(0, 0, side - 25, 200)) is not None
    assert object_box(spot(0, 0, side - 20, 200)) is None


def test_a_part_has_the_rays_and_the_lens_of_the_whole():
    whole = camera_of()
    part = whole.part((100, 50, 300, 250)).resized(100, 50)
    inside = np.array([[110.0, 60.0], [299.0, 249.0]])
    here = (inside - [100, 50]) * [0.5, 0.25]
    np.testing.assert_allclose(part.rays(here)[1], whole.rays(inside)[1], atol=1e-12)
    np.testing.assert_allclose(part.edges, (-50, -12.5, 270, 107.5))
    # dark corners belong to the lens: as many pixels off the axis, the same share of its corner
    square = whole.part((100, 50, 300, 250))
    np.testing.assert_allclose(square.off_axis(inside - [100, 50]), whole.off_axis(inside))
    assert square.part((10, 10, 50, 50)).edges == whole.part((110, 60, 150, 100)).edges
    assert replace(part.uncut(), whole=None) == part.uncut()
    assert (part.uncut().width, part.uncut().height) == (320, 120)
    np.testing.assert_allclose(
        part.uncut().rays(inside * [0.5, 0.25])[1], whole.rays(inside)[1], atol=1e-12
    )


def test_another_pose_is_cut_alike():
    part = camera_of().part((100, 50, 300, 250)).resized(100, 100)
    pose = cameras(3)[2].camera_to_world
    frame = Frame(name="a", image=Path("a"), relative="a", lens=LENS, camera_to_world=pose)
    other = posed_otherwise(part, frame)
    expected = LENS.camera(pose, 640, 480).part((100, 50, 300, 250)).resized(100, 100)
    np.testing.assert_allclose(other.camera_to_world, pose, atol=1e-12)
    for name in ("fx", "fy", "cx", "cy", "edges"):
        np.testing.assert_allclose(getattr(other, name), getattr(expected, name))


@pytest.mark.parametrize("lens", [LENS, BENT], ids=["pinhole", "distorted"])
@pytest.mark.parametrize("max_side", [640, 60])
def test_a_cut_picture_shows_what_the_whole_shows(lens, max_side, tmp_path, monkeypatch):
    """Rays of the cut picture find the colours that rays of the uncut one find."""
    Image.fromarray(pattern()).save(tmp_path / "a.png")
    frame = Frame(
        name="a",
        image=tmp_path / "a.png",
        relative="a.png",
        lens=lens,
        camera_to_world=np.eye(4),
    )
    mask = drawn_mask(spot(420, 100, 560, 200))
    cut = read_view(frame, "train", mask, max_side)
    assert max(cut.view.mask.shape) <= min(max_side, 180)
    monkeypatch.setattr("robir.capture.images.reading.object_box", lambda mask: None)
    whole = read_view(frame, "train", mask, 640).view
    camera = cut.view.camera
    points = camera.position + 5.0 * camera.rays(camera.pixel_centres())[1]
    place = whole.camera.project(points)[0] - 0.5
    column, row = np.rint(place).astype(int).T
    expected = whole.image_display[row, column].reshape(cut.view.image_display.shape)
    slack = 12 if max_side == 60 else 6  # a pixel's rounding, three original pixels at 60
    assert np.abs(cut.view.image_display.astype(int) - expected).mean() < slack
    assert np.abs(cut.view.mask.astype(int) - whole.mask[row, column].reshape(-1, camera.width))[
        1:-1, 1:-1
    ].mean() < (20 if max_side == 60 else 4)
    np.testing.assert_allclose(camera.uncut().fx / camera.fx, 1.0)


def test_a_jpeg_is_decoded_no_finer_than_needed(tmp_path):
    large = Image.fromarray(pattern()).resize((2563, 1921), Image.Resampling.BICUBIC)
    large.save(tmp_path / "a.jpg", quality=98)
    lens = Lens(angle_x=0.8)
    frame = Frame(
        name="a", image=tmp_path / "a.jpg", relative="a", lens=lens, camera_to_world=np.eye(4)
    )
    small = read_view(frame, "train", None, 300).view
    assert small.mask.shape[1] == 300
    exact = lens.camera(np.eye(4), 2563, 1921)
    # decoded at a quarter, 641x481 pixels hold 2564x1924 of the file: its rays stay where they are
    corner = np.array([[300.0, 0.0]])
    np.testing.assert_allclose(
        small.camera.rays(corner)[1], exact.rays(np.array([[2564.0, 0.0]]))[1], atol=1e-9
    )
    place = exact.resized(640, 480).project(small.camera.rays(small.camera.pixel_centres())[1])[0]
    column, row = np.clip(np.rint(place - 0.5), 0, [639, 479]).astype(int).T
    expected = pattern()[row, column].reshape(small.image_display.shape).astype(int)
    assert np.abs(small.image_display - expected).mean() < 3


def test_small_photographs_stay_as_they_are(tmp_path):
    write_small_object(tmp_path / "capture", 6, side=200)
    capture = read_capture(tmp_path / "capture", None, CaptureConfig())
    for view in capture.views:
        with Image.open(tmp_path / "capture" / f"{view.name}.png") as picture:
            assert np.array_equal(np.dstack([view.image_display, view.mask]), np.array(picture))
        assert view.camera.whole is None


def test_a_cut_capture_is_the_same_object(captures):
    cut, whole = captures
    assert all(view.camera.whole is not None for view in cut.views)
    assert max(max(view.mask.shape) for view in cut.views) <= 200
    offset = np.linalg.norm(cut.bounds.centre - whole.bounds.centre)
    assert offset < 0.02 * whole.bounds.radius
    assert cut.bounds.radius == pytest.approx(whole.bounds.radius, rel=0.02)
    points = surface_points()
    assert cut.bounds.radius < 1.08 * enclosing_sphere(points)[1]
    for view in cut.views:
        pixels, depth = view.camera.project(points)
        assert view.camera.in_picture(pixels, depth).all()
        column, row = np.floor(pixels).astype(int).T
        assert (view.mask[row, column] > 0).mean() > 0.97
    assert mask_share(cut.views) == pytest.approx(mask_share(whole.views), rel=0.02)


def test_points_beside_the_picture_are_known_to_be_background(captures):
    """Points that most pictures do not hold must not pass because a few masks hold them."""
    cut, whole = captures
    rng = np.random.default_rng(0)
    stray = CENTRE + rng.uniform(-1.3, 1.3, (4000, 3))
    points = np.concatenate([surface_points(400), stray])
    found = [sphere_from_points(points, views) for views in (cut.views, whole.views)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].radius == pytest.approx(found[1].radius, rel=0.05)


def test_masks_are_judged_by_the_whole_photograph():
    """A small object away from the border is neither large nor cut off once it is cut out."""
    mask = spot(300, 200, 340, 230)
    image = pattern()
    box = object_box(mask)
    assert box is not None
    view = View(
        name="a",
        image_display=image[box[1] : box[3], box[0] : box[2]],
        mask=mask[box[1] : box[3], box[0] : box[2]],
        camera=camera_of().part(box),
        split="train",
    )
    whole = View(name="a", image_display=image, mask=mask, camera=camera_of(), split="train")
    assert check_masks([view] * 3) == check_masks([whole] * 3)
    assert {finding.code for finding in check_masks([view])} == {"mask-share", "tiny-masks"}
    edge = spot(600, 200, 640, 230)
    left, top, right, bottom = object_box(edge) or (0, 0, 0, 0)
    cut_off = replace(
        view,
        image_display=image[top:bottom, left:right],
        mask=edge[top:bottom, left:right],
        camera=camera_of().part((left, top, right, bottom)),
    )
    assert check_masks([cut_off]) == check_masks([replace(whole, mask=edge)])


def test_what_was_cut_is_stored(captures, tmp_path):
    save_capture(tmp_path, captures[0])
    again = load_capture(tmp_path)
    for one, two in zip(captures[0].views, again.views, strict=True):
        assert one.camera.edges == two.camera.edges
        assert two.camera.whole is not None


def test_check_tells_the_cameras_of_the_photographs_themselves(tmp_path, capsys):
    taken = write_small_object(tmp_path / "capture")
    assert main(["check", str(tmp_path / "capture"), "--json", "--progress", "plain"]) == 0
    stated = json.loads(capsys.readouterr().out)["cameras"]
    for entry, camera in zip(stated, taken, strict=True):
        assert "whole" not in entry
        assert entry["cx"] / entry["width"] == pytest.approx(0.5, abs=2e-3)
        assert entry["fx"] / entry["width"] == pytest.approx(camera.fx / camera.width, rel=5e-3)
