# SPDX-License-Identifier: Apache-2.0
"""What is fed with hostile bytes: every reader, the image door, results and the job protocol.

A target takes the bytes of one file and ends well, whatever they are: with an answer, or with an
error meant for the user. Anything else is a bug.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from capture import app_writers, program_writers, writers
from capture.scene import cameras, shoot
from evaluation import sphere_run
from PIL import Image

from robir.capture.arrays import stored_arrays
from robir.capture.checks.frame_checks import check_frames
from robir.capture.images.decode import exif_values, opened, orientation
from robir.capture.images.loading import read_mask
from robir.capture.mesh_file import SUFFIXES, read_mesh
from robir.capture.recognise import read_frames
from robir.capture.store import load_capture
from robir.errors import RobirError
from robir.export.gltf import write_glb
from robir.export.textures import finished_textures
from robir.jobs import client
from robir.pipeline.folder import read_run
from robir.pipeline.ledger import stage_state

Target = Callable[[bytes], None]

CRASHES = Path(__file__).with_name("crashes")
"""Files that once ended in a crash, in a folder for each target; they stay."""

_POSES = {
    "nerf_synthetic": (writers.nerf_synthetic, "transforms_train.json"),
    "nerfstudio": (writers.nerfstudio, "transforms.json"),
    "colmap_images": (partial(writers.colmap, binary=True), "sparse/0/images.bin"),
    "colmap_cameras": (partial(writers.colmap, binary=True), "sparse/0/cameras.bin"),
    "colmap_points": (partial(writers.colmap, binary=True), "sparse/0/points3D.bin"),
    "colmap_text": (partial(writers.colmap, binary=False), "sparse/0/images.txt"),
    "colmap_text_cameras": (partial(writers.colmap, binary=False), "sparse/0/cameras.txt"),
    "neus": (writers.neus, "cameras_sphere.npz"),
    "llff": (partial(writers.llff, numeric=True), "poses_bounds.npy"),
    "polycam": (app_writers.polycam, "keyframes/corrected_cameras/4000000017.json"),
    "reality_scan": (app_writers.reality_scan, "cameras.csv"),
    "metashape": (app_writers.metashape, "cameras.xml"),
    "meshroom": (partial(app_writers.meshroom, version=(1, 2, 6)), "cameras.sfm"),
    "opensfm": (program_writers.opensfm, "opensfm/reconstruction.json"),
    "openmvg": (program_writers.openmvg, "sfm_data.json"),
    "bundler": (program_writers.bundler, "bundle.out"),
    "bundler_list": (program_writers.bundler, "list.txt"),
    "reality_xmp": (program_writers.reality_xmp, "images/R000.xmp"),
    "sdfstudio": (program_writers.sdfstudio, "meta_data.json"),
    "nerfactor": (program_writers.nerfactor, "train_000/metadata.json"),
    "record3d": (program_writers.record3d, "EXR_RGBD/metadata.json"),
    "stray_scanner": (program_writers.stray_scanner, "odometry.csv"),
    "stray_matrix": (program_writers.stray_scanner, "camera_matrix.csv"),
    "arkit": (program_writers.arkit, "frame_00000.json"),
    "splats": (program_writers.splats, "cameras.json"),
    "colmap_rigs": (program_writers.colmap_rig, "sparse/0/rigs.txt"),
    "colmap_frames": (program_writers.colmap_rig, "sparse/0/frames.txt"),
}
MESHES = {f"mesh_{suffix[1:]}": suffix for suffix in SUFFIXES}
"""Targets that are meshes, with the suffix of each."""

_PICTURES = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")


class Targets:
    """All targets by name, with whole files to begin from, in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.calls: dict[str, Target] = {}
        self.seeds: dict[str, list[bytes]] = {}
        shots = [shoot(camera) for camera in cameras(count=3, size=(16, 16))]
        for name, (write, file) in _POSES.items():
            root = write(folder / name, shots)
            self._add(name, root / file, partial(_read_poses, root))
        picture = folder / "picture.png"
        for kind in _PICTURES:
            Image.fromarray(shots[0].rgba).convert("RGB").save(picture, format=kind)
            self._add("image", picture, partial(_read_picture, picture))
        self._add_meshes(folder / "meshes")
        self._add_results(folder / "result", shots)

    def _add(self, name: str, file: Path, read: Callable[[], object]) -> None:
        def call(content: bytes) -> None:
            file.write_bytes(content)
            try:
                read()
            except RobirError as error:
                str(error).encode("utf-8")

        self.calls[name] = call
        self.seeds.setdefault(name, []).append(file.read_bytes())
        self.seeds[name] += [p.read_bytes() for p in sorted((CRASHES / name).glob("*"))]

    def _add_meshes(self, folder: Path) -> None:
        folder.mkdir()
        box = trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2] / 2 + 0.5)
        for name, suffix in MESHES.items():
            file = folder / f"scan{suffix}"
            content = box.export(file_type=suffix[1:])
            if isinstance(content, dict):  # glTF and its buffers
                for part, data in content.items():
                    (folder / part).write_bytes(data)
                content = content["model.gltf"]
            file.write_bytes(content.encode() if isinstance(content, str) else content)
            self._add(name, file, partial(read_mesh, file))
        textures = finished_textures(sphere_run.sphere_textures(), 12)
        textures = replace(textures, normal_map=np.full((4, 4, 3), 128, np.uint8))
        file = folder / "scan.glb"
        write_glb(file, sphere_run.parts(textures), "scan")
        self._add("mesh_glb", file, partial(read_mesh, file))

    def _add_results(self, root: Path, shots: list) -> None:
        from hostile.results import write_result

        paths = write_result(root, shots)
        follow = partial(client.snapshot, root)
        self._add("status", paths.status, follow)
        self._add("worker", paths.worker, follow)
        self._add("worker_log", paths.worker_log, follow)
        self._add("run", paths.run, lambda: (follow(), read_run(paths)))
        manifest = paths.manifest("capture")
        self._add("manifest", manifest, lambda: stage_state(paths, "capture", "f"))
        folder = paths.stage("capture")
        self._add("capture_json", folder / "capture.json", lambda: load_capture(folder))
        arrays = folder / "arrays.npz"
        self._add("arrays", arrays, lambda: stored_arrays(arrays, {"a": "f N N", "b?": "i *"}))


def _read_poses(root: Path) -> None:
    check_frames(read_frames(root))


def _read_picture(path: Path) -> None:
    with opened(path) as picture:
        exif_values(picture)
        orientation(picture)
    read_mask(path, (16, 16))
