# SPDX-License-Identifier: Apache-2.0
"""Photographs: EXIF, bit depth, area averages and lens distortion against their definitions."""

from __future__ import annotations

import json
import tracemalloc

import numpy as np
import pytest
from capture import writers
from capture.scene import cameras, shoot
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion, Frame, Lens
from robir.capture.images.loading import (
    fitted_mask,
    open_photo,
    read_mask,
    shrink,
    straightened,
    undistort,
)
from robir.capture.recognise import read_capture, read_frames
from robir.capture.views import load_views
from robir.errors import CaptureError
from robir.workers import num_workers, use_workers

DISTORTIONS = {
    "barrel": Distortion(radial=(-0.25, 0.06, 0.0, 0.0)),
    "pincushion": Distortion(radial=(0.2, 0.05, 0.01, 0.002)),
    "tangential": Distortion(radial=(-0.1, 0.0, 0.0, 0.0), tangential=(0.01, -0.02)),
    "rational": Distortion(radial=(0.3, 0.1, 0.02, 0.0), rational=(0.5, 0.1, 0.03)),
    "skewed": Distortion(radial=(-0.1, 0.0, 0.0, 0.0), tangential=(0.01, 0.0), skew=0.05),
    "fisheye": Distortion(radial=(0.05, -0.02, 0.01, 0.002), is_fisheye=True),
}


def read_photo(path, declared, is_upright=None):
    with open_photo(path, declared, is_upright) as stored:
        return stored.read()


def test_exif_orientation_is_applied_where_no_size_is_declared(tmp_path):
    upright = np.zeros((20, 30, 3), dtype=np.uint8)
    upright[:10, :15] = (200, 0, 0)
    exif = Image.Exif()
    exif[0x0112] = 6  # stored turned: show it turned by 90 degrees clockwise
    path = tmp_path / "turned.png"
    Image.fromarray(np.ascontiguousarray(np.rot90(upright))).save(path, exif=exif)
    photo = read_photo(path, None)
    assert photo.orientation == 6
    assert np.array_equal(photo.image_display, upright)
    assert read_photo(path, (30, 20)).size == (30, 20)
    stored = read_photo(path, (20, 30))
    assert stored.orientation == 1
    assert stored.size == (20, 30)


def test_sixteen_bits_become_eight(tmp_path):
    ramp = np.linspace(0, 65535, 256).round().astype(np.uint16)
    Image.fromarray(np.tile(ramp, (4, 1))).save(tmp_path / "grey.png")
    photo = read_photo(tmp_path / "grey.png", None)
    assert np.array_equal(photo.image_display[0, :, 1], np.arange(256))
    Image.fromarray(np.tile(ramp, (4, 1))).save(tmp_path / "grey.tif")
    again = read_photo(tmp_path / "grey.tif", None)
    assert np.array_equal(again.image_display, photo.image_display)


def test_grey_floating_point_pictures_are_linear(tmp_path):
    Image.fromarray(np.full((4, 4), 0.5, dtype=np.float32)).save(tmp_path / "linear.tif")
    photo = read_photo(tmp_path / "linear.tif", None)
    assert photo.is_linear
    assert (photo.image_display == 188).all()


@pytest.mark.parametrize("kind", ["zeros and ones", "grey", "alpha", "one bit"])
def test_kinds_of_masks(kind, tmp_path):
    truth = np.zeros((8, 8), dtype=np.uint8)
    truth[2:5, 1:7] = 255
    picture = {
        "zeros and ones": Image.fromarray(truth // 255),
        "grey": Image.fromarray(truth),
        "alpha": Image.fromarray(np.dstack([np.full((8, 8, 3), 77, np.uint8), truth])),
        "one bit": Image.fromarray(truth).convert("1"),
    }[kind]
    picture.save(tmp_path / "mask.png")
    assert np.array_equal(read_mask(tmp_path / "mask.png", truth.shape[::-1]), truth)


def test_masks_of_a_preview_size_are_fitted():
    mask = np.zeros((43, 57), dtype=np.uint8)
    assert fitted_mask(mask, (114, 86)).shape == (86, 114)


def test_every_16_bit_code_becomes_the_nearest_8_bit_one(tmp_path):
    codes = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    Image.fromarray(codes).save(tmp_path / "grey.png")
    found = read_photo(tmp_path / "grey.png", None).image_display
    assert (found == np.rint(codes / 257)[:, :, None]).all()


def test_shrinking_is_a_mean_weighted_by_the_mask():
    generator = np.random.default_rng(1)
    image = generator.integers(0, 256, (12, 9, 3), dtype=np.uint8)
    mask = generator.integers(0, 256, (12, 9), dtype=np.uint8)
    mask[:4, :3] = 0
    small, small_mask = shrink(image, mask, 3, 3)
    blocks = mask.reshape(3, 4, 3, 3).astype(float)
    weighted = (image.reshape(3, 4, 3, 3, 3) * blocks[..., None]).sum(axis=(1, 3))
    plain = image.reshape(3, 4, 3, 3, 3).mean(axis=(1, 3))
    total = blocks.sum(axis=(1, 3))[..., None]
    expected = np.where(total > 0, weighted / np.maximum(total, 1), plain)
    assert np.abs(small - expected).max() <= 0.51
    assert np.abs(small_mask - blocks.mean(axis=(1, 3))).max() <= 0.51


def _opencv_distort(x, y, lens):
    """Forward model written once more, term by term, from OpenCV's documentation."""
    k1, k2, k3, k4 = lens.radial
    d1, d2, d3 = lens.rational
    p1, p2 = lens.tangential
    r = np.hypot(x, y)
    if lens.is_fisheye:
        angle = np.arctan(r)
        bent = angle + k1 * angle**3 + k2 * angle**5 + k3 * angle**7 + k4 * angle**9
        return x * bent / np.maximum(r, 1e-12), y * bent / np.maximum(r, 1e-12)
    ratio = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6 + k4 * r**8) / (
        1 + d1 * r**2 + d2 * r**4 + d3 * r**6
    )
    down = y * ratio + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    return x * ratio + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2) + lens.skew * down, down


