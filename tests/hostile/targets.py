# SPDX-License-Identifier: Apache-2.0
"""What is fed with hostile bytes: every reader, the image door, results and the job protocol.

A target takes the bytes of one file and ends well, whatever they are: with an answer, or with an
error meant for the user. Anything else is a bug.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from capture import app_writers, program_writers, writers
from capture.scene import cameras, shoot
from evaluation import sphere_run
from PIL import Image

from robir.batch.local import Standing, write_standings
from robir.batch.plan import keep_plan, kept_plan, read_plan
from robir.capture.arrays import stored_arrays
from robir.capture.checks.findings import check_frames
from robir.capture.images.decode import exif_values, opened, orientation
from robir.capture.images.loading import read_mask
from robir.capture.mesh_file import SUFFIXES, read_mesh
from robir.capture.poses.sources import take_frames
from robir.capture.recognise import read_frames
from robir.capture.store import load_capture
from robir.errors import RobirError
from robir.evaluation.light import refuse_light
from robir.export.gltf import write_glb
from robir.export.textures import finished_textures, write_exr
from robir.jobs import client
from robir.jobs.library import LibraryPaths, read_batch
from robir.pipeline.folder import read_run
from robir.pipeline.ledger import stage_state

Target = Callable[[bytes], None]

# files that once ended in a crash, in a folder for each target; they stay
CRASHES = Path(__file__).with_name("crashes")

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
}
# targets that are meshes, with the suffix of each
MESHES = {f"mesh_{suffix[1:]}": suffix for suffix in SUFFIXES}

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
        self._add_library(folder / "library")
        light = folder / "light.exr"
        write_exr(light, np.ones((8, 16, 3), np.float32))
        self._add("light_exr", light, partial(refuse_light, light))
        light = folder / "light.hdr"
        light.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\0\0\0\0")
        self._add("light_hdr", light, partial(refuse_light, light))
        film = write_film(folder / "film.mp4")
        self._add("video", film, lambda: take_frames(film, folder / "frames", lambda *_: None))

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

    def _add_library(self, root: Path) -> None:
        paths = LibraryPaths(root)
        (root / "shots" / "lamp").mkdir(parents=True)
        plan = root / "PLAN.toml"
        plan.write_text("author = 'A'\n[[capture]]\npath = 'shots/*'\ntags = ['a']\n")
        self._add("plan_toml", plan, lambda: read_plan([str(plan)], {}, paths))
        keep_plan(read_plan([str(plan)], {}, paths), paths)
        self._add("plan_json", paths.plan, lambda: kept_plan(paths, None))
        standing = Standing(name="lamp", state="running", fraction=0.5)
        write_standings(paths, [standing], 3.0)
        self._add("batch_json", paths.state, lambda: _read_state(paths))

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


def write_film(path: Path) -> Path:
    """Five small frames; nothing where videos cannot be read."""
    try:
        import av
    except ImportError:
        path.touch()
        return path
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        for level in range(5):
            picture = np.full((32, 32, 3), 50 * level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


def _read_poses(root: Path) -> None:
    check_frames(read_frames(root))


def _read_picture(path: Path) -> None:
    with opened(path) as picture:
        exif_values(picture)
        orientation(picture)
    read_mask(path, (16, 16))


def _read_state(paths: LibraryPaths) -> None:
    with suppress(OSError, ValueError):  # as the panel does
        read_batch(paths)
