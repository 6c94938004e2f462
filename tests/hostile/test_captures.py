# SPDX-License-Identifier: Apache-2.0
"""Captures that are hostile or broken: refused in words, nothing started, nothing written."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from capture import app_writers, writers
from PIL import Image

from robir import cli
from robir.capture.config import CaptureConfig
from robir.capture.images.decode import exif_values, header
from robir.capture.recognise import check_capture, read_frames
from robir.errors import CaptureError
from robir.pipeline.ledger import capture_fingerprint

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 48 48\n%%EndComments\nshowpage\n"


def refused(source: Path, config: CaptureConfig | None = None) -> str:
    """All errors of a capture that is refused, after its contents were hashed as a run does."""
    capture_fingerprint(source, None, source / "out")
    capture, findings, _ = check_capture(source, None, config or CaptureConfig())
    assert capture is None
    return "\n".join(f"{finding.code}: {finding.message}" for finding in findings)


def png(width: int, height: int, rows: bytes = b"") -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + check

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.fixture
def synthetic(shots, tmp_path) -> Path:
    return writers.nerf_synthetic(tmp_path / "capture", shots)


@pytest.fixture
def studio(odd_shots, tmp_path) -> Path:
    return writers.nerfstudio(tmp_path / "capture", odd_shots)


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def encoded(kind: str, mode: str = "RGB") -> bytes:
    file = BytesIO()
    Image.new(mode, (48, 48)).save(file, kind)
    return file.getvalue()


def test_a_photograph_starts_no_program(synthetic, monkeypatch):
    def started(*words, **options):
        raise AssertionError(f"a program was started: {words}")

    monkeypatch.setattr(subprocess, "Popen", started)
    monkeypatch.setattr(os, "system", started)
    (synthetic / "train/r_3.png").write_bytes(POSTSCRIPT)
    assert "r_3.png is not a photograph" in refused(synthetic)


@pytest.mark.parametrize("kind", ["GIF", "PPM", "TGA", "PCX", "ICO", "DDS", "PDF", "SGI"])
def test_other_formats_are_not_even_asked(synthetic, kind):
    (synthetic / "train/r_3.png").write_bytes(encoded(kind))
    assert "r_3.png is not a photograph" in refused(synthetic)


@pytest.mark.parametrize("size", [(13377, 13377), (178_000_000, 1), (20_000, 20_000), (9000, 9000)])
def test_pictures_too_large_are_not_decoded(synthetic, size):
    (synthetic / "train/r_3.png").write_bytes(png(*size))
    start = time.process_time()
    message = refused(synthetic)
    assert "r_3.png" in message
    assert f"{size[0]}x{size[1]}" in message or "exceeds limit" in message
    assert time.process_time() - start < 5


def test_a_photograph_of_terabytes_is_not_even_hashed(shots, tmp_path):
    writers.save_pictures(tmp_path, shots[:3], [f"{i}.jpg" for i in range(3)], alpha=False)
    with (tmp_path / "a.png").open("wb") as file:
        file.truncate(1 << 40)
    start = time.process_time()
    assert refused(tmp_path)
    assert time.process_time() - start < 10


@pytest.mark.parametrize("tag", [273, 34665])
def test_a_tiff_of_a_million_strips(synthetic, tag):
    """Pillow makes a number of each, several times; a file of a gigabyte takes all memory."""
    entry = struct.pack("<HHII", 273, 4, 10**6, 200)
    exif = struct.pack("<HHII", 34665, 4, 1, 26) + bytes(4) + struct.pack("<H", 1)
    content = b"II*\0" + struct.pack("<IH", 8, 1) + (exif if tag == 34665 else b"") + entry
    for path in (synthetic / "train").iterdir():
        path.write_bytes(content + bytes(4_000_400))
    start = time.process_time()
    assert "its entry StripOffsets has 1000000 numbers" in refused(synthetic)
    assert time.process_time() - start < 5


def test_exif_data_without_end_counts_as_absent(synthetic):
    data = b"Exif\0\0II*\0" + struct.pack("<IHHHII", 8, 1, 272, 4, 10**6, 26) + bytes(4_000_100)
    path = synthetic / "train/r_3.png"
    Image.new("RGBA", (48, 48)).save(path, exif=data)
    with header(path) as picture:
        assert exif_values(picture) is None


def test_a_jpeg_of_endless_passes(synthetic):
    file = BytesIO()
    Image.new("L", (4000, 4000)).save(file, "JPEG", progressive=True)
    content = file.getvalue()
    first = content.index(b"\xff\xda")
    scan = content[first : content.index(b"\xff\xda", first + 2)]
    (synthetic / "train/r_3.png").write_bytes(content[:-2] + 400 * scan + b"\xff\xd9")
    assert "passes" in refused(synthetic)


SPECIAL = {
    "folder": lambda path: path.mkdir(),
    "pipe": os.mkfifo,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path.name),
    "nowhere": lambda path: path.symlink_to("nowhere"),
}
FILES = ("transforms_train.json", "train/r_3.png")


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", SPECIAL)
def test_only_regular_files_are_opened(synthetic, name, kind):
    (synthetic / name).unlink()
    SPECIAL[kind](synthetic / name)
    assert refused(synthetic)


@pytest.mark.parametrize("kind", SPECIAL)
@pytest.mark.parametrize("name", ["a.json", "a.png", "a.npz", "a.csv", "a.xml", "cameras.npz"])
def test_what_lies_beside_photographs_is_looked_at_with_care(shots, tmp_path, name, kind):
    writers.save_pictures(tmp_path, shots[:3], [f"{i}.jpg" for i in range(3)], alpha=False)
    SPECIAL[kind](tmp_path / name)
    with pytest.raises(CaptureError):
        read_frames(tmp_path)
    capture_fingerprint(tmp_path, None, tmp_path / "out")


def test_a_link_to_the_root_is_not_followed(synthetic):
    (synthetic / "all").symlink_to("/")
    (synthetic / "self").symlink_to(".")
    start = time.process_time()
    capture_fingerprint(synthetic, None, synthetic / "out")
    assert time.process_time() - start < 2


def test_photographs_elsewhere_are_taken_only_if_told(studio, tmp_path):
    (studio / "images").rename(tmp_path / "elsewhere")

    def change(content):
        for frame in content["frames"]:
            frame["file_path"] = str(tmp_path / "elsewhere" / Path(frame["file_path"]).name)

    edit(studio / "transforms.json", change)
    message = refused(studio)
    assert "outside" in message
    assert "8 photographs or masks lie outside" in message
    assert len(read_frames(studio, "take").frames) == 8


@pytest.mark.parametrize("what", ["images", "mattes"])
def test_links_out_of_the_capture_are_followed_only_if_told(studio, tmp_path, what):
    (studio / what).rename(tmp_path / "elsewhere")
    (studio / what).symlink_to(tmp_path / "elsewhere")
    assert "lie outside" in refused(studio)
    told = CaptureConfig(outside="take")
    assert check_capture(studio, None, told)[0] is not None


def test_a_pose_file_may_be_a_link(studio, tmp_path):
    (studio / "transforms.json").rename(tmp_path / "poses.json")
    (studio / "transforms.json").symlink_to(tmp_path / "poses.json")
    assert len(read_frames(studio).frames) == 8


def test_pose_files_of_gigabytes_are_not_read(studio, odd_shots, tmp_path):
    """Those of COLMAP, in which every observation stands, may be larger."""
    model = writers.colmap(tmp_path / "colmap", odd_shots, binary=True)
    cases = ((studio, "transforms.json", 1 << 28), (model, "sparse/0/images.bin", 1 << 29))
    for source, name, most in cases:
        with (source / name).open("r+b") as hole:
            hole.truncate(most + 1)
        with pytest.raises(CaptureError, match=f"at most {most} are read"):
            read_frames(source)


@pytest.mark.parametrize("name", ["/", "a\0b", "\ud800", "x" * 300, "d/" * 3000, "..", "  ", "²"])
def test_names_that_are_none(studio, name):
    edit(studio / "transforms.json", lambda c: c["frames"][2].update(file_path=name))
    assert refused(studio)
    edit(studio / "transforms.json", lambda c: c["frames"][2].update(file_path="images/x.png"))
    edit(studio / "transforms.json", lambda c: c["frames"][3].update(mask_path=name))
    assert refused(studio)


def test_names_on_the_disk_that_are_no_text(odd_shots, tmp_path, capsys):
    writers.neus(tmp_path, odd_shots)
    folder = os.fsencode(tmp_path / "image")
    os.rename(folder + b"/000003.png", folder + b"/\xff\xfe.png")  # noqa: PTH104
    assert cli.main(["check", str(tmp_path), "--progress", "plain"]) == 3
    assert "no valid text" in capsys.readouterr().out


@pytest.mark.parametrize("value", [None, "x", [None], [3], {"a": 1}])
def test_lists_of_test_views(studio, value):
    edit(studio / "transforms.json", lambda content: content.update(test_filenames=value))
    if value is None:
        assert len(read_frames(studio).frames) == 8
    else:
        assert "test_filenames" in refused(studio)


def test_numbers_of_four_hundred_digits(studio):
    edit(studio / "transforms.json", lambda c: c.update(fl_x=10**400))
    assert '"fl_x"' in refused(studio)


BAD_ARRAYS = {
    "structured": np.zeros(8, dtype=[("a", "f8", 17)]),
    "text": np.full((8, 17), "1.5"),
    "complex": np.ones((8, 17)) * 1j,
    "dates": np.zeros((8, 17), "M8[s]"),
    "flat": np.zeros(136),
}


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_arrays_that_are_no_numbers(odd_shots, tmp_path, name):
    writers.llff(tmp_path, odd_shots, numeric=True)
    np.save(tmp_path / "poses_bounds.npy", BAD_ARRAYS[name])
    assert "poses_bounds.npy" in refused(tmp_path)
    writers.neus(tmp_path / "neus", odd_shots)
    matrices = {f"world_mat_{i}": BAD_ARRAYS[name] for i in range(8)}
    np.savez(tmp_path / "neus/cameras_sphere.npz", **matrices)
    assert "cameras_sphere.npz" in refused(tmp_path / "neus")


def test_an_archive_that_unpacks_to_gigabytes(odd_shots, tmp_path):
    writers.neus(tmp_path, odd_shots)
    header = BytesIO()
    facts = {"descr": "<f8", "fortran_order": False, "shape": (1 << 27, 4)}
    np.lib.format.write_array_header_1_0(header, facts)
    with (
        zipfile.ZipFile(tmp_path / "cameras_sphere.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("world_mat_0.npy", "w", force_zip64=True) as member,
    ):
        member.write(header.getvalue())
        for _ in range(64):
            member.write(bytes(1 << 20))
    start = time.process_time()
    assert "impossible size" in refused(tmp_path)
    assert time.process_time() - start < 2


def test_entities_of_xml_are_refused(odd_shots, tmp_path):
    path = app_writers.metashape(tmp_path, odd_shots) / "cameras.xml"
    text = path.read_text()
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]>' + text[text.index("<document") :])
    assert "document type" in refused(tmp_path)


def test_json_that_would_not_fit_into_memory(studio):
    (studio / "transforms.json").write_text('{"frames": [' + "{}," * 4_000_000 + "{}]}")
    start = time.process_time()
    assert "too many values" in refused(studio)
    assert time.process_time() - start < 5


@pytest.mark.parametrize("kind", ["many", "one"])
def test_time_is_linear_in_the_number_of_frames(studio, kind):
    """5,000 frames of one photograph, or of as many that are missing."""

    def change(content):
        first = content["frames"][0]
        names = [f"images/{i if kind == 'many' else 0}.png" for i in range(5_000)]
        content["frames"] = [first | {"file_path": name} for name in names]

    edit(studio / "transforms.json", change)
    start = time.process_time()
    assert "5000" in refused(studio) or kind == "one"
    assert time.process_time() - start < 5


def test_more_photographs_than_can_be_read(studio):
    def change(content):
        content["frames"] = [dict(content["frames"][0], file_path=f"{i}.png") for i in range(2001)]

    edit(studio / "transforms.json", change)
    assert "There are 2001 photographs; at most 2000 are read" in refused(studio)


def test_more_photographs_than_poses_can_be_found_for(tmp_path):
    for number in range(2001):
        (tmp_path / f"{number}.jpg").touch()
    assert "There are 2001 photographs; at most 2000 are read" in refused(tmp_path)


@pytest.mark.parametrize(
    "lens",
    [
        {"fl_y": 1.06e-314},
        {"fl_x": 1e-9},
        {"camera_angle_x": 1e-310},
        {"camera_angle_x": 3.1415926},
    ],
)
def test_lenses_that_no_camera_has(studio, lens):
    """The rays of a focal length of almost nothing are no numbers."""

    def change(content):
        if "camera_angle_x" in lens:
            del content["fl_x"], content["fl_y"]
        content.update(lens)

    edit(studio / "transforms.json", change)
    assert "a focal length or field of view that no camera has" in refused(studio)


def test_a_film_that_is_a_list_of_other_files(tmp_path):
    pytest.importorskip("av")
    from robir.capture.poses.sources import take_frames

    film = tmp_path / "film.mp4"
    for content in (b"#EXTM3U\n#EXTINF:5,\n/etc/passwd\n#EXT-X-ENDLIST\n", b"ffconcat version 1.0"):
        film.write_bytes(content)
        with pytest.raises(CaptureError, match="damaged"):
            take_frames(film, tmp_path / "frames", lambda share, text: None)
    film.unlink()
    os.mkfifo(film)
    with pytest.raises(CaptureError):
        read_frames(film)


def test_nothing_but_robir_runs_a_program_for_check(synthetic, tmp_path):
    """The audit hook of Python sees every program that is started and every file written."""
    program = f"""
import sys
from robir import cli
import robir.capture.recognise, robir.capture.masks.unmasked, PIL.Image
PIL.Image.init()
def hook(event, arguments):
    if event in ("subprocess.Popen", "os.exec", "os.posix_spawn", "os.system", "os.fork"):
        print("STARTED", event, arguments)
    elif event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        print("WROTE", arguments)
sys.addaudithook(hook)
sys.exit(cli.main(["check", {str(synthetic)!r}, "--progress", "plain"]))
"""
    (synthetic / "train/r_2.png").write_bytes(POSTSCRIPT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 3, done.stderr
    assert "STARTED" not in done.stdout
    assert "WROTE" not in done.stdout