def _pattern(x, y):
    return np.stack(
        [128 + 90 * np.sin(5 * x + 1), 128 + 90 * np.cos(4 * y), 128 + 90 * np.sin(3 * (x + y))],
        axis=-1,
    )


@pytest.mark.parametrize("name", DISTORTIONS)
def test_distortion_round_trip(name):
    """A picture distorted by the forward model comes back as the pinhole picture."""
    lens = DISTORTIONS[name]
    camera = Camera(
        width=160, height=120, fx=130.0, fy=140.0, cx=77.0, cy=62.0, camera_to_world=np.eye(4)
    )
    pixels = camera.pixel_centres()
    xd, yd = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    x, y = xd.copy(), yd.copy()
    for _ in range(200):
        ax, ay = _opencv_distort(x, y, lens)
        x, y = x - 0.7 * (ax - xd), y - 0.7 * (ay - yd)
    image = np.rint(_pattern(x, y)).astype(np.uint8).reshape(120, 160, 3)
    mask = np.where(x**2 + y**2 < 0.16, 255, 0).astype(np.uint8).reshape(120, 160)
    pinhole = straightened(camera, lens)
    straight, straight_mask = undistort(image, mask, camera, lens, pinhole)
    sx = (pixels[:, 0] - pinhole.cx) / pinhole.fx
    sy = (pixels[:, 1] - pinhole.cy) / pinhole.fy
    expected = _pattern(sx, sy).reshape(120, 160, 3)
    error = np.abs(straight - expected)[2:-2, 2:-2]
    assert error.max() < 3
    assert error.mean() < 0.6
    disc = (sx**2 + sy**2 < 0.16).reshape(120, 160)
    assert (disc != (straight_mask >= 128)).mean() < 0.008


def test_a_lens_that_folds_is_refused():
    camera = cameras(1)[0]
    with pytest.raises(CaptureError, match="folds"):
        straightened(camera, Distortion(radial=(-40.0, 0.0, 0.0, 0.0)))


COLMAP_LENSES = {
    "SIMPLE_RADIAL 120 100 60 60 50 0.1": Distortion(radial=(0.1, 0.0, 0.0, 0.0)),
    "RADIAL 120 100 60 60 50 0.1 0.2": Distortion(radial=(0.1, 0.2, 0.0, 0.0)),
    "OPENCV 120 100 60 60 60 50 1 2 3 4": Distortion(
        radial=(1.0, 2.0, 0.0, 0.0), tangential=(3.0, 4.0)
    ),
    "FULL_OPENCV 120 100 60 60 60 50 1 2 3 4 5 6 7 8": Distortion(
        radial=(1.0, 2.0, 5.0, 0.0), tangential=(3.0, 4.0), rational=(6.0, 7.0, 8.0)
    ),
    "SIMPLE_FISHEYE 120 100 60 60 50": Distortion(is_fisheye=True),
    "FISHEYE 120 100 60 60 60 50": Distortion(is_fisheye=True),
    "SIMPLE_RADIAL_FISHEYE 120 100 60 60 50 0.1": Distortion(
        radial=(0.1, 0.0, 0.0, 0.0), is_fisheye=True
    ),
    "RADIAL_FISHEYE 120 100 60 60 50 0.1 0.2": Distortion(
        radial=(0.1, 0.2, 0.0, 0.0), is_fisheye=True
    ),
    "OPENCV_FISHEYE 120 100 60 60 60 50 1 2 3 4": Distortion(
        radial=(1.0, 2.0, 3.0, 4.0), is_fisheye=True
    ),
}


@pytest.mark.parametrize("line", COLMAP_LENSES)
def test_colmap_lenses(line, shots, tmp_path):
    writers.colmap(tmp_path, shots, binary=False)
    (tmp_path / "sparse/0/cameras.txt").write_text(f"3 {line}\n")
    lens = read_frames(tmp_path).frames[0].lens
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (60, 60, 60, 50)
    assert lens.distortion == COLMAP_LENSES[line]


