# SPDX-License-Identifier: Apache-2.0
"""Meshroom (AliceVision): cameras.sfm, the JSON of a structure from motion.

Poses hold the centre and, column by column, the rotation from world to camera with OpenCV axes, so
that the nine numbers read row by row are camera-to-world (saveMatrix in AliceVision's jsonIO.hpp).
Pixel centres lie at integers (cameraUndistortImage.hpp), so half a pixel is added to the principal
point. How intrinsics are written has changed (loadIntrinsic in jsonIO.cpp): before 1.2 in pixels
with one focal length, in 1.2.0 with two; before 1.2.1 the principal point counts from the corner,
later it is the offset from the middle; from 1.2.2 the focal length is in millimetres of
"sensorWidth", and "pixelRatio" is fx / fy before 1.2.5 and fy / fx from then on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from robir.capture.files import head, load_json, locate_photographs
from robir.capture.frames import (
    MAX_NUMBER,
    OPENGL_FROM_OPENCV,
    Array,
    Distortion,
    Frame,
    FrameSet,
    Lens,
    checked_lens,
    unique_names,
)
from robir.capture.refusal import CaptureRefusedError, note, refuse

FORMAT = "meshroom"

_CURE = "Take cameras.sfm from the folder of Meshroom's StructureFromMotion node."
_DAMAGE = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)
_NONE = ("", "none")


def looks_like(path: Path) -> bool:
    """Whether a file is JSON with Meshroom's views."""
    if path.suffix.lower() not in (".sfm", ".json"):
        return False
    start = head(path)
    return '"views"' in start and '"viewId"' in start


def read(path: Path) -> FrameSet:
    """Read views that have a pose, and the sparse points.

    Args:
        path: The JSON file.

    Returns:
        Frames in the frame of the file.

    Raises:
        CaptureError: If the file is damaged, holds no poses or a camera is no pinhole.
    """
    content = load_json(path)
    try:
        version = tuple(int(part) for part in content.get("version", (1, 0, 0)))
        poses = {entry["poseId"]: _pose(entry["pose"]) for entry in content.get("poses", ())}
        lenses = {entry["intrinsicId"]: entry for entry in content.get("intrinsics", ())}
        views = [view for view in content["views"] if view.get("poseId") in poses]
        paths = [str(view["path"]) for view in views]
        kinds = [lenses[view["intrinsicId"]] for view in views]
    except _DAMAGE as fault:
        raise _bad(path, fault) from None
    if not views:
        raise refuse("no-poses", f"{path} holds no view with a pose", _CURE, path.name)
    if any(str(view.get("isPoseIndependant", "true")).lower() in ("false", "0") for view in views):
        raise refuse(
            "camera-model",
            f"{path} holds a rig of cameras, which is not supported",
            "Reconstruct the photographs without rigs.",
            path.name,
        )
    root, found = locate_photographs(path, paths)
    frames = tuple(
        Frame(
            name=name,
            image=Path(stated) if Path(stated).is_file() else root / relative,
            relative=stated if Path(stated).is_file() else relative,
            lens=_lens(path, version, kind),
            camera_to_world=poses[view["poseId"]],
        )
        for view, name, stated, relative, kind in zip(
            views, unique_names(paths), paths, found, kinds, strict=True
        )
    )
    without = [str(v.get("path", "")) for v in content["views"] if v.get("poseId") not in poses]
    findings = []
    if without:
        message = f"{len(without)} of {len(content['views'])} views of {path.name} have no pose"
        findings.append(note("unposed-views", message, *(Path(p).name for p in without)))
    return FrameSet(
        root=root,
        format=FORMAT,
        frames=frames,
        points=_points(content),
        findings=tuple(findings),
    )


def _bad(path: Path, fault: Exception) -> CaptureRefusedError:
    return refuse(
        "bad-sfm",
        f"{path} is no complete structure from motion ({type(fault).__name__}: {fault})",
        _CURE,
        path.name,
    )


