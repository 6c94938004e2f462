# SPDX-License-Identifier: Apache-2.0
"""Videos whose headers lie, whose frames grow, and whose codec nobody knows."""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robir.capture.poses.sources import FRAMES, take_frames
from robir.errors import CaptureError

av = pytest.importorskip("av", reason="VIDEOS NOT TESTED: av is not installed")


def film(path: Path, count: int, codec: str = "mpeg4", side: int = 64) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=24)
        stream.width = stream.height = side
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        generator = np.random.default_rng(0)
        for _ in range(count):
            noise = generator.integers(0, 255, (side, side, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noise, format="rgb24")))
        container.mux(stream.encode())
    return path


def taken(video: Path) -> list[Path]:
    folder = video.with_name("frames")
    take_frames(video, folder, lambda *_: None)
    return sorted(folder.iterdir())


def test_spans_come_from_the_frames_there_are(tmp_path):
    """A header that claims a hundred thousand would make one span of them all."""
    video = film(tmp_path / "film.avi", 40)
    content = bytearray(video.read_bytes())
    for mark, offset in ((b"avih", 24), (b"strh", 40)):
        struct.pack_into("<I", content, content.index(mark) + offset, 100_000)
    video.write_bytes(content)
    assert len(taken(video)) == 40
    assert len(taken(film(tmp_path / "long.mp4", 250))) >= FRAMES


def test_codecs_that_nobody_knows_are_said(tmp_path):
    video = film(tmp_path / "film.mp4", 5, "libx264")
    video.write_bytes(video.read_bytes().replace(b"avc1", b"EVIL"))
    with pytest.raises(CaptureError, match="encoded in a way"):
        taken(video)


def test_frames_that_grow_are_refused(tmp_path):
    """JPEGs of 8000 by 8000 behind a first one of 64 by 64."""
    pictures = []
    for side in (64, 8000, 8000):
        file = io.BytesIO()
        Image.new("RGB", (side, side)).save(file, "JPEG")
        pictures.append(file.getvalue())
    video = tmp_path / "film.mkv"
    with av.open(str(video), "w") as container:
        stream = container.add_stream("mjpeg", rate=24)
        stream.width = stream.height = 64
        stream.pix_fmt = "yuvj420p"
        for number, content in enumerate(pictures):
            packet = av.Packet(content)
            packet.stream, packet.pts, packet.dts = stream, number, number
            packet.time_base = Fraction(1, 24)
            container.mux(packet)
    with pytest.raises(CaptureError, match="damaged or cannot be decoded"):
        taken(video)
    huge = film(tmp_path / "huge.mkv", 1, "mjpeg", 6400)
    with pytest.raises(CaptureError, match="huge frames"):
        taken(huge)
