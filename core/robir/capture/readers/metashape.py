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
are exported, and is applied if it is there. In a rig only the master has a transform; a slave's
sensor has "rotation" and "location", which carry its frame into the master's.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from robir.capture.capture import Finding
from robir.capture.frames import Array, Distortion, FrameSet, Lens, checked_lens
from robir.capture.readers.files import Side, checked, load_xml
from robir.capture.readers.shots import Shot, frame_set, opengl_pose, rolling_shutter
from robir.capture.refusal import CaptureRefusedError, note, refuse, some, warning

_CURE = "Export the cameras as Agisoft XML again (File > Export > Export Cameras)."
_CALIBRATION = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Aligned:
    """A camera with a pose."""

    camera: Element
    sensor: Element | None
    master: Element  # the entry that holds the transform; in a rig, that of another camera
    frame: tuple[int, str | None]  # chunk and component whose frame the transform is in
    name: str  # its label, below that of its group


def read(path: Path) -> FrameSet:
    """Read the aligned cameras with a frame in common, in the coordinate system of the chunks."""
    document = load_xml(path, _CURE)
    chunks = [document] if document.tag == "chunk" else list(document.iter("chunk"))
    aligned = [camera for index, chunk in enumerate(chunks) for camera in _aligned(index, chunk)]
    if not aligned:
        message = f"{path} holds no aligned camera"
        cure = "Align the photographs in Metashape and export the cameras again."
        raise refuse("no-poses", message, cure, path.name)
    places = _places(chunks)
    chosen, findings = _in_one_frame(path, aligned, places)
    shots = [
        Shot(
            name=seen.name,
            lens=_lens(path, seen.sensor, seen.camera.get("label", "")),
            pose=_pose(path, places.get(seen.frame, places.get((seen.frame[0], None))), seen),
        )
        for seen in chosen
    ]
    known = {id(seen.camera) for seen in aligned}
    every = [camera for chunk in chunks for camera in chunk.iter("camera")]
    left = [camera.get("label", "") for camera in every if id(camera) not in known]
    message = f"{len(left)} photographs of {path.name} are not aligned or switched off"
    findings += some("note", "unaligned-cameras", left, message)
    if any(seen.sensor is not None and _is_rolling(seen.sensor) for seen in chosen):
        findings.append(rolling_shutter(path))
    return frame_set(path, "metashape", shots, findings)


def _aligned(index: int, chunk: Element) -> list[_Aligned]:
    """Cameras that are switched on and have a transform, or whose rig's master has one."""
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    cameras = {camera.get("id"): camera for camera in chunk.iter("camera")}
    groups = {id(c): group.get("label", "") for group in chunk.iter("group") for c in group}
    found = []
    for camera in chunk.iter("camera"):
        master = cameras.get(camera.get("master_id"), camera)
        if camera.find("transform") is not None:
            master = camera
        if master.find("transform") is None or camera.get("enabled", "1") in ("0", "false"):
            continue
        label, sensor = camera.get("label", ""), sensors.get(camera.get("sensor_id"))
        name = f"{groups[id(camera)]}/{label}" if id(camera) in groups else label
        frame = (index, master.get("component_id"))
        found.append(_Aligned(camera=camera, sensor=sensor, master=master, frame=frame, name=name))
    return found


def _in_one_frame(
    path: Path, aligned: list[_Aligned], places: dict[tuple[int, str | None], Element]
) -> tuple[list[_Aligned], list[Finding]]:
    """The cameras of all chunks and components if transforms join them, else of the largest."""
    counts = Counter(seen.frame for seen in aligned)
    if len(counts) < 2:
        return aligned, []
    alone = Counter(chunk for chunk, _ in counts)
    joined = all(f in places or ((f[0], None) in places and alone[f[0]] == 1) for f in counts)
    parts = " and ".join(f"{count}" for _, count in counts.most_common())
    message = f"{path.name} holds chunks or components of {parts} photographs"
    if joined and len({seen.name for seen in aligned}) == len(aligned):
        return aligned, [note("several-parts", f"{message}, which their transforms join")]
    largest, count = counts.most_common(1)[0]
    rest = [seen.camera.get("label", "") for seen in aligned if seen.frame != largest]
    cure = "Align and merge the chunks, or the components, in Metashape and export again."
    why = "some photographs in several" if joined else "each in a frame of its own"
    message += f", {why}; the one of {count} is read"
    return [s for s in aligned if s.frame == largest], [
        warning("several-parts", message, cure, *rest)
    ]


def _is_rolling(sensor: Element) -> bool:
    state = sensor.find("rolling_shutter")
    return state is not None and (state.text or "").strip().lower() not in ("disabled", "0")


