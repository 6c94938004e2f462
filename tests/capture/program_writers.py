# SPDX-License-Identifier: Apache-2.0
"""The one test scene as phones and other programs write it, each by its own conventions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from capture.scene import Shot, surface_points
from capture.writers import FLIP, save_masks, save_pictures
from scipy.spatial.transform import Rotation

Shots = Sequence[Shot]


def _pictures(
    root: Path, shots: Shots, folder: str, pattern: str, alpha: bool = False
) -> list[str]:
    names = [pattern.format(i) for i in range(len(shots))]
    save_pictures(root / folder, shots, names, alpha=False)
    return names


def _view(shot: Shot) -> np.ndarray:
    """World to camera with OpenCV axes, (4, 4)."""
    return np.linalg.inv(shot.camera.camera_to_world @ FLIP)


def _dump(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def opensfm(root: Path, shots: Shots) -> Path:
    """A project of OpenDroneMap: the photographs in images, the reconstruction in opensfm."""
    names = _pictures(root, shots, "images", "DJI_{:04d}.png")
    lens = shots[0].camera
    longer = max(lens.width, lens.height)
    camera = {
        "projection_type": "brown",
        "width": lens.width,
        "height": lens.height,
        "focal_x": lens.fx / longer,
        "focal_y": lens.fy / longer,
        "c_x": (lens.cx - lens.width / 2) / longer,
        "c_y": (lens.cy - lens.height / 2) / longer,
    }
    placed = {
        name: {
            "rotation": Rotation.from_matrix(_view(shot)[:3, :3]).as_rotvec().tolist(),
            "translation": _view(shot)[:3, 3].tolist(),
            "camera": "v2 drone",
        }
        for name, shot in zip(names, shots, strict=True)
    }
    points = {str(i): {"coordinates": p.tolist()} for i, p in enumerate(surface_points(50))}
    small = {"cameras": {}, "shots": {}, "points": {}}
    whole = {"cameras": {"v2 drone": camera}, "shots": placed, "points": points}
    _dump(root / "opensfm/reconstruction.json", [small, whole])
    return root


def openmvg(root: Path, shots: Shots) -> Path:
    """sfm_data.json with square pixels, as there is one focal length."""
    names = _pictures(root, shots, "images", "P{:03d}.png")
    lens = shots[0].camera
    data = {
        "width": lens.width,
        "height": lens.height,
        "focal_length": lens.fx,
        "principal_point": [lens.cx - 0.5, lens.cy - 0.5],
        "disto_k3": [0.0, 0.0, 0.0],
    }
    views, poses = [], []
    for i, (name, shot) in enumerate(zip(names, shots, strict=True)):
        view = {"local_path": "", "filename": name, "id_intrinsic": 0, "id_pose": i}
        views.append({"key": i, "value": {"polymorphic_id": 1, "ptr_wrapper": {"data": view}}})
        rows, centre = _view(shot)[:3, :3].tolist(), shot.camera.position.tolist()
        poses.append({"key": i, "value": {"rotation": rows, "center": centre}})
    lost = {"filename": "lost.png", "id_intrinsic": 0, "id_pose": 4294967295}
    views.append({"key": 99, "value": {"ptr_wrapper": {"data": lost}}})
    kind = {"polymorphic_name": "pinhole_radial_k3", "ptr_wrapper": {"id": 1, "data": data}}
    structure = [{"key": i, "value": {"X": p.tolist()}} for i, p in enumerate(surface_points(50))]
    content = {"sfm_data_version": "0.3", "root_path": "/elsewhere/images", "views": views}
    content |= {"intrinsics": [{"key": 0, "value": kind}], "extrinsics": poses}
    _dump(root / "sfm_data.json", content | {"structure": structure, "control_points": []})
    return root


def bundler(root: Path, shots: Shots) -> Path:
    """bundle.out; the second photograph of the list was not placed."""
    names = _pictures(root, shots, "images", "b{:02d}.jpg.png")
    points = surface_points(50)
    lines = ["# Bundle file v0.3", f"{len(shots) + 1} {len(points)}"]
    for i, shot in enumerate(shots):
        view = FLIP @ _view(shot)
        rows = [[shot.camera.fx, 0.0, 0.0], *view[:3, :3].tolist(), view[:3, 3].tolist()]
        lines += [" ".join(map(repr, map(float, row))) for row in rows]
        if i == 0:
            lines += ["0 0 0"] * 5
    for point in points:
        lines += [" ".join(map(repr, map(float, point))), "90 90 90", "1 0 0 0.0 0.0"]
    (root / "bundle.out").write_text("\n".join(lines) + "\n")
    listed = [names[0], "lost.png", *names[1:]]
    (root / "list.txt").write_text("".join(f"./images/{name} 0 500.0\n" for name in listed))
    return root


def reality_xmp(
    root: Path, shots: Shots, model: str = "brown3", terms: str = "0 0 0 0 0 0"
) -> Path:
    """XMP beside each photograph."""
    names = _pictures(root, shots, "images", "R{:03d}.png")
    for name, shot in zip(names, shots, strict=True):
        lens, longer = shot.camera, max(shot.camera.width, shot.camera.height)
        turn = " ".join(repr(float(v)) for v in _view(shot)[:3, :3].ravel())
        place = " ".join(repr(float(v)) for v in lens.position)
        keys = {
            "DistortionModel": model,
            "FocalLength35mm": repr(lens.fx * 36 / longer),
            "PrincipalPointU": repr((lens.cx - lens.width / 2) / longer),
            "PrincipalPointV": repr((lens.cy - lens.height / 2) / longer),
        }
        stated = " ".join(f'xcr:{key}="{value}"' for key, value in keys.items())
        (root / "images" / name).with_suffix(".xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/'
            '22-rdf-syntax-ns#"><rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/'
            f'1.1#" xcr:Skew="0" xcr:AspectRatio="1" {stated}><xcr:Rotation>{turn}</xcr:Rotation>'
            f"<xcr:Position>{place}</xcr:Position><xcr:DistortionCoeficients>{terms}"
            "</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>"
        )
    return root


def sdfstudio(root: Path, shots: Shots) -> Path:
    """meta_data.json with masks, all in one folder."""
    names = _pictures(root, shots, ".", "{:06d}_rgb.png")
    masks = [name.replace("rgb", "foreground_mask") for name in names]
    save_masks(root, shots, masks)
    frames = []
    for name, mask, shot in zip(names, masks, shots, strict=True):
        lens, k = shot.camera, np.eye(4)
        k[0, 0], k[1, 1], k[:2, 2] = lens.fx, lens.fy, [lens.cx, lens.cy]
        pose = lens.camera_to_world @ FLIP
        frames.append({"rgb_path": name, "foreground_mask": mask})
        frames[-1] |= {"camtoworld": pose.tolist(), "intrinsics": k.tolist()}
    size = {"width": shots[0].camera.width, "height": shots[0].camera.height}
    _dump(root / "meta_data.json", {"camera_model": "OPENCV", **size, "frames": frames})
    return root


def nerfactor(root: Path, shots: Shots) -> Path:
    """A folder a view, under two lights; the test views have no photographs."""
    for i, shot in enumerate(shots):
        lens = shot.camera
        content = {
            "cam_angle_x": 2 * np.arctan(0.5 * lens.width / lens.fx),
            "cam_transform_mat": ",".join(repr(float(v)) for v in lens.camera_to_world.ravel()),
            "imw": lens.width,
            "imh": lens.height,
        }
        _dump(root / f"train_{i:03d}/metadata.json", content)
        _dump(root / f"test_{i:03d}/metadata.json", content)
        for name in ["rgba.png", "albedo.png", *(["rgba_city.png"] if i else [])]:
            save_pictures(root / f"train_{i:03d}", [shot], [name], alpha=True)
    return root


def record3d(root: Path, shots: Shots) -> Path:
    """The folder of an export: metadata.json, rgb and depth."""
    _pictures(root, shots, "EXR_RGBD/rgb", "{}.png")
    _pictures(root, shots, "EXR_RGBD/depth", "{}.png")
    lens = shots[0].camera
    k = [lens.fx, 0, 0, 0, lens.fy, 0, lens.cx, lens.cy, 1]
    turns = [Rotation.from_matrix(s.camera.camera_to_world[:3, :3]).as_quat() for s in shots]
    poses = [[*q, *s.camera.position] for q, s in zip(turns, shots, strict=True)]
    content = {
        "w": lens.width,
        "h": lens.height,
        "fps": 60,
        "K": k,
        "poses": np.array(poses).tolist(),
    }
    _dump(root / "EXR_RGBD/metadata.json", content)
    return root


def stray_scanner(root: Path, shots: Shots) -> Path:
    """A recording with frames taken out of its video; every other pose has no photograph."""
    numbers = [f"{2 * i:06d}" for i in range(len(shots))]
    save_pictures(root / "rgb", shots, [f"{number}.png" for number in numbers], alpha=False)
    save_pictures(root / "confidence", shots, [f"{number}.png" for number in numbers], alpha=False)
    lens = shots[0].camera
    rows = [[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]
    (root / "camera_matrix.csv").write_text("\n".join(",".join(map(repr, row)) for row in rows))
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for number, shot in zip(numbers, shots, strict=True):
        turn = (shot.camera.camera_to_world @ FLIP)[:3, :3]
        row = [*shot.camera.position, *Rotation.from_matrix(turn).as_quat()]
        values = ", ".join(repr(float(value)) for value in row)
        lines += [f"0.1, {number}, {values}", f"0.2, {int(number) + 1:06d}, {values}"]
    (root / "odometry.csv").write_text("\n".join(lines) + "\n")
    return root


def arkit(root: Path, shots: Shots) -> Path:
    """Frames of 3D Scanner App, with depth beside them."""
    _pictures(root, shots, ".", "frame_{:05d}.png")
    _pictures(root, shots, ".", "depth_{:05d}.png")
    for i, shot in enumerate(shots):
        lens = shot.camera
        k = [lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1]
        pose = lens.camera_to_world.ravel().tolist()
        _dump(root / f"frame_{i:05d}.json", {"cameraPoseARFrame": pose, "intrinsics": k})
    return root


def splats(root: Path, shots: Shots) -> Path:
    """cameras.json of a training run, put beside the photographs."""
    names = _pictures(root, shots, "images", "s{:02d}.png")
    cameras = [
        {
            "id": i,
            "img_name": name[:-4],
            "width": shot.camera.width,
            "height": shot.camera.height,
            "position": shot.camera.position.tolist(),
            "rotation": (shot.camera.camera_to_world @ FLIP)[:3, :3].tolist(),
            "fy": shot.camera.fy,
            "fx": shot.camera.fx,
        }
        for i, (name, shot) in enumerate(zip(names, shots, strict=True))
    ]
    _dump(root / "cameras.json", cameras)
    return root


def colmap_rig(root: Path, shots: Shots) -> Path:
    """A model as COLMAP 4 makes it of rigs and frames that say where cameras were."""
    import pycolmap

    names = _pictures(root, shots, "images", "c{:02d}.png")
    lens, folder = shots[0].camera, root / "sparse/0"
    folder.mkdir(parents=True)
    size = f"PINHOLE {lens.width} {lens.height}"
    camera = f"{size} {lens.fx!r} {lens.fy!r} {lens.cx!r} {lens.cy!r}"
    (folder / "cameras.txt").write_text(f"1 {camera}\n2 {camera}\n")
    offset = np.eye(4)
    offset[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.1, 0.2]).as_matrix()
    offset[:3, 3] = [0.5, -0.2, 0.1]
    rigs, frames = [], []
    for i, shot in enumerate(shots):  # each frame has a rig of its own, so that any camera fits
        own = i % 2 + 1
        rig = _view(shot) if own == 1 else np.linalg.inv(offset) @ _view(shot)
        rigs.append(f"{i + 1} 2 CAMERA 1 CAMERA 2 1 {_rigid(offset)}")
        frames.append(f"{i + 1} {i + 1} {_rigid(rig)} 1 CAMERA {own} {i + 1}")
    images = [f"{i + 1} 1 0 0 0 0 0 1 {i % 2 + 1} {name}\n\n" for i, name in enumerate(names)]
    (folder / "rigs.txt").write_text("# rigs\n" + "\n".join(rigs) + "\n")
    (folder / "frames.txt").write_text("# frames\n" + "\n".join(frames) + "\n")
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text("")
    model = pycolmap.Reconstruction(folder)
    for file in folder.iterdir():
        file.unlink()
    model.write_binary(folder)
    return root


def _rigid(matrix: np.ndarray) -> str:
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return " ".join(repr(float(value)) for value in (w, x, y, z, *matrix[:3, 3]))
