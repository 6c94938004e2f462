# SPDX-License-Identifier: Apache-2.0
"""The capture stage's files: capture.json and one RGBA picture a view."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, Finding, View
from robir.capture.support import Plane
from robir.errors import StorageError
from robir.jobs.names import file_in
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.jobs.records import CAMERA, MATRIX, NUMBERS, read_record
from robir.maths.similarity import Similarity
from robir.workers import side_by_side

_LENS = ("width", "height", "fx", "fy", "cx", "cy")
_BOUNDS = {"centre": NUMBERS, "radius": float, "origin": str}

_CAPTURE = {
    "format": str,
    "source": str,
    "bounds": _BOUNDS,
    "views": [CAMERA],
    "findings": [{"level": str, "code": str, "message": str, "cure": str, "files": [str]}],
    "table": [{"normal": NUMBERS, "offset": float, "tolerance": float}],
    "is_linear?": bool,
}

_FRAME = {"turn": MATRIX, "scale": float, "shift": NUMBERS, "bounds": _BOUNDS}


def save_capture(folder: Path, capture: Capture) -> None:
    """Write a capture in its own frame; capture.json last, every file as a whole."""

    def save(view: View) -> None:
        # Separate layers keep the colour under a transparent mask.
        picture = Image.fromarray(np.dstack([view.image_display, view.mask]), "RGBA")
        with replacing(view_path(folder, view.name)) as temporary:
            picture.save(temporary, format="PNG", compress_level=1)

    side_by_side(save, capture.views)
    table = {} if capture.table is None else asdict(capture.table)
    plain = {
        "format": capture.format,
        "source": str(capture.source),
        "bounds": _plain_bounds(capture.bounds),
        "views": [plain_view(view) for view in capture.views],
        "findings": [asdict(finding) for finding in capture.findings],
        "table": [table | {"normal": table["normal"].tolist()}] if table else [],
        "is_linear": capture.is_linear,
    }
    write_json(folder / "capture.json", plain)


def load_capture(folder: Path) -> Capture:
    """What `save_capture` wrote: the capture in its own frame; `StorageError` where damaged."""
    with _reading(folder, "capture"):
        plain = read_record(folder / "capture.json", _CAPTURE)
        views = tuple(side_by_side(lambda entry: _view(folder, entry), plain["views"]))
        return Capture(
            source=Path(plain["source"]),
            format=plain["format"],
            views=views,
            bounds=_bounds(plain["bounds"]),
            findings=tuple(Finding.from_plain(entry) for entry in plain["findings"]),
            table=next((_plane(entry) for entry in plain["table"]), None),
            is_linear=plain.get("is_linear", False),
        )


@contextmanager
def _reading(path: Path, stage: str) -> Iterator[None]:
    """Say of what is missing or damaged which stage has to run again."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, SyntaxError) as fault:
        cure = f"Run the {stage} stage again."
        raise StorageError(f"{path} cannot be read ({fault}). {cure}") from fault


def load_bounds(paths: JobPaths) -> Bounds:
    """The object's sphere alone, without the photographs, in the frame of `load_settled`."""
    folder = paths.stage("capture")
    with _reading(folder, "capture"):
        bounds = _bounds(read_record(folder / "capture.json", _CAPTURE)["bounds"])
    moved = _load_frame(paths)
    return bounds if moved is None else moved[1]


def _plain_bounds(bounds: Bounds) -> dict[str, Any]:
    return {"centre": bounds.centre.tolist(), "radius": bounds.radius, "origin": bounds.origin}


def _bounds(plain: dict[str, Any]) -> Bounds:
    centre = np.array(plain["centre"], dtype=np.float64)
    if centre.shape != (3,) or plain["radius"] <= 0:
        raise ValueError("the bounds are no sphere")
    return Bounds(centre=centre, radius=float(plain["radius"]), origin=plain["origin"])


def save_frame(paths: JobPaths, frame: Similarity, bounds: Bounds) -> None:
    """Write where later stages have the capture: a similarity from the stored one, and bounds."""
    plain = {"turn": frame.turn.tolist(), "scale": frame.scale, "shift": frame.shift.tolist()}
    write_json(paths.frame, plain | {"bounds": _plain_bounds(bounds)})


