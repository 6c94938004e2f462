# SPDX-License-Identifier: Apache-2.0
"""From posed files to views: choosing what is held out, reading one photograph at a time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.capture import Finding, Split, View
from robir.capture.config import CaptureConfig
from robir.capture.frames import Frame, FrameSet
from robir.capture.images.decode import header, stored_size
from robir.capture.images.linear import LINEAR, common_exposure
from robir.capture.images.reading import MaskSource, Reading, read_view
from robir.capture.refusal import CaptureRefusedError, grouped, note, refuse, some
from robir.capture.support import Plane
from robir.workers import blocks, side_by_side

HARMLESS_PIXELS = 16_000_000  # decoded in a second, whatever the others have
MAX_RATIO = 16  # times the pixels of a capture's usual photograph that one may have
Array = NDArray[np.float64]

_HELD_OUT_EVERY = 8  # of how many photographs one is held out, where a capture brings no test views
_MAX_HELD_OUT = 8

_TOGETHER = 8  # photographs between two reports of progress
_AT_ONCE = 4  # of these, read at a time: each takes ten times its pixels' bytes and more

Progress = Callable[[float, str], None]  # told the share of the work done, in [0, 1], and what


def unheard(fraction: float, message: str) -> None:
    """A `Progress` that nobody listens to."""
    del fraction, message


@dataclass(frozen=True, slots=True, kw_only=True)
class Loaded:
    """Photographs that could be read."""

    views: tuple[View, ...]  # in the order of the frames; a view without a mask has a full one
    maskless: tuple[str, ...]  # names of the views without a mask
    findings: tuple[Finding, ...]  # one error a photograph that could not be read, and notes
    table: Plane | None = None  # what guessed masks found that the object stands on
    is_linear: bool = False  # whether no photograph went through a tone curve but sRGB's


def without_left_out(frames: FrameSet, config: CaptureConfig) -> FrameSet:
    """The photographs to work with, without those of `leave_out` and missing ones, and findings."""
    unwanted = set(config.leave_out)
    chosen = [frame for frame in frames.frames if unwanted & {frame.name, frame.relative}]
    known = {name for frame in chosen for name in (frame.name, frame.relative)}
    skips = config.missing == "skip"
    missing = [f for f in frames.frames if skips and f.name not in known and not f.image.is_file()]
    message = f"{len(chosen)} photographs are left out as the settings say"
    found = some("note", "left-out", [frame.name for frame in chosen], message)
    message, cure = "Photographs to leave out are not in the capture", "Name them as findings do."
    found += some("warning", "unknown-photographs", sorted(unwanted - known), message, cure)
    message = f"{len(missing)} of {len(frames.frames)} posed photographs are missing and left out"
    cure = "Put them below the capture's folder to have them used."
    names = [frame.relative for frame in missing]
    found += some("warning", "missing-skipped", names, message, cure)
    gone = {frame.name for frame in (*chosen, *missing)}
    return replace(
        frames,
        frames=tuple(f for f in frames.frames if f.name not in gone),
        other_order=tuple(f for f in frames.other_order if f.name not in gone),
        findings=(*frames.findings, *found),
    )


def splits(frames: Sequence[Frame], config: CaptureConfig) -> list[tuple[Frame, Split]]:
    """Which frames are read, and which only judge.

    Test views of the format are thinned evenly; without any, every eighth view is held out, at
    least one of four. With a `held_out_sector` all training views in that sector judge instead.
    """
    tests = [i for i, frame in enumerate(frames) if frame.split == "test"]
    trains = [i for i, frame in enumerate(frames) if frame.split == "train"]
    if config.held_out_sector:
        inside = _in_sector([frames[i].camera_to_world for i in trains], config.held_out_sector)
        hidden = [i for i, is_inside in zip(trains, inside, strict=True) if is_inside]
        held_out = _thinned(hidden)
        trains = [i for i in trains if i not in hidden]
    elif tests:
        held_out = _thinned(tests)
    else:
        held_out = _thinned(trains[_HELD_OUT_EVERY // 2 :: _HELD_OUT_EVERY])
        if not held_out and len(trains) >= 4:
            held_out = [trains[len(trains) // 2]]
    kept = sorted({*trains, *held_out})
    return [(frames[i], "held_out" if i in held_out else "train") for i in kept]


def _in_sector(poses: Sequence[Array], width: float) -> NDArray[np.bool_]:
    """Which cameras (4, 4) stand in the sector about the middle one, seen from above the object."""
    matrices = np.asarray(poses, np.float64)
    centres, axes = matrices[:, :3, 3], -matrices[:, :3, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    meeting = np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, centres), rcond=None)[0]
    up = matrices[:, :3, 1].mean(0)
    up /= max(np.linalg.norm(up), 1e-9)
    out = centres - meeting
    out -= (out @ up)[:, None] * up
    middle = out[len(out) // 2]
    cosine = out @ middle / np.maximum(np.linalg.norm(out, axis=1) * np.linalg.norm(middle), 1e-12)
    return np.arccos(cosine.clip(-1, 1)) <= np.radians(width / 2)


def _thinned(indices: list[int]) -> list[int]:
    count = min(len(indices), _MAX_HELD_OUT)
    return [indices[i] for i in np.linspace(0, len(indices) - 1, count).round().astype(int)]


def load_views(
    chosen: Sequence[tuple[Frame, Split]],
    masks: Mapping[str, Path | MaskSource],
    max_side: int,
    progress: Progress,
) -> Loaded:
    """Read photographs with `masks` by frame name or their own, cut and reduced to `max_side`."""
    readings, findings = [], []
    sizes = [frame.lens.size or stored_size(frame.image) for frame, _ in chosen]
    pixels = [width * height for width, height in filter(None, sizes)]
    most = max(HARMLESS_PIXELS, MAX_RATIO * float(np.median(pixels)) if pixels else 0.0)
    exposure = _exposure([frame for frame, _ in chosen])

    def read(pair: tuple[Frame, Split]) -> Reading | CaptureRefusedError:
        frame, split = pair
        try:
            _refuse_odd_size(frame, most)
            return read_view(frame, split, masks.get(frame.name), max_side, exposure)
        except CaptureRefusedError as refusal:
            return refusal

    for part in blocks(len(chosen), _TOGETHER):
        with warnings.catch_warnings():  # decoders change the filters that threads share
            warnings.simplefilter("ignore")
            found = side_by_side(read, chosen[part], _AT_ONCE)
        for one in found:
            if isinstance(one, CaptureRefusedError):
                findings.extend(one.findings)
            else:
                readings.append(one)
        progress(part.stop / len(chosen), f"reading {chosen[part.stop - 1][0].name}")
    turned = [reading.view.name for reading in readings if reading.is_turned]
    message = f"{len(turned)} photographs were turned upright as their EXIF data says"
    findings += some("note", "exif-orientation", turned, message)
    findings += _about_colours(readings, exposure)
    if any(not frame.lens.distortion.is_null for frame, _ in chosen):
        findings.append(note("undistorted", "Lens distortion was taken out of the photographs"))
    return Loaded(
        views=tuple(reading.view for reading in readings),
        maskless=tuple(reading.view.name for reading in readings if not reading.has_mask),
        findings=grouped(findings),
        is_linear=bool(readings) and all(reading.is_linear for reading in readings),
    )


def _exposure(frames: Sequence[Frame]) -> float:
    """Factor on the values of all linear photographs, 1 where there are none."""

    def pictures() -> Iterator[Image.Image]:
        for path in (frame.image for frame in frames):
            if path.suffix.lower() in (".exr", ".tif", ".tiff"):
                with suppress(CaptureRefusedError), header(path) as picture:
                    if LINEAR in picture.info:
                        yield picture

    return common_exposure(pictures())


def _about_colours(readings: Sequence[Reading], exposure: float) -> list[Finding]:
    """What was found of the photographs' colours, one line; a warning where tone curves differ."""
    of: dict[str, list[str]] = {}
    for reading in readings:
        for kind in reading.colours:
            of.setdefault(kind, []).append(reading.view.name)
    if not of:
        return []
    groups = "; ".join(f"{len(names)} {kind}" for kind, names in of.items())
    scaled = "" if exposure == 1.0 else f", times {exposure:g} so that they do not clip"
    found = [note("colours", f"Colours of the photographs: {groups}{scaled}")]
    toned = [reading.view.name for reading in readings if not reading.is_linear]
    message = f"{len(toned)} of {len(readings)} photographs went through a tone curve, others are "
    message, cure = f"{message}linear", "Give all photographs of one kind."
    mixed = toned if len(toned) < len(readings) else []
    return found + some("warning", "mixed-tone-curves", mixed, message, cure)


def _refuse_odd_size(frame: Frame, most: float) -> None:
    """Refuse a photograph that has nothing to do with the others, before it is decoded."""
    size = stored_size(frame.image)
    if size is not None and size[0] * size[1] > most:
        message = f"{frame.image} is {size[0]}x{size[1]} pixels, many times as large as the others"
        cure = "Give the photographs the poses were made for."
        raise refuse("wrong-size", message, cure, frame.image.name)
