# SPDX-License-Identifier: Apache-2.0
"""Frames of a video: the sharpest of each of a hundred equal spans of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from robir.capture.capture import Finding
from robir.capture.images.decode import INSTALL_PHOTOS
from robir.capture.images.regular import regular
from robir.capture.refusal import note, refuse
from robir.capture.views import Progress
from robir.jobs.paths import replacing

FRAMES = 100  # frames taken from a video at most
# longer side in pixels of the picture that sharpness is measured on: noise must not count
SHARPNESS_SIDE = 480
MAX_BYTES = 1 << 35  # largest video
# largest frame, a little more than 8K: decoders keep up to sixteen of them
MAX_FRAME_PIXELS = 36_000_000
_CONTAINERS: dict[str, str] = {
    **dict.fromkeys((".mp4", ".mov", ".m4v", ".3gp"), "mov"),
    **dict.fromkeys((".mkv", ".webm"), "matroska"),
    ".avi": "avi",
}

_EXCLUDED = "Save it as MP4 (H.264), or give its frames as photographs."


@dataclass(frozen=True, slots=True)
class _Best:
    """The sharpest frame of a span so far."""

    sharpness: float
    number: int
    frame: Any


def take_frames(video: Path, folder: Path, progress: Progress) -> list[Finding]:
    """Write the sharpest frames of a video as pictures, upright.

    Args:
        video: File.
        folder: Where the frames go, named frame_NUMBER.png; frames that are there count as done.
        progress: Told while the video is read.

    Returns:
        A note on what was taken.

    Raises:
        CaptureError: If the video cannot be read.
    """
    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        raise refuse(
            "missing-reader",
            f"{video} is a video, which needs the package av",
            f"{INSTALL_PHOTOS}; or give its frames as photographs.",
            video.name,
        ) from None
    folder.mkdir(parents=True, exist_ok=True)
    taken: list[_Best] = []
    try:
        # By its suffix alone: what FFmpeg tells from the content may be a list of other files.
        kind = _CONTAINERS[video.suffix.lower()]
        with regular(video, MAX_BYTES) as file, av.open(file, format=kind) as container:
            if not container.streams.video:
                raise refuse("bad-video", f"{video} holds no pictures", _EXCLUDED, video.name)
            codec = container.streams.video[0].codec_context
            if codec is None:
                raise refuse(
                    "bad-video",
                    f"{video} is encoded in a way that the package av does not know",
                    _EXCLUDED,
                    video.name,
                )
            if codec.width * codec.height > MAX_FRAME_PIXELS:
                raise refuse("bad-video", f"{video} has huge frames", _EXCLUDED, video.name)
            # of every frame: later ones may be larger than the first
            codec.options = {"max_pixels": str(MAX_FRAME_PIXELS)}
            for best in _sharpest(container, _frame_count(container), progress):
                taken.append(best)
                _write(best.frame, folder / f"frame_{best.number:06d}.png")
    except (FFmpegError, OSError, ValueError) as fault:
        raise refuse(
            "bad-video", f"{video} is damaged or cannot be decoded ({fault})", _EXCLUDED, video.name
        ) from None
    message = f"{len(taken)} frames of {video.name} were taken, the sharpest of each span of time"
    return [note("video-frames", message)]


def sharpness(grey: NDArray[np.uint8]) -> float:
    """How sharp a picture is: variance of its Laplacian, over that of the picture itself.

    Args:
        grey: (H, W) display values.

    Returns:
        A number without unit that falls with blur and does not change with contrast.
    """
    values = grey.astype(np.float32)
    return float(ndimage.laplace(values).var() / (values.var() + 1.0))


def _frame_count(container: Any) -> int:
    """Frames that a video has, whatever its header claims, at least one; none is decoded."""
    count = sum(packet.size > 0 for packet in container.demux(video=0))
    container.seek(0)
    return max(1, count)


def _sharpest(container: Any, total: int, progress: Progress) -> Iterator[_Best]:
    """The sharpest frame of each span, in order."""
    span = max(1.0, total / FRAMES)
    best: _Best | None = None
    current = 0
    for number, frame in enumerate(container.decode(video=0)):
        if int(number / span) != current and best is not None:
            yield best
            best, current = None, int(number / span)
        score = sharpness(_grey(frame))
        if best is None or score > best.sharpness:
            best = _Best(score, number, frame)
        if number % 10 == 0:
            progress(min(1.0, number / total), f"frame {number} of {total}")
    if best is not None:
        yield best


def _grey(frame: Any) -> NDArray[np.uint8]:
    scale = min(1.0, SHARPNESS_SIDE / max(frame.width, frame.height))
    # Even sizes: codecs and their converters know no other.
    width, height = (2 * max(1, round(side * scale / 2)) for side in (frame.width, frame.height))
    return frame.reformat(width=width, height=height, format="gray").to_ndarray()


def _write(frame: Any, path: Path) -> None:
    picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
    # Phones store pictures as the sensor lies and note how far to turn them, counter-clockwise.
    if frame.rotation % 360:
        picture = picture.rotate(frame.rotation, expand=True)
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=1)
