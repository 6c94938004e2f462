# SPDX-License-Identifier: Apache-2.0
"""Colours of files against the same picture in sRGB."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
from capture import writers
from capture.images.profiles import (
    COLORANTS,
    REPORTS,
    curved,
    in_space,
    linear,
    profile,
    with_chunk,
)
from PIL import Image

from robir.appearance.config import FAMILIES, AppearanceConfig
from robir.appearance.stage import with_known_curve
from robir.capture.config import CaptureConfig
from robir.capture.images.loading import open_photo
from robir.capture.recognise import read_capture
from robir.capture.refusal import CaptureRefusedError
from robir.capture.store import load_capture, save_capture


def picture(low: float = 0.25, high: float = 0.75) -> np.ndarray:
    """Smooth colours within all gamuts, (48, 64, 3) sRGB codes in [0, 1]."""
    y, x = np.mgrid[0:48, 0:64]
    waves = np.stack([np.sin(x / 9), np.cos(y / 7), np.sin((x + y) / 11)], axis=2)
    return low + (high - low) * (0.5 + 0.5 * waves)


def codes(values: np.ndarray, bits: int = 8) -> np.ndarray:
    return np.rint(values * (2**bits - 1)).astype(f"uint{bits}")


def read(path: Path, exposure: float = 1.0):
    with open_photo(path, None) as stored:
        return stored.read(exposure=exposure)


def save(path: Path, name: str, bits: int = 8) -> None:
    found = codes(in_space(picture(), name), bits)
    icc = profile(name)
    if bits == 16:
        tifffile.imwrite(path, found, photometric="rgb", iccprofile=icc)
    elif path.suffix == ".jpg":
        Image.fromarray(found).save(path, quality=100, subsampling=0, icc_profile=icc)
    else:
        Image.fromarray(found).save(path, icc_profile=icc)


@pytest.mark.parametrize("name", ["p3", "adobe", "prophoto"])
@pytest.mark.parametrize("file", ["a.jpg", "a.png", "a.webp", "deep.tif"])
def test_profiles_are_converted(tmp_path, name, file):
    bits = 16 if file == "deep.tif" else 8
    if file == "a.webp":
        found = Image.fromarray(codes(in_space(picture(), name)))
        found.save(tmp_path / file, lossless=True, icc_profile=profile(name))
    else:
        save(tmp_path / file, name, bits)
    photo = read(tmp_path / file)
    error = np.abs(photo.image_display - 255 * picture())
    assert error.mean() < (0.3 if bits == 16 else 1.2)
    assert error.max() < (0.8 if bits == 16 else 20)
    assert photo.colours == (f"{name} (converted to sRGB)",)


def test_sixteen_bits_stay_until_the_last_step(tmp_path):
    """ProPhoto's shadows: of eight bits a third would be lost."""
    dark = picture(0.0, 0.12)
    found = codes(in_space(dark, "prophoto"), 16)
    tifffile.imwrite(tmp_path / "a.tif", found, photometric="rgb", iccprofile=profile("prophoto"))
    assert np.abs(read(tmp_path / "a.tif").image_display - 255 * dark).max() < 0.8


