# SPDX-License-Identifier: Apache-2.0
"""The one test scene as the photogrammetry programs export it, each by its own conventions."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from capture.scene import Shot, surface_points
from capture.writers import FLIP, save_masks, save_pictures
from scipy.spatial.transform import Rotation

# rotation, translation and scale of the Metashape chunk
PLACE = (
    Rotation.from_euler("xyz", [0.4, -0.7, 1.9]).as_matrix(),
    np.array([7.0, -3.0, 0.5]),
    2.25,
)

POLYCAM = ("corrected_cameras", "corrected_images")


def polycam(root: Path, shots: Sequence[Shot], pair: tuple[str, str] = POLYCAM) -> Path:
    """Keyframes named by time stamps, as PNG for exactness."""
    stems = [str(4_000_000_017 + 31 * i) for i in range(len(shots))]
    keyframes = root / "keyframes"
    save_pictures(keyframes / pair[1], shots, [f"{stem}.png" for stem in stems], alpha=False)
    save_masks(keyframes / "masks", shots, [f"{stem}.png" for stem in stems])
    (keyframes / pair[0]).mkdir()
    for shot, stem in zip(shots, stems, strict=True):
        lens = shot.camera
        content = {
            "fx": lens.fx,
            "fy": lens.fy,
            "cx": lens.cx,
            "cy": lens.cy,
            "width": lens.width,
            "height": lens.height,
            "blur_score": 81.5,
            "timestamp": int(stem),
        }
        for row in range(3):
            for column in range(4):
                content[f"t_{row}{column}"] = lens.camera_to_world[row, column]
        (keyframes / pair[0] / f"{stem}.json").write_text(json.dumps(content))
    return root


def reality_scan(root: Path, shots: Sequence[Shot], extra: str = "0,0,0,0,0,0") -> Path:
    """Internal/external camera parameters; square pixels, as the format has one focal length."""
    names = [f"IMG {i:02d}.png" for i in range(len(shots))]
    save_pictures(root / "photos", shots, names, alpha=False)
    save_masks(root / "masks", shots, names)
    lines = ["#cameras 8", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for shot, name in zip(shots, names, strict=True):
        lens = shot.camera
        with warnings.catch_warnings():
            # A camera that looks level has many angles; any of them will do.
            warnings.simplefilter("ignore", UserWarning)
            turn = Rotation.from_matrix(lens.camera_to_world[:3, :3])
            heading, pitch, roll = turn.as_euler("ZXY", degrees=True)
        longer = max(lens.width, lens.height)
        values = [
            *lens.camera_to_world[:3, 3],
            -heading,
            pitch,
            roll,
            lens.fx * 36 / longer,
            (lens.cx - lens.width / 2) / longer,
            (lens.cy - lens.height / 2) / longer,
        ]
        lines.append(f"{name},{','.join(repr(float(v)) for v in values)},{extra}")
    (root / "cameras.csv").write_text("\n".join(lines) + "\n")
    return root


def metashape(root: Path, shots: Sequence[Shot], placed: bool = True) -> Path:
    """Agisoft XML; with `placed` the cameras are in a chunk that is turned, moved and scaled."""
    names = [f"DSC{i:04d}.png" for i in range(len(shots))]
    save_pictures(root / "images", shots, names, alpha=False)
    save_masks(root / "masks", shots, names)
    document = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(document, "chunk", label="Chunk 1", enabled="true")
    sensors = ElementTree.SubElement(chunk, "sensors", next_id="2")
    lens = shots[0].camera
    for number, kind in (("0", "initial"), ("3", "adjusted")):
        sensor = ElementTree.SubElement(sensors, "sensor", id=number, label="A7", type="frame")
        size = {"width": str(lens.width), "height": str(lens.height)}
        ElementTree.SubElement(sensor, "resolution", size)
        calibration = ElementTree.SubElement(sensor, "calibration", {"type": "frame"})
        calibration.set("class", kind)
        for key, value in (
            ("f", lens.fy if kind == "adjusted" else 1.0),
            ("cx", lens.cx - lens.width / 2),
            ("cy", lens.cy - lens.height / 2),
            ("b1", lens.fx - lens.fy),
        ):
            ElementTree.SubElement(calibration, key).text = repr(float(value))
    turn, move, scale = PLACE
    cameras = ElementTree.SubElement(chunk, "cameras")
    group = ElementTree.SubElement(cameras, "group", id="0", label="Group 1")
    for i, (shot, name) in enumerate(zip(shots, names, strict=True)):
        camera = ElementTree.SubElement(
            group if i % 2 else cameras, "camera", id=str(i), sensor_id="3", label=name[:-4]
        )
        pose = shot.camera.camera_to_world @ FLIP
        if placed:
            pose[:3, :3] = turn.T @ pose[:3, :3]
            pose[:3, 3] = turn.T @ (pose[:3, 3] - move) / scale
        text = " ".join(repr(float(value)) for value in pose.ravel())
        ElementTree.SubElement(camera, "transform").text = text
    ElementTree.SubElement(cameras, "camera", id="90", sensor_id="3", label="unaligned")
    if placed:
        transform = ElementTree.SubElement(chunk, "transform")
        for tag, values in (
            ("rotation", turn.ravel()),
            ("translation", move),
            ("scale", [scale]),
        ):
            ElementTree.SubElement(transform, tag).text = " ".join(repr(float(v)) for v in values)
    ElementTree.ElementTree(document).write(root / "cameras.xml", encoding="utf-8")
    return root


def meshroom(root: Path, shots: Sequence[Shot], version: tuple[int, int, int]) -> Path:
    """cameras.sfm as the given version of AliceVision writes it; all values are texts."""
    names = [f"P10{i:02d}.png" for i in range(len(shots))]
    save_pictures(root / "photos", shots, names, alpha=False)
    save_masks(root / "masks", shots, names)
    lens = shots[0].camera
    # Pixel centres lie at integers there.
    centre = np.array([lens.cx - 0.5, lens.cy - 0.5])
    if version >= (1, 2, 1):
        centre -= np.array([lens.width, lens.height]) / 2
    intrinsic = {
        "intrinsicId": "77",
        "width": str(lens.width),
        "height": str(lens.height),
        "type": "radial3" if version < (1, 2, 6) else "pinhole",
        "principalPoint": [repr(float(value)) for value in centre],
        "distortionParams": ["0", "0", "0"],
        "locked": "false",
    }
    if version < (1, 2, 0):
        assert lens.fx == lens.fy
        intrinsic["pxFocalLength"] = repr(lens.fx)
    elif version < (1, 2, 2):
        intrinsic["pxFocalLength"] = [repr(lens.fx), repr(lens.fy)]
    else:
        ratio = lens.fx / lens.fy if version < (1, 2, 5) else lens.fy / lens.fx
        intrinsic |= {
            "sensorWidth": "23.5",
            "focalLength": repr(lens.fx * 23.5 / lens.width),
            "pixelRatio": repr(ratio),
        }
    if version >= (1, 2, 6):
        intrinsic |= {"distortionType": "radialk3", "undistortionType": "none"}
    views, poses = [], []
    for i, (shot, name) in enumerate(zip(shots, names, strict=True)):
        views.append(
            {
                "viewId": str(500 + i),
                "poseId": str(500 + i),
                "intrinsicId": "77",
                "path": f"/volume/project/{name}",
                "width": str(lens.width),
                "height": str(lens.height),
            }
        )
        world_to_camera = np.linalg.inv(shot.camera.camera_to_world @ FLIP)[:3, :3]
        transform = {
            "rotation": [repr(float(v)) for v in world_to_camera.ravel(order="F")],
            "center": [repr(float(v)) for v in shot.camera.camera_to_world[:3, 3]],
        }
        poses.append({"poseId": str(500 + i), "pose": {"transform": transform, "locked": "0"}})
    views.append(views[0] | {"viewId": "3", "poseId": "3", "path": "/volume/project/lost.png"})
    points = [{"X": [repr(float(v)) for v in point]} for point in surface_points(200)]
    (root / "cameras.sfm").write_text(
        json.dumps(
            {
                "version": [str(part) for part in version],
                "views": views,
                "intrinsics": [intrinsic],
                "poses": poses,
                "structure": points,
            }
        )
    )
    return root