TRANSFORMS_LENSES = [
    ({"k1": 0.1, "k4": 0.2}, Distortion(radial=(0.1, 0.0, 0.0, 0.2))),
    ({"k3": 0.1, "k4": 0.2, "k6": 0.3}, Distortion(radial=(0, 0, 0.1, 0), rational=(0.2, 0, 0.3))),
    ({"camera_model": "FULL_OPENCV", "k4": 0.2}, Distortion(rational=(0.2, 0, 0))),
    (
        {"camera_model": "OPENCV_FISHEYE", "k4": 0.2},
        Distortion(radial=(0, 0, 0, 0.2), is_fisheye=True),
    ),
    ({"is_fisheye": True}, Distortion(is_fisheye=True)),
    (
        {"distortion_params": [1, 2, 3, 4, 5, 6]},
        Distortion(radial=(1, 2, 3, 4), tangential=(5, 6)),
    ),
]


@pytest.mark.parametrize(("keys", "expected"), TRANSFORMS_LENSES)
@pytest.mark.parametrize("of_the_file", [True, False])
def test_transforms_lenses(keys, expected, of_the_file, shots, tmp_path):
    writers.nerfstudio(tmp_path, shots)
    path = tmp_path / "transforms.json"
    content = json.loads(path.read_text())
    for entry in [content] if of_the_file else content["frames"]:
        entry |= keys
    path.write_text(json.dumps(content))
    assert {frame.lens.distortion for frame in read_frames(tmp_path).frames} == {expected}


@pytest.mark.parametrize("form", ["colmap", "nerfstudio"])
def test_a_distorted_capture_keeps_its_object_in_place(form, tmp_path):
    """The undistorted mask covers what the returned camera says."""
    lens = Distortion(radial=(-0.2, 0.04, 0.0, 0.0), tangential=(0.03, -0.02))
    shots = [shoot(c, samples=1) for c in cameras(size=(120, 100))]
    bent = [_bent(shot, lens) for shot in shots]
    c = shots[0].camera
    if form == "colmap":
        writers.colmap(tmp_path, bent, binary=False)
        (tmp_path / "sparse/0/cameras.txt").write_text(
            f"3 OPENCV 120 100 {c.fx} {c.fy} {c.cx} {c.cy} -0.2 0.04 0.03 -0.02\n"
        )
    else:
        writers.nerfstudio(tmp_path, bent)
        path = tmp_path / "transforms.json"
        keys = {"k1": -0.2, "k2": 0.04, "p1": 0.03, "p2": -0.02}
        path.write_text(json.dumps(json.loads(path.read_text()) | keys))
    assert {frame.lens.distortion for frame in read_frames(tmp_path).frames} == {lens}
    capture = read_capture(tmp_path, None, CaptureConfig())
    for view in capture.views:
        truth = shoot(view.camera, samples=1).rgba[:, :, 3] > 0
        found = view.mask >= 128
        assert (truth & found).sum() / (truth | found).sum() > 0.96
    assert "undistorted" in {finding.code for finding in capture.findings}


def _bent(shot, lens):
    """The same shot through a distorting lens."""
    camera = shot.camera
    pixels = camera.pixel_centres()
    xd, yd = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    x, y = xd.copy(), yd.copy()
    for _ in range(60):
        ax, ay = _opencv_distort(x, y, lens)
        x, y = x - (ax - xd), y - (ay - yd)
    column = np.clip(x * camera.fx + camera.cx, 0.5, camera.width - 0.5).astype(int)
    row = np.clip(y * camera.fy + camera.cy, 0.5, camera.height - 0.5).astype(int)
    return type(shot)(camera, shot.rgba[row, column].reshape(shot.rgba.shape))


def test_large_photographs_are_shrunk_with_their_cameras(tmp_path):
    shots = [shoot(c, samples=1) for c in cameras(4, size=(48, 48))]
    big = [type(s)(s.camera.resized(96, 96), s.rgba.repeat(2, 0).repeat(2, 1)) for s in shots]
    writers.nerf_synthetic(tmp_path, big)
    capture = read_capture(tmp_path, None, CaptureConfig(max_side=48))
    for view, shot in zip(capture.views, shots, strict=True):
        assert np.array_equal(view.mask, shot.rgba[:, :, 3])
        np.testing.assert_allclose(view.camera.fx, shot.camera.fx, rtol=1e-9)


def test_photographs_are_read_few_at_a_time(tmp_path):
    """Six photographs of 3 megapixels never sit in memory at once, but two do on two cores."""
    path = tmp_path / "big.png"
    Image.new("RGBA", (2000, 1500), (90, 80, 70, 128)).save(path)
    frames = [
        (
            Frame(
                name=f"{i}",
                image=path,
                relative="big.png",
                lens=Lens(angle_x=0.7),
                camera_to_world=np.eye(4),
            ),
            "train",
        )
        for i in range(6)
    ]
    before = num_workers()
    use_workers(2)
    tracemalloc.start()
    loaded = load_views(frames[:1], {}, 400, lambda share, text: None)
    one = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    loaded = load_views(frames, {}, 400, lambda share, text: None)
    many = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    use_workers(before)
    assert loaded.views[0].image_display.shape == (300, 400, 3)
    assert many < 2.4 * one