def test_untagged_sixteen_bits_are_rounded(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", codes(picture(), 16), photometric="rgb")
    photo = read(tmp_path / "a.tif")
    assert (photo.image_display == codes(picture())).all()
    assert photo.colours == ("no colour profile (taken as sRGB)",)


@pytest.mark.parametrize("kind", ["none", "profile", "sRGB"])
def test_what_is_srgb_stays_as_it_is(tmp_path, kind):
    found, path = codes(picture(0, 1)), tmp_path / "a.png"
    icc = {"icc_profile": profile("srgb")} if kind == "profile" else {}
    Image.fromarray(found).save(path, **icc)
    if kind == "sRGB":
        with_chunk(path, b"sRGB", b"\0")
    assert (read(path).image_display == found).all()


def test_code_points_of_png(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(codes(in_space(picture(), "p3"))).save(path)
    with_chunk(path, b"cICP", bytes([12, 13, 0, 1]))
    photo = read(path)
    assert np.abs(photo.image_display - 255 * picture()).max() < 2.5
    assert photo.colours == ("Display P3 (converted to sRGB)",)


def test_gamma_and_chromaticities_of_png(tmp_path):
    path = tmp_path / "a.png"
    matrix = np.linalg.solve(np.array(COLORANTS["adobe"]), np.array(COLORANTS["srgb"]))
    values = np.clip(linear(picture()) @ matrix.T, 0, 1) ** (1 / 1.8)
    Image.fromarray(codes(values)).save(path)
    with_chunk(path, b"gAMA", struct.pack(">I", round(100000 / 1.8)))
    points = (31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000)
    with_chunk(path, b"cHRM", struct.pack(">8I", *points))
    assert np.abs(read(path).image_display - 255 * picture()).max() < 2.5


def test_hdr_codes_are_refused_by_name(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(codes(picture())).save(path)
    with_chunk(path, b"cICP", bytes([9, 16, 0, 1]))
    with pytest.raises(CaptureRefusedError, match=r"HDR codes \(PQ\)"):
        read(path)


def test_cameras_that_mark_adobe_rgb_by_exif(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    found = Image.fromarray(codes(in_space(picture(), "adobe")))
    found.save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
    photo = read(tmp_path / "a.jpg")
    assert np.abs(photo.image_display - 255 * picture()).mean() < 1.2
    assert "Adobe RGB" in photo.colours[0]


def test_heic_by_profile_and_by_code_points(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason="HEIC NOT TESTED: no pillow-heif")
    found = Image.fromarray(codes(in_space(picture(), "p3")))
    heif.from_pillow(found).save(
        tmp_path / "a.heic", quality=100, chroma=444, color_primaries=12,
        transfer_characteristics=13, save_nclx_profile=True,
    )  # fmt: skip
    found.info["icc_profile"] = profile("p3")
    heif.from_pillow(found).save(tmp_path / "b.heic", quality=100, chroma=444)
    for name in "ab":
        photo = read(tmp_path / f"{name}.heic")
        assert np.abs(photo.image_display - 255 * picture()).mean() < 2
        assert "converted" in photo.colours[0]


def test_cmyk_and_damaged_profiles(tmp_path):
    Image.fromarray(codes(picture())).save(tmp_path / "a.png", icc_profile=profile("p3")[:300])
    photo = read(tmp_path / "a.png")
    assert (photo.image_display == codes(picture())).all()
    assert photo.colours == ("a damaged colour profile (taken as sRGB)",)
    Image.fromarray(codes(picture())).convert("CMYK").save(
        tmp_path / "a.jpg", quality=100, icc_profile=profile("p3")
    )
    assert np.abs(read(tmp_path / "a.jpg").image_display - 255 * picture()).mean() < 3


def test_gain_maps_are_said(tmp_path):
    words = b'<x:xmpmeta xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0"/>'
    Image.fromarray(codes(picture())).save(tmp_path / "a.jpg", quality=95, xmp=words)
    assert "an HDR gain map (the base picture is taken)" in read(tmp_path / "a.jpg").colours


def exr(path: Path, values: np.ndarray, **header) -> None:
    channels = {"RGBA": np.ascontiguousarray(values, np.float16)}
    if values.shape[2] == 3:
        channels = {"RGB": channels["RGBA"]}
    OpenEXR.File(header | {"type": OpenEXR.scanlineimage}, channels).write(str(path))


def test_exr_is_linear(tmp_path):
    exr(tmp_path / "a.exr", linear(picture()))
    photo = read(tmp_path / "a.exr")
    assert photo.is_linear
    assert photo.colours == ("linear",)
    assert np.abs(photo.image_display - 255 * picture()).max() < 0.7
    brighter = read(tmp_path / "a.exr", exposure=0.5).image_display
    assert np.abs(brighter - 255 * curved(0.5 * linear(picture()))).max() < 0.7


def test_primaries_alpha_and_window_of_exr(tmp_path):
    matrix = np.linalg.solve(np.array(COLORANTS["p3"]), np.array(COLORANTS["srgb"]))
    alpha = np.linspace(0.2, 1.0, 64)[None, :, None] * np.ones((48, 1, 1))
    values = np.dstack([(linear(picture()) @ matrix.T) * alpha, alpha])
    points = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
    window = (np.array([0, 0], np.int32), np.array([79, 59], np.int32))
    exr(tmp_path / "a.exr", values, chromaticities=points, displayWindow=window)
    photo = read(tmp_path / "a.exr")
    assert photo.size == (80, 60)
    assert np.abs(photo.image_display[:48, :64] - 255 * picture()).max() < 1.5
    assert np.abs(photo.alpha[:48, :64] - 255 * alpha[:, :, 0]).max() < 1
    assert not photo.alpha[48:].any()


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_floating_tiff_is_linear(tmp_path, kind, compression):
    values = linear(picture()).astype(kind)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", compression=compression)
    photo = read(tmp_path / "a.tif")
    assert photo.is_linear
    assert np.abs(photo.image_display - 255 * picture()).max() < 0.7


def test_damaged_linear_pictures_are_refused(tmp_path):
    exr(tmp_path / "a.exr", linear(picture()))
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "b.exr").write_bytes(b"no picture")
    for name in ("a.exr", "b.exr", "c.exr"):
        with pytest.raises(CaptureRefusedError):
            read(tmp_path / name)


def linear_capture(root: Path, shots, gain: float) -> Path:
    """NeRF-synthetic with EXR photographs, `gain` times as bright."""
    writers.nerf_synthetic(root, shots)
    for path in (root / "train").glob("*.png"):
        rgba = np.asarray(Image.open(path), np.float64) / 255
        values = np.dstack([gain * linear(rgba[:, :, :3]) * rgba[:, :, 3:], rgba[:, :, 3:]])
        exr(path.with_suffix(".exr"), values)
        path.unlink()
    table = (root / "transforms_train.json").read_text()
    for i in range(len(shots)):
        table = table.replace(f'train/r_{i}"', f'train/r_{i}.exr"')
    (root / "transforms_train.json").write_text(table)
    return root


def test_a_linear_capture_needs_no_tone_curve(tmp_path, shots):
    plain = read_capture(writers.nerf_synthetic(tmp_path / "a", shots), None, CaptureConfig())
    assert not plain.is_linear
    assert with_known_curve(AppearanceConfig(), plain).families == FAMILIES
    bright = read_capture(linear_capture(tmp_path / "b", shots, 8.0), None, CaptureConfig())
    save_capture(tmp_path / "stored", bright)
    stored = load_capture(tmp_path / "stored")
    assert stored.is_linear
    assert with_known_curve(AppearanceConfig(), stored).families == ("standard",)
    told = next(finding for finding in bright.findings if finding.code == "colours")
    assert "8 linear, times 0.125 so that they do not clip" in told.message
    for one, other in zip(bright.views, plain.views, strict=True):
        inside = other.mask > 250
        error = one.image_display[inside].astype(int) - other.image_display[inside]
        assert np.abs(error).max() <= 1


def multiplied(rgba: np.ndarray) -> np.ndarray:
    colour = np.rint(rgba[:, :, :3] * (rgba[:, :, 3:] / 255.0))
    return np.dstack([colour, rgba[:, :, 3:]]).astype(np.uint8)


@pytest.mark.parametrize("dark", [1.0, 0.1])
def test_colours_multiplied_by_alpha(tmp_path, shots, dark):
    rgba = shots[0].rgba.copy()
    rgba[:, :, :3] = np.rint(dark * rgba[:, :, :3])
    Image.fromarray(rgba).save(tmp_path / "straight.png")
    Image.fromarray(multiplied(rgba)).save(tmp_path / "multiplied.png")
    one, other = read(tmp_path / "straight.png"), read(tmp_path / "multiplied.png")
    assert (one.image_display == rgba[:, :, :3]).all()
    assert "multiplied" in other.colours[1]
    inside = rgba[:, :, 3] > 60
    error = np.abs(other.image_display.astype(int) - one.image_display)[inside]
    assert error.max() <= 3
    assert error.mean() < 0.3


def test_profiles_differ_within_a_capture(tmp_path, shots):
    root = writers.nerf_synthetic(tmp_path / "a", shots)
    plain = read_capture(root, None, CaptureConfig())
    for path in sorted((root / "train").iterdir())[::2]:
        rgba = np.asarray(Image.open(path))
        colour = codes(in_space(rgba[:, :, :3] / 255, "p3"))
        found = Image.fromarray(np.dstack([colour, rgba[:, :, 3]]))
        found.save(path, icc_profile=profile("p3"))
    mixed = read_capture(root, None, CaptureConfig())
    (told,) = [finding for finding in mixed.findings if finding.code == "colours"]
    assert "4 p3 (converted to sRGB); 4 no colour profile" in told.message
    for one, other in zip(mixed.views, plain.views, strict=True):
        inside = other.mask > 250
        error = np.abs(one.image_display[inside].astype(int) - other.image_display[inside])
        assert error.max() <= 5


@pytest.mark.skipif(REPORTS is None, reason="REPORTS NOT TESTED: the folder reports is absent")
@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("a1_p3_jpeg", "a1_reference_srgb"),
        ("a2_adobergb_jpeg", "a1_reference_srgb"),
        ("a3_premultiplied_png", "a3_reference_straight"),
    ],
)
def test_reports_have_the_colour_of_their_references(name, reference):
    assert REPORTS is not None
    one, other = (read_capture(REPORTS / n, None, CaptureConfig()) for n in (name, reference))
    soft, chroma = [], []
    for view, truth in zip(one.views, other.views, strict=True):
        assert (view.mask == truth.mask).all()
        edge = (truth.mask > 40) & (truth.mask < 220)
        if edge.any():
            soft.append(view.image_display[edge].mean() - truth.image_display[edge].mean())
        pair = [linear(v.image_display[truth.mask > 250] / 255) for v in (view, truth)]
        chroma.append([(p.max(axis=1) - p.min(axis=1)).mean() for p in pair])
    assert not soft or abs(np.mean(soft)) < 1.5
    ratio = np.mean(chroma, axis=0)
    assert abs(ratio[0] / ratio[1] - 1) < 0.02
