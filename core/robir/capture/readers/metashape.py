# SPDX-License-Identifier: Apache-2.0
"""Agisoft Metashape: cameras exported as XML.

A sensor's calibration is the user manual's appendix "Camera models": with x = X / Z, y = Y / Z, y
down and r the distance from the axis,

    x' = x (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + P1 (r^2 + 2 x^2) + 2 P2 x y
    y' = y (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + P2 (r^2 + 2 y^2) + 2 P1 x y
    u  = w / 2 + cx + x' f + x' B1 + y' B2
    v  = h / 2 + cy + y' f

with u, v from the upper left corner: P1 is OpenCV's p2 and P2 its p1, fx = f + B1, B2 is skew. A
"fisheye" sensor replaces (x, y) by (x, y) atan(r) / r first. A camera's transform is
camera-to-world with OpenCV axes in the chunk's (or component's) own frame; the chunk's transform of
rotation, translation and scale carries that into the coordinate system of the chunk, where models
are exported, and is applied if it is there.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree  # nosec B405
from xml.etree.ElementTree import Element  # nosec B405

import numpy as np

from robir.capture.frames import (
    Array,
    Distortion,
    Frame,
    FrameSet,
    Lens,
    checked_lens,
    unique_names,
)
from robir.capture.readers.files import head, locate_photographs, read_text
from robir.capture.readers.values import Side, checked
from robir.capture.refusal import CaptureRefusedError, note, refuse

FORMAT = "metashape"

_CURE = "Export the cameras as Agisoft XML again (File > Export > Export Cameras)."
_CALIBRATION = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


def looks_like(path: Path) -> bool:
    """Whether a file is XML with a chunk of sensors."""
    start = head(path)
    return "<chunk" in start and "<sensor" in start


def read(path: Path) -> FrameSet:
    """Read the aligned cameras of the first chunk that has any.

    Args:
        path: The XML file.

    Returns:
        Frames in the coordinate system of the chunk.

    Raises:
        CaptureError: If the file is damaged, no camera is aligned or a sensor is no pinhole.
    """
    document = _document(path)
    chunks = [document] if document.tag == "chunk" else list(document.iter("chunk"))
    aligned = [(chunk, _aligned(chunk)) for chunk in chunks]
    chunk, cameras = next((pair for pair in aligned if pair[1]), (None, []))
    if chunk is None:
        raise refuse(
            "no-poses",
            f"{path} holds no aligned camera",
            "Align the photographs in Metashape and export the cameras again.",
            path.name,
        )
    labels = [camera.get("label", "") for camera in cameras]
    root, relatives = locate_photographs(path, labels)
    lenses = {
        sensor.get("id"): sensor for sensor in chunk.iter("sensor") if sensor.get("id") is not None
    }
    places = _places(chunk)
    frames = tuple(
        Frame(
            name=name,
            image=root / relative,
            relative=relative,
            lens=_lens(path, lenses.get(camera.get("sensor_id")), camera.get("label", "")),
            camera_to_world=_pose(path, places, camera),
        )
        for camera, name, relative in zip(cameras, unique_names(relatives), relatives, strict=True)
    )
    used = {id(camera) for camera in cameras}
    left_out = [c.get("label", "") for c in chunk.iter("camera") if id(c) not in used]
    findings = []
    if left_out:
        findings.append(
            note(
                "unaligned-cameras",
                f"{len(left_out)} photographs of {path.name} are not aligned or switched off",
                *left_out,
            )
        )
    return FrameSet(root=root, format=FORMAT, frames=frames, findings=tuple(findings))


def _document(path: Path) -> Element:
    try:
        return ElementTree.fromstring(_plain(read_text(path)))  # nosec B314
    except (OSError, ValueError, LookupError, RecursionError, ElementTree.ParseError) as fault:
        raise refuse(
            "bad-xml", f"{path} is not readable as XML ({fault})", _CURE, path.name
        ) from None


def _plain(text: str) -> str:
    """XML without definitions, which could make it grow or read files; no export has any."""
    if "<!DOCTYPE" in text:
        raise ValueError("it defines a document type")
    return text


def _aligned(chunk: Element) -> list[Element]:
    return [
        camera
        for camera in chunk.iter("camera")
        if camera.find("transform") is not None and camera.get("enabled", "1") not in ("0", "false")
    ]


def _numbers(path: Path, element: Element | None, count: int, what: str) -> Array:
    """Numbers in an element's text, (count,)."""
    text = "" if element is None or element.text is None else element.text
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count:
        raise refuse(
            "bad-xml", f"{path}: {what} is {text[:80]!r}, not {count} numbers", _CURE, path.name
        )
    return values