def _load_frame(paths: JobPaths) -> tuple[Similarity, Bounds] | None:
    if not paths.frame.exists():
        return None
    with _reading(paths.frame, "geometry"):
        plain = read_record(paths.frame, _FRAME)
        turn, shift = np.array(plain["turn"]), np.array(plain["shift"])
        if turn.shape != (3, 3) or shift.shape != (3,) or plain["scale"] <= 0:
            raise ValueError("it is no similarity")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
            raise ValueError("its turn is none")
        frame = Similarity(turn=turn, scale=float(plain["scale"]), shift=shift)
        return frame, _bounds(plain["bounds"])


def _plane(plain: dict[str, Any]) -> Plane:
    normal = np.array(plain["normal"], dtype=np.float64)
    if normal.shape != (3,):
        raise ValueError("the table's normal has not three numbers")
    return Plane(normal=normal, offset=plain["offset"], tolerance=plain["tolerance"])


def save_masks(paths: JobPaths, views: Iterable[View]) -> None:
    """Write masks of all views that later stages shall take instead of the stored ones."""
    for view in views:
        with replacing(file_in(paths.cut_masks, f"{view.name}.png")) as temporary:
            Image.fromarray(view.mask).save(temporary, format="PNG", compress_level=1)


def load_settled(paths: JobPaths) -> Capture:
    """The stored capture, in the frame and with the masks that the geometry stage found better."""
    capture = load_capture(paths.stage("capture"))
    if paths.cut_masks.exists():
        masks = side_by_side(lambda view: _cut_mask(paths, view), capture.views)
        pairs = zip(capture.views, masks, strict=True)
        views = tuple(replace(view, mask=mask) for view, mask in pairs)
        capture = replace(capture, views=views)
    moved = _load_frame(paths)
    return capture if moved is None else replace(capture.moved(moved[0]), bounds=moved[1])


def _cut_mask(paths: JobPaths, view: View) -> NDArray[np.uint8]:
    path = file_in(paths.cut_masks, f"{view.name}.png")
    with _reading(path, "geometry"), Image.open(path, formats=["PNG"]) as picture:
        if picture.mode != "L" or picture.size != (view.camera.width, view.camera.height):
            raise ValueError(f"it is {picture.mode} of size {picture.size}")
        return np.array(picture)


def view_path(folder: Path, name: str) -> Path:
    """Picture of a view: RGBA, display-referred, straight alpha = mask."""
    return file_in(folder / "views", f"{name}.png")


def plain_view(view: View) -> dict[str, Any]:
    """Name, split and camera of a view as plain values for JSON."""
    return {"name": view.name, "split": view.split} | plain_camera(view.camera)


def plain_camera(camera: Camera) -> dict[str, Any]:
    """A camera as plain values for JSON; "whole" only where its picture is a part."""
    plain: dict[str, Any] = {key: getattr(camera, key) for key in _LENS}
    plain["camera_to_world"] = camera.camera_to_world.tolist()
    return plain if camera.whole is None else plain | {"whole": list(camera.whole)}


def _view(folder: Path, entry: dict[str, Any]) -> View:
    with Image.open(view_path(folder, entry["name"]), formats=["PNG"]) as picture:
        if picture.mode != "RGBA" or picture.size != (entry["width"], entry["height"]):
            raise ValueError(f"{entry['name']}.png is {picture.mode} of size {picture.size}")
        pixels = np.array(picture)
    pose = np.array(entry["camera_to_world"], dtype=np.float64)
    left, top, right, bottom = map(float, entry.get("whole", [0.0] * 4))
    whole = (left, top, right, bottom) if "whole" in entry else None
    return View(
        name=entry["name"],
        image_display=np.ascontiguousarray(pixels[:, :, :3]),
        mask=np.ascontiguousarray(pixels[:, :, 3]),
        camera=Camera(**{key: entry[key] for key in _LENS}, camera_to_world=pose, whole=whole),
        split=entry["split"],
    )