def _numbers(path: Path, element: Element | None, count: int, what: str) -> Array:
    text = "" if element is None or element.text is None else element.text
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count:
        message = f"{path}: {what} is {text[:80]!r}, not {count} numbers"
        raise refuse("bad-xml", message, _CURE, path.name)
    return values


def _places(chunks: list[Element]) -> dict[tuple[int, str | None], Element]:
    """The transforms of chunks (component None) and their components, by number."""
    places = {}
    for index, chunk in enumerate(chunks):
        for holder in (chunk, *chunk.iter("component")):
            place = holder.find("transform")
            if place is not None:
                places[index, None if holder is chunk else holder.get("id", "")] = place
    return places


def _pose(path: Path, place: Element | None, seen: _Aligned) -> Array:
    """Camera-to-world with OpenGL axes in the coordinate system of the chunk."""
    what = f"the transform of {seen.camera.get('label')}"
    pose = _numbers(path, seen.master.find("transform"), 16, what).reshape(4, 4)
    with np.errstate(all="ignore"):
        if seen.master is not seen.camera:
            pose = pose @ _offset(path, seen)
        pose[:, 1:3] *= -1.0  # OpenCV's axes
        if place is None:
            return pose
        parts = {"rotation": np.eye(3).ravel(), "translation": np.zeros(3), "scale": np.ones(1)}
        for tag, default in parts.items():
            if place.find(tag) is not None:
                what = f"the chunk's {tag}"
                parts[tag] = _numbers(path, place.find(tag), len(default), what)
        turn, move, scale = parts["rotation"].reshape(3, 3), parts["translation"], parts["scale"]
        return opengl_pose(turn @ pose[:3, :3], scale[0] * turn @ pose[:3, 3] + move)


def _offset(path: Path, seen: _Aligned) -> Array:
    """A sensor's place in its rig: what carries its camera's frame into the master's, (4, 4)."""
    label = seen.camera.get("label", "")
    parts = [None if seen.sensor is None else seen.sensor.find(t) for t in ("rotation", "location")]
    if None in parts:
        message = f"{path}: {label} is part of a rig of cameras whose offsets are not in the file"
        cure = "Export the cameras again, or align the photographs without a rig."
        raise refuse("rig", message, cure, path.name)
    turn = _numbers(path, parts[0], 9, f"the rig's rotation of {label}").reshape(3, 3)
    return opengl_pose(turn, _numbers(path, parts[1], 3, f"the rig's location of {label}"))


def _lens(path: Path, sensor: Element | None, label: str) -> Lens:
    """Intrinsics of a sensor, the adjusted ones if there are several."""
    calibrations = [] if sensor is None else sensor.findall("calibration")
    calibration = next(
        (c for c in calibrations if c.get("class") == "adjusted"), next(iter(calibrations), None)
    )
    if sensor is None or calibration is None or calibration.find("f") is None:
        message = f"{path}: the sensor of {label} has no calibration with a focal length f"
        raise refuse("bad-intrinsics", message, _CURE, path.name)
    kind = calibration.get("type", sensor.get("type", "frame"))
    if kind not in ("frame", "fisheye", "equidistant_fisheye"):
        raise _unsupported(path, label, f"of type {kind}")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    size = {} if resolution is None else resolution.attrib
    sides, where = [size.get("width", ""), size.get("height", "")], "the resolution of the sensor"
    how: dict[str, Any] = {
        "where": f"{where} of {label}",
        "code": "bad-intrinsics",
        "is_text": True,
    }
    width, height = checked(path, sides, tuple[Side, Side], _CURE, **how)
    value = dict.fromkeys(_CALIBRATION, 0.0)
    for key in _CALIBRATION:
        if calibration.find(key) is not None:
            value[key] = float(_numbers(path, calibration.find(key), 1, f"{key} of {label}")[0])
    if value["p3"] or value["p4"]:
        raise _unsupported(path, label, "with P3 and P4")
    fx = value["f"] + value["b1"]
    cx, cy = 0.5 * width + value["cx"], 0.5 * height + value["cy"]
    bent = Distortion(
        radial=(value["k1"], value["k2"], value["k3"], value["k4"]),
        tangential=(value["p2"], value["p1"]),
        skew=value["b2"] / fx if fx > 0 else 0.0,
        is_fisheye=kind != "frame",
    )
    lens = Lens(width=width, height=height, fx=fx, fy=value["f"], cx=cx, cy=cy, distortion=bent)
    return checked_lens(lens, path, label)


def _unsupported(path: Path, label: str, what: str) -> CaptureRefusedError:
    message = f"{path}: {label} was taken with a sensor {what}, which is not supported"
    cure = "Undistort the photographs in Metashape (Export > Undistort Photos) and export them "
    cure += "with their cameras."
    return refuse("camera-model", message, cure, path.name)
