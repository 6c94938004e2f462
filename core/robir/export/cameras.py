# SPDX-License-Identifier: Apache-2.0
"""The cameras of a result, in our own form and in those that other programs read.

`cameras.json` is what the add-on reads. `transforms.json` is nerfstudio's and instant-ngp's, and
`colmap` a sparse model in text, whose photographs lie in stages/capture/views. All are in the
capture's frame and unit, of the photographs as the result used them: cut, undistorted, the mask
their alpha.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robir.capture.capture import Capture
from robir.capture.frames import OPENGL_FROM_OPENCV
from robir.capture.store import plain_view, view_path
from robir.evaluation.layers import stored_facts
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.jobs.records import NUMBERS

_GROUND = {"normal": NUMBERS, "offset": float}
_MOST_POINTS = 20_000  # points of the sparse model: splats begin from them


def export_cameras(
    paths: JobPaths, capture: Capture, points: NDArray[np.floating] | None = None
) -> None:
    """Write every view with its photograph, bounds and ground, and points (N, 3), capture frame."""
    folder = paths.stage("capture")
    photos = [
        Path(os.path.relpath(view_path(folder, view.name), paths.cameras.parent)).as_posix()
        for view in capture.views
    ]
    centre, radius = capture.bounds.centre, capture.bounds.radius
    table: dict[str, Any] = {
        "views": [
            {**plain_view(view), "image": photo}
            for view, photo in zip(capture.views, photos, strict=True)
        ],
        "bounds": {"centre": centre.tolist(), "radius": radius},
    }
    if paths.ground.is_file():
        plane = stored_facts(paths.ground, _GROUND)
        away = sum(n * c for n, c in zip(plane["normal"], centre.tolist(), strict=True))
        table["ground"] = plane | {"offset": radius * plane["offset"] + away}
    write_json(paths.cameras, table)
    write_json(paths.transforms, _transforms(capture, photos))
    _write_colmap(paths.colmap / "sparse" / "0", capture, photos, points)


def _transforms(capture: Capture, photos: list[str]) -> dict[str, Any]:
    frames, names = [], {"train": [], "held_out": []}
    for view, photo in zip(capture.views, photos, strict=True):
        camera = view.camera
        names[view.split].append(photo)
        frame = {"file_path": photo, "transform_matrix": camera.camera_to_world.tolist()}
        frame |= {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
        frames.append(frame | {"cx": camera.cx, "cy": camera.cy})
    held_out = {"val_filenames": names["held_out"], "test_filenames": names["held_out"]}
    split = {"train_filenames": names["train"], **held_out} if names["held_out"] else {}
    return {"camera_model": "OPENCV", **split, "frames": frames}


def _write_colmap(
    folder: Path, capture: Capture, photos: list[str], points: NDArray[np.floating] | None
) -> None:
    cameras, images = [], []
    for number, (view, photo) in enumerate(zip(capture.views, photos, strict=True), start=1):
        camera = view.camera
        lens = _words(camera.fx, camera.fy, camera.cx, camera.cy)
        cameras.append(f"{number} PINHOLE {camera.width} {camera.height} {lens}\n")
        look = np.linalg.inv(camera.camera_to_world @ OPENGL_FROM_OPENCV)
        x, y, z, w = Rotation.from_matrix(look[:3, :3]).as_quat()
        pose = _words(w, x, y, z, *look[:3, 3])
        images.append(f"{number} {pose} {number} {photo.rpartition('/')[2]}\n\n")
    chosen = np.zeros((0, 3)) if points is None else points[:: 1 + len(points) // _MOST_POINTS]
    cloud = [f"{i} {_words(*p)} 128 128 128 0\n" for i, p in enumerate(chosen, start=1)]
    folder.mkdir(parents=True, exist_ok=True)
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", cloud)):
        with replacing(folder / f"{name}.txt") as file:
            file.write_text("".join(lines), encoding="utf-8")


def _words(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