def _pose(entry: dict[str, Any]) -> Array:
    transform = entry["transform"]
    pose = np.eye(4)
    pose[:3, :3] = np.array(transform["rotation"], dtype=np.float64).reshape(3, 3)
    pose[:3, 3] = np.array(transform["center"], dtype=np.float64).reshape(3)
    return pose @ OPENGL_FROM_OPENCV


def _points(content: dict[str, Any]) -> Array:
    """Sparse points, (N, 3); none if they are damaged, for they only help."""
    try:
        found = np.array([entry["X"] for entry in content.get("structure", ())], dtype=np.float64)
        found = found.reshape(-1, 3)
    except _DAMAGE:
        return np.zeros((0, 3))
    return found[(np.abs(found) < MAX_NUMBER).all(axis=1)]


def _lens(path: Path, version: tuple[int, ...], entry: dict[str, Any]) -> Lens:
    try:
        width, height = int(entry["width"]), int(entry["height"])
        fx, fy = _focals(version, entry, width)
        cx, cy = (float(value) for value in entry["principalPoint"])
        if version >= (1, 2, 1):
            cx, cy = cx + 0.5 * width, cy + 0.5 * height
        kind, values = _distortion_of(entry)
        distortion = _distortion(kind, values)
    except _DAMAGE as fault:
        raise _bad(path, fault) from None
    if distortion is None:
        raise refuse(
            "camera-model",
            f"{path}: the camera model {kind} is not supported",
            "Export undistorted photographs (Meshroom's PrepareDenseScene or ExportImages).",
            path.name,
        )
    lens = Lens(
        width=width, height=height, fx=fx, fy=fy, cx=cx + 0.5, cy=cy + 0.5, distortion=distortion
    )
    return checked_lens(lens, path, f"intrinsic {entry.get('intrinsicId')}")


def _focals(version: tuple[int, ...], entry: dict[str, Any], width: int) -> tuple[float, float]:
    """Focal lengths in pixels."""
    if version < (1, 2, 0):
        focal = float(entry["pxFocalLength"])
        return focal, focal
    if version < (1, 2, 2):
        fx, fy = (float(value) for value in entry["pxFocalLength"])
        return fx, fy
    fx = float(entry["focalLength"]) / float(entry.get("sensorWidth", 36.0)) * width
    ratio = float(entry.get("pixelRatio", 1.0))
    return fx, (fx / ratio if version < (1, 2, 5) else fx * ratio)


def _distortion_of(entry: dict[str, Any]) -> tuple[str, list[float]]:
    """Name of the distortion and its numbers; newer files keep it apart from the projection."""
    projection = str(entry["type"]).lower()
    kind = str(entry.get("distortionType", projection)).lower()
    undistortion = str(entry.get("undistortionType", "none")).lower()
    if undistortion not in _NONE:
        return undistortion, []
    if projection.startswith(("equidistant", "equirectangular", "fisheye")):
        kind = projection
    return kind, [float(value) for value in entry.get("distortionParams") or ()]


def _distortion(kind: str, values: list[float]) -> Distortion | None:
    """The distortion in our terms, or None if there is no such thing."""
    radial = (*values, 0.0, 0.0, 0.0, 0.0)
    match kind.replace("radialk", "radial"):
        case "none" | "" | "pinhole":
            return Distortion()
        case "radial1":
            return Distortion(radial=(radial[0], 0.0, 0.0, 0.0))
        case "radial3":
            return Distortion(radial=(radial[0], radial[1], radial[2], 0.0))
        case "brown":
            k1, k2, k3, t1, t2 = values
            return Distortion(radial=(k1, k2, k3, 0.0), tangential=(t1, t2))
        case "fisheye4" | "fisheye":
            k1, k2, k3, k4 = values
            return Distortion(radial=(k1, k2, k3, k4), is_fisheye=True)
        case _:
            return None
