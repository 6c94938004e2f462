# SPDX-License-Identifier: Apache-2.0
"""COLMAP sparse models, binary and text: cameras, images and points3D.

A pose there is the rotation (unit quaternion, w first) and translation from world to camera, with
OpenCV axes; pixel centres lie at half integers, as ours do. Layout: doc/format.rst of COLMAP.
COLMAP 4 writes each image's own pose there too, whatever its rig.
"""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from robir.capture.frames import MAX_NUMBER, Array, Distortion, FrameSet, Lens, checked_lens
from robir.capture.readers.files import IMAGE_FOLDERS, Side, checked, children
from robir.capture.readers.shots import Shot, frame_set, opencv_view, turned_by
from robir.capture.refusal import CaptureRefusedError, note, refuse
from robir.jobs.names import read_regular, regular

# camera models by number: name, count of parameters (src/colmap/sensor/models.h of COLMAP)
_MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8)),
    *(("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4)),
    *(("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16)),
    *(("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4), ("EUCM", 6)),
    ("EQUIRECTANGULAR", 2),
)
# models that pycolmap evaluates
_BY_PYCOLMAP = ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "DIVISION", "EUCM")
_MAX_BYTES = 1 << 29  # largest file of a model: every photograph's observations stand in it
_MAX_POINTS = 1_000_000  # sparse points that are read; they only help to find the object
_LONG = 8192  # letters of a line beyond which it holds no photograph's pose and path
_CURE = "Export the model again."
_Parameters = Annotated[list[float], Meta(max_length=16)]
_Sides = tuple[Side, Side]


@dataclass(frozen=True, slots=True)
class _Model:
    folder: Path
    suffix: str
    lenses: dict[int, Lens]
    images: list[tuple[str, int, Array]]  # name, camera number, camera-to-world of each


def find_models(source: Path) -> list[Path]:
    """Folders of sparse models at the usual places below a folder."""
    places = [source, source / "sparse", source / "colmap" / "sparse"]
    folders = places + [child for place in places[1:] for child in children(place)]
    return [folder for folder in folders if _suffix(folder)]


def read(source: Path, images: Path | None = None) -> FrameSet:
    """Read the largest sparse model: frames and sparse points in its own frame."""
    models = [_read_model(folder) for folder in find_models(source)]
    model = max(models, key=lambda candidate: len(candidate.images))
    images = images or _image_folder(source, model.folder, [name for name, _, _ in model.images])
    shots = []
    for name, number, pose in model.images:
        if number not in model.lenses:
            message = f"{model.folder}: {name} was taken with camera {number}, which is not listed"
            raise refuse("bad-colmap", message, _CURE)
        shots.append(Shot(name=name, image=images / name, lens=model.lenses[number], pose=pose))
    findings = []
    if len(models) > 1:
        counts = ", ".join(f"{m.folder.name} ({len(m.images)} photographs)" for m in models)
        message = f"Of the sparse models {counts}, {model.folder.name} is used"
        findings.append(note("several-models", message))
    points = _read_points(model.folder / f"points3D{model.suffix}")
    root = images if images.name == "." else images.parent
    return frame_set(root / f"images{model.suffix}", "colmap", shots, findings, points)


def _suffix(folder: Path) -> str | None:
    for suffix in (".bin", ".txt"):
        if all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")):
            return suffix
    return None


def _image_folder(source: Path, model: Path, names: list[str]) -> Path:
    """The folder that holds most of the photographs; `images` where none holds any."""
    places = [source, *(parent for parent in list(model.parents)[:3] if parent != source)]
    folders = [place / name for place in places for name in IMAGE_FOLDERS]
    counts = [sum((folder / name).is_file() for name in names) for folder in folders]
    return folders[int(np.argmax(counts))]


def _read_model(folder: Path) -> _Model:
    suffix = _suffix(folder) or ""
    cameras, listed = folder / f"cameras{suffix}", folder / f"images{suffix}"
    try:
        if suffix == ".bin":
            lenses = dict(_binary_cameras(cameras))
            posed = list(_binary_images(listed))
        else:
            lenses = dict(_text_cameras(cameras))
            posed = list(_text_images(listed))
    except CaptureRefusedError:
        raise
    except (OSError, ValueError, OverflowError, struct.error) as fault:
        message = f"The COLMAP model in {folder} is truncated or damaged ({fault})"
        raise refuse("bad-colmap", message, _CURE, cameras.name, listed.name) from None
    return _Model(folder, suffix, lenses, sorted(posed, key=lambda entry: entry[0]))


def _binary_cameras(path: Path) -> Iterator[tuple[int, Lens]]:
    with regular(path) as file:
        (count,) = struct.unpack("<Q", file.read(8))
        for _ in range(count):
            number, model, width, height = struct.unpack("<iiQQ", file.read(24))
            is_known = 0 <= model < len(_MODELS)
            name, size = _MODELS[model] if is_known else (f"number {model}", 0)
            values = struct.unpack(f"<{size}d", file.read(8 * size))
            yield number, _lens(path, name, width, height, values)


def _binary_images(path: Path) -> Iterator[tuple[str, int, Array]]:
    content = read_regular(path, _MAX_BYTES)
    (count,) = struct.unpack_from("<Q", content, 0)
    at = 8
    for _ in range(count):
        numbers = struct.unpack_from("<i7di", content, at)
        at += 64
        end = content.index(b"\0", at)
        name = content[at:end].decode("utf-8")
        (observations,) = struct.unpack_from("<Q", content, end + 1)
        at = end + 9 + 24 * observations
        if at > len(content):
            raise ValueError(f"{path.name} ends within {name}")
        yield name, numbers[8], opencv_view(turned_by(numbers[1:5]), numbers[5:8])


def _text_cameras(path: Path) -> Iterator[tuple[int, Lens]]:
    for line in _lines(path):
        if line:
            number, name, width, height, *values = line.split()
            values = checked(path, values, _Parameters, _CURE, where=name[:80], is_text=True)
            sides = checked(path, [width, height], _Sides, _CURE, where=name[:80], is_text=True)
            yield int(number), _lens(path, name, sides[0], sides[1], tuple(values))


def _text_images(path: Path) -> Iterator[tuple[str, int, Array]]:
    for line in _lines(path):
        # between the images stand their observations, three numbers each, or an empty line; some
        # programs leave that line away
        if not line or _is_observations(line):
            continue
        _, *values, camera, name = line.split(maxsplit=9)
        numbers = checked(path, values, list[float], _CURE, where=name[:80], is_text=True)
        yield name, int(camera), opencv_view(turned_by(numbers[:4]), numbers[4:])


def _is_observations(line: str) -> bool:
    """Whether a line holds threes of numbers, the last one a point's; names end otherwise."""
    if len(line) > _LONG:
        return True
    words = line.split()
    return len(words) % 3 == 0 and words[-1].lstrip("-").isdigit()


def _lines(path: Path) -> Iterator[str]:
    with regular(path, _MAX_BYTES) as file:
        for line in file:
            if not line.startswith(b"#"):
                yield line.decode("utf-8").strip()


def _read_points(path: Path) -> Array:
    """Sparse points, (N, 3); none if the file is missing or damaged, for they only help."""
    points = []
    try:
        if path.suffix == ".txt":
            lines = (line for line in _lines(path) if line)
            points = [list(map(float, line.split()[1:4])) for line in islice(lines, _MAX_POINTS)]
        else:
            content = read_regular(path, _MAX_BYTES)
            (count,) = struct.unpack_from("<Q", content, 0)
            at = 8
            for _ in range(min(count, _MAX_POINTS)):
                points.append(struct.unpack_from("<3d", content, at + 8))
                (track,) = struct.unpack_from("<Q", content, at + 43)
                at += 51 + 8 * track
        found = np.array(points, dtype=np.float64).reshape(-1, 3)
    except (OSError, ValueError, OverflowError, struct.error):
        return np.zeros((0, 3))
    return found[(np.abs(found) < MAX_NUMBER).all(axis=1)]


def _is_for_pycolmap(name: str, count: int) -> bool:
    """Whether pycolmap is there and evaluates a model of so many parameters."""
    is_known = name in _BY_PYCOLMAP and (name, count) in _MODELS
    return is_known and importlib.util.find_spec("pycolmap") is not None


def _lens(path: Path, name: str, width: int, height: int, values: tuple[float, ...]) -> Lens:
    """Intrinsics from a camera model's parameters, or a refusal that names the model."""
    match name, values:
        case "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL", (fx, cx, cy, *rest):
            fy = fx
            k1, k2 = (*rest, 0.0, 0.0)[:2]
            distortion = Distortion(radial=(k1, k2, 0.0, 0.0))
        case "PINHOLE" | "OPENCV" | "FULL_OPENCV", (fx, fy, cx, cy, *rest):
            k1, k2, p1, p2, k3, k4, k5, k6 = (*rest, *[0.0] * 8)[:8]
            distortion = Distortion(
                radial=(k1, k2, k3, 0.0), rational=(k4, k5, k6), tangential=(p1, p2)
            )
        case "SIMPLE_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE", (fx, cx, cy, *rest):
            fy = fx
            k1, k2 = (*rest, 0.0, 0.0)[:2]
            distortion = Distortion(radial=(k1, k2, 0.0, 0.0), is_fisheye=True)
        case "FISHEYE" | "OPENCV_FISHEYE", (fx, fy, cx, cy, *rest):
            k1, k2, k3, k4 = (*rest, *[0.0] * 4)[:4]
            distortion = Distortion(radial=(k1, k2, k3, k4), is_fisheye=True)
        case str(), (fx, fy, cx, cy, *rest) if _is_for_pycolmap(name, len(values)):
            distortion = Distortion(model=name, others=tuple(rest))
        case "SIMPLE_DIVISION", (fx, cx, cy, k) if _is_for_pycolmap("DIVISION", 5):
            fy, distortion = fx, Distortion(model="DIVISION", others=(k,))
        case _:
            message = f"{path}: the camera model {name} is not supported"
            cure = "Undistort the photographs with `colmap image_undistorter` and give that folder."
            raise refuse("camera-model", message, cure, path.name)
    lens = Lens(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion)
    return checked_lens(lens, path, f"a {name} camera")
