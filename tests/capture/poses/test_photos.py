# SPDX-License-Identifier: Apache-2.0
"""Which files count as photographs, what EXIF says of the lens, other kinds of files, and pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from capture.poses.room import photograph, ring
from PIL import Image
from scipy import ndimage

from robir.capture.images.decode import exif_values, opened, orientation, upright
from robir.capture.images.loading import Photo, open_photo
from robir.capture.poses.register import prepare
from robir.capture.poses.sfm import all_pairs, sequence_pairs
from robir.capture.poses.sources import FRAMES, find_photographs, lens_of, sharpness, take_frames
from robir.capture.refusal import CaptureRefusedError
from robir.pipeline.ledger import capture_fingerprint


def unheard(share: float, text: str) -> None:
    del share, text


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_photographs_are_found_where_people_keep_them(tmp_path: Path):
    touch(tmp_path, "a/IMG_10.JPG", "a/IMG_9.heic", "a/.hidden.jpg", "a/masks/IMG_9.png", "a/x.txt")
    assert [p.name for p in find_photographs(tmp_path / "a")] == ["IMG_9.heic", "IMG_10.JPG"]
    touch(tmp_path, "b/images/1.tif", "b/edited/1.tif", "b/mask/1.png")
    assert find_photographs(tmp_path / "b") == [tmp_path / "b/images/1.tif"]
    touch(tmp_path, "c/phone/1.jpg", "c/camera/1.nef", "c/segmentation/1.png")
    assert len(find_photographs(tmp_path / "c")) == 2


@pytest.mark.parametrize(
    ("exif", "focal"),
    [
        # 26 mm equivalent on 4000x3000: the diagonal of 5000 pixels stands for 43.27 mm.
        ({0xA405: 26}, 26 / 43.2666 * 5000 / 4000),
        # 18 mm on a sensor of 23.5 mm, by 6000 pixels over it.
        ({0x920A: 18.0, 0xA20E: 6000 / 2.35, 0xA210: 3, 0xA002: 6000}, 18 / 23.5),
        ({0x920A: 18.0}, None),
        ({0xA405: 0, 0x920A: float("nan")}, None),
        ({0xA405: "wide", 0x010F: b"\xff"}, None),
        ({}, None),
    ],
)
def test_focal_length_of_exif(exif, focal):
    found = lens_of(exif, (4000, 3000)).focal
    assert found is None if focal is None else found == pytest.approx(focal, rel=1e-4)


def read_photo(
    path: Path, declared: tuple[int, int] | None, is_upright: bool | None = None
) -> Photo:
    with open_photo(path, declared, is_upright) as stored:
        return stored.read()


@pytest.mark.parametrize("turn", range(1, 9))
def test_orientation_is_applied_once(tmp_path: Path, turn: int):
    """Against Pillow's own way of doing it."""
    from PIL import ImageOps

    picture = np.random.default_rng(turn).integers(0, 256, (6, 9, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = turn
    path = tmp_path / "turned.png"
    Image.fromarray(picture).save(path, exif=exif)
    with opened(path) as stored:
        assert orientation(stored) == turn
        ours = np.array(upright(stored, turn))
        assert np.array_equal(ours, np.array(ImageOps.exif_transpose(stored)))
    # A half turn keeps the size: only what the pose is for can tell.
    assert np.array_equal(read_photo(path, (9, 6), is_upright=True).image_display, ours)
    if turn <= 4:
        assert np.array_equal(read_photo(path, (9, 6)).image_display, picture)


def test_heic_is_upright(tmp_path: Path):
    pillow_heif = pytest.importorskip("pillow_heif", reason="HEIC NOT TESTED: no pillow-heif")
    picture, _ = photograph(ring(1)[0])
    exif = Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769)[0xA405] = 28
    turned = Image.fromarray(picture).transpose(Image.Transpose.ROTATE_90)
    path = tmp_path / "IMG_1.HEIC"
    pillow_heif.from_pillow(turned).save(path, quality=95, exif=exif.tobytes())
    photo = read_photo(path, None)
    assert photo.size == (320, 240)
    assert np.abs(photo.image_display.astype(float) - picture).mean() < 6
    with opened(path) as stored:
        assert lens_of(exif_values(stored) or {}, stored.size).focal is not None


def write_dng(path: Path, mosaic: np.ndarray, pattern: tuple[int, ...] = (0, 1, 1, 2)) -> None:
    """A linear sensor of 16 bits, RGGB if nothing else is said, as a minimal DNG."""
    import tifffile

    matrix = [32406, 10000, -15372, 10000, -4986, 10000, -9689, 10000, 18758, 10000, 415, 10000,
              557, 10000, -2040, 10000, 10570, 10000]  # fmt: skip
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNG version
        (50708, "s", 0, "Test", True),  # camera
        (33421, "H", 2, (2, 2), True),  # pattern's size
        (33422, "B", 4, pattern, True),
        (50714, "H", 1, 0, True),  # black
        (50717, "H", 1, 65535, True),  # white
        (50721, "2i", 9, matrix, True),  # sensor from XYZ
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # neutral
        (50778, "H", 1, 21, True),  # D65
        (274, "H", 1, 6, True),  # to be turned
    ]
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None)