def _places(chunk: Element) -> dict[str | None, Element]:
    """The transforms of a chunk (None) and its components, by number."""
    places: dict[str | None, Element] = {}
    for number, holder in [(None, chunk), *((c.get("id", ""), c) for c in chunk.iter("component"))]:
        found = holder.find("transform")
        if found is not None:
            places[number] = found
    return places


def _pose(path: Path, places: dict[str | None, Element], camera: Element) -> Array:
    """Camera-to-world with OpenGL axes in the coordinate system of the chunk."""
    what = f"the transform of {camera.get('label')}"
    pose = _numbers(path, camera.find("transform"), 16, what).reshape(4, 4)
    pose[:, 1:3] *= -1.0  # OpenCV's axes; a product of matrices would spread what is not finite
    place = places.get(camera.get("component_id"), places.get(None))
    if place is None:
        return pose
    turn, move, scale = (
        _numbers(path, place.find(tag), count, f"the chunk's {tag}")
        if place.find(tag) is not None
        else default
        for tag, count, default in (
            ("rotation", 9, np.eye(3).ravel()),
            ("translation", 3, np.zeros(3)),
            ("scale", 1, np.ones(1)),
        )
    )
    result = np.eye(4)
    result[:3, :3] = turn.reshape(3, 3) @ pose[:3, :3]
    result[:3, 3] = scale[0] * turn.reshape(3, 3) @ pose[:3, 3] + move
    return result


def _lens(path: Path, sensor: Element | None, label: str) -> Lens:
    """Intrinsics of a sensor, the adjusted ones if there are several."""
    calibrations = [] if sensor is None else sensor.findall("calibration")
    calibration = next(
        (c for c in calibrations if c.get("class") == "adjusted"), next(iter(calibrations), None)
    )
    if sensor is None or calibration is None or calibration.find("f") is None:
        raise refuse(
            "bad-intrinsics",
            f"{path}: the sensor of {label} has no calibration with a focal length f",
            _CURE,
            path.name,
        )
    kind = calibration.get("type", sensor.get("type", "frame"))
    if kind not in ("frame", "fisheye", "equidistant_fisheye"):
        raise _unsupported(path, label, f"of type {kind}")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    size = {} if resolution is None else resolution.attrib
    width, height = checked(
        path,
        [size.get("width", ""), size.get("height", "")],
        tuple[Side, Side],
        _CURE,
        where=f"the resolution of the sensor of {label}",
        code="bad-intrinsics",
        is_text=True,
    )
    value = {
        key: 0.0
        if calibration.find(key) is None
        else float(_numbers(path, calibration.find(key), 1, f"{key} of {label}")[0])
        for key in _CALIBRATION
    }
    if value["p3"] or value["p4"]:
        raise _unsupported(path, label, "with P3 and P4")
    fx = value["f"] + value["b1"]
    lens = Lens(
        width=width,
        height=height,
        fx=fx,
        fy=value["f"],
        cx=0.5 * width + value["cx"],
        cy=0.5 * height + value["cy"],
        distortion=Distortion(
            radial=(value["k1"], value["k2"], value["k3"], value["k4"]),
            tangential=(value["p2"], value["p1"]),
            skew=value["b2"] / fx if fx > 0 else 0.0,
            is_fisheye=kind != "frame",
        ),
    )
    return checked_lens(lens, path, label)


def _unsupported(path: Path, label: str, what: str) -> CaptureRefusedError:
    return refuse(
        "camera-model",
        f"{path}: {label} was taken with a sensor {what}, which is not supported",
        "Undistort the photographs in Metashape (Export > Undistort Photos) "
        "and export them with their cameras.",
        path.name,
    )