def test_raw_is_developed_upright_at_half_its_size(tmp_path: Path):
    pytest.importorskip("rawpy", reason="RAW NOT TESTED: no rawpy")
    mosaic = np.full((256, 384), 4000, np.uint16)
    mosaic[:40] = 40000
    write_dng(tmp_path / "a.dng", mosaic)
    photo = read_photo(tmp_path / "a.dng", None)
    width, height = photo.size
    assert abs(width - 128) <= 4
    assert abs(height - 192) <= 4
    # Turned clockwise, the bright top is on the right.
    assert photo.image_display[:, -8:].mean() > 2 * photo.image_display[:, :8].mean()
    # Values are linear but for sRGB's curve: ten times the light.
    values = ((photo.image_display[:, :, 1] / 255 + 0.055) / 1.055) ** 2.4
    ratio = np.median(values[:, -8:]) / np.median(values[:, :8])
    assert ratio == pytest.approx(10, rel=0.03)
    assert photo.is_linear
    (tmp_path / "b.dng").write_bytes(b"II*\0torn")
    with pytest.raises(CaptureRefusedError, match="truncated or damaged"):
        read_photo(tmp_path / "b.dng", None)


def test_raw_of_a_sensor_without_colours_is_grey(tmp_path: Path):
    pytest.importorskip("rawpy", reason="RAW NOT TESTED: no rawpy")
    mosaic = np.full((64, 96), 20000, np.uint16)
    write_dng(tmp_path / "grey.dng", mosaic, pattern=(0, 0, 0, 0))
    photo = read_photo(tmp_path / "grey.dng", None)
    assert photo.image_display.shape[2] == 3
    assert (photo.image_display == photo.image_display[:, :, :1]).all()


def test_sharpness_knows_blur_and_not_contrast():
    grey = photograph(ring(1)[0])[0].mean(axis=2)
    blurred = ndimage.gaussian_filter(grey, 1.5)
    assert sharpness(blurred.astype(np.uint8)) < 0.5 * sharpness(grey.astype(np.uint8))
    faint = (100 + 0.4 * grey).astype(np.uint8)
    assert sharpness(faint) == pytest.approx(sharpness(grey.astype(np.uint8)), rel=0.1)


def test_the_sharp_frames_of_a_video_are_taken(tmp_path: Path):
    """Two frames a span, the second of each blurred; their order in the span does not matter."""
    av = pytest.importorskip("av", reason="VIDEO NOT TESTED: no av")
    picture, _ = photograph(ring(1)[0])
    blurred = ndimage.gaussian_filter(picture, (2, 2, 0))
    video = tmp_path / "walk.mp4"
    with av.open(str(video), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = (
            320,
            240,
            "yuv420p",
            8_000_000,
        )
        for i in range(2 * FRAMES):
            is_sharp = (i % 2 == 0) ^ (i % 6 > 3)
            frame = av.VideoFrame.from_ndarray(picture if is_sharp else blurred, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    (note,) = take_frames(video, tmp_path / "frames", unheard)
    assert f"{FRAMES} frames of walk.mp4" in note.message
    numbers = [int(path.stem.split("_")[1]) for path in sorted((tmp_path / "frames").iterdir())]
    assert len(numbers) == FRAMES
    wrong = sum(not ((i % 2 == 0) ^ (i % 6 > 3)) for i in numbers)
    assert wrong <= FRAMES // 20
    assert capture_fingerprint(video, None, tmp_path) != capture_fingerprint(
        tmp_path / "frames", None, tmp_path
    )
    (tmp_path / "torn.mp4").write_bytes(video.read_bytes()[:200])
    with pytest.raises(CaptureRefusedError, match="damaged or cannot be decoded"):
        take_frames(tmp_path / "torn.mp4", tmp_path / "none", unheard)


def test_lenses_are_told_apart(tmp_path: Path):
    pixels = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    for i in range(9):
        exif = Image.Exif()
        if i < 6:
            exif[0x0110] = ("Phone", "Camera")[i % 2]
            exif.get_ifd(0x8769)[0xA405] = (26, 50)[i % 2]
        shape = pixels if i < 7 else pixels.swapaxes(0, 1)
        Image.fromarray(np.ascontiguousarray(np.roll(shape, i, axis=0))).save(
            tmp_path / f"{i}.png", exif=exif
        )
    entries, _ = prepare(tmp_path, sorted(tmp_path.iterdir()), tmp_path / "copies", unheard)
    assert [entry.lens for entry in entries] == [0, 1, 0, 1, 0, 1, 2, 3, 3]
    assert entries[1].focal == pytest.approx(50 / 43.2666 * 40, rel=1e-4)
    assert entries[6].focal is None


def test_pairs_are_complete_and_a_sequence_closes_its_loop():
    names = [f"{i:04d}" for i in range(30)]
    pairs = [pair for portion in all_pairs(names) for pair in portion]
    assert len(pairs) == len({frozenset(pair) for pair in pairs}) == 30 * 29 // 2
    names = [f"{i:04d}" for i in range(200)]
    pairs = {pair for portion in sequence_pairs(names) for pair in portion}
    assert all((names[i], names[i + 1]) in pairs for i in range(199))
    assert len(pairs) < 200 * 199 / 4
    assert any(int(a) < 20 and int(b) > 180 for a, b in pairs)
