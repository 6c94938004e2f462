# SPDX-License-Identifier: Apache-2.0
"""Phones and other programs: lenses by their own equations, rigs, and what is refused or said."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from capture import app_writers, program_writers, writers
from capture.readers.test_every_format import read_back
from PIL import Image
from scipy.spatial.transform import Rotation

from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion
from robir.capture.poses.sources import find_photographs
from robir.capture.recognise import Workshop, read_capture, read_frames, read_or_filmed
from robir.capture.refusal import CaptureRefusedError
from robir.capture.views import unheard

# rotation and place of the second camera of a rig in the first one's frame
OFFSET = (Rotation.from_euler("xyz", [0.2, 0.1, -0.4]).as_matrix(), np.array([0.3, -0.1, 0.2]))


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def refused(root: Path, *words: str) -> None:
    with pytest.raises(CaptureRefusedError) as caught:
        read_frames(root)
    assert all(finding.cure for finding in caught.value.findings if finding.level == "error")
    for word in words:
        assert word in str(caught.value)


def said(root: Path) -> dict[str, str]:
    return {finding.code: finding.message for finding in read_frames(root).findings}


def bent(root: Path) -> Distortion:
    (distortion,) = {frame.lens.distortion for frame in read_frames(root).frames}
    return distortion


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (
            {"projection_type": "brown", "k1": 0.1, "k2": -0.2, "k3": 0.3, "p1": 0.01, "p2": 0.02},
            Distortion(radial=(0.1, -0.2, 0.3, 0.0), tangential=(0.01, 0.02)),
        ),
        (
            {"projection_type": "perspective", "focal": 1.25, "focal_x": None, "k1": 0.1, "k3": 9},
            Distortion(radial=(0.1, 0.0, 0.0, 0.0)),
        ),
        (
            {"projection_type": "fisheye_opencv", "k1": 0.1, "k4": 0.4},
            Distortion(radial=(0.1, 0.0, 0.0, 0.4), is_fisheye=True),
        ),
    ],
)
def test_opensfm_lens(camera, expected, shots, tmp_path):
    program_writers.opensfm(tmp_path, shots)
    path = tmp_path / "opensfm/reconstruction.json"
    edit(path, lambda parts: parts[1]["cameras"]["v2 drone"].update(camera))
    assert bent(tmp_path) == expected
    edit(path, lambda parts: parts[1]["cameras"]["v2 drone"].update(projection_type="dual"))
    refused(tmp_path, "camera model dual", "opensfm undistort")


def test_openmvg_lens(shots, tmp_path):
    program_writers.openmvg(tmp_path, shots)

    def brown(content):
        wrapper = content["intrinsics"][0]["value"]["ptr_wrapper"]
        base = wrapper["data"]
        base.pop("disto_k3")
        wrapper["data"] = {"value0": base, "disto_t2": [0.1, 0.2, 0.3, 0.01, 0.02]}

    edit(tmp_path / "sfm_data.json", brown)
    assert bent(tmp_path) == Distortion(radial=(0.1, 0.2, 0.3, 0.0), tangential=(0.01, 0.02))
    path = tmp_path / "sfm_data.json"
    path.write_text(path.read_text().replace("pinhole_radial_k3", "spherical"))
    refused(tmp_path, "spherical", "openMVG_main_ExportUndistortedImages")


def test_bundler_lens_and_photographs_that_were_not_placed(shots, tmp_path):
    program_writers.bundler(tmp_path, shots)
    path = tmp_path / "bundle.out"
    path.write_text(re.sub(r"^(\S+) 0\.0 0\.0$", r"\1 -0.1 0.02", path.read_text(), flags=re.M))
    assert bent(tmp_path) == Distortion(radial=(-0.1, 0.02, 0.0, 0.0))
    assert said(tmp_path)["unposed-views"].startswith("1 of 9 photographs")
    (tmp_path / "list.txt").rename(tmp_path / "photographs.lst")
    refused(tmp_path, "names no photographs", "list.txt")


def test_reality_xmp_lens(shots, tmp_path):
    """By the order of AliceVision's import: k1 to k4, then OpenCV's p2 and p1."""
    terms = "0.1 -0.2 0.3 0 0.02 0.01"
    program_writers.reality_xmp(tmp_path, shots, "brown3t2", terms)
    assert bent(tmp_path) == Distortion(radial=(0.1, -0.2, 0.3, 0.0), tangential=(0.01, 0.02))
    program_writers.reality_xmp(tmp_path, shots, "division", terms)
    refused(tmp_path, "camera model division", "Brown3")


def test_a_rig_of_metashape(odd_shots, tmp_path):
    """Every other camera is a slave whose place its sensor holds."""
    app_writers.metashape(tmp_path, odd_shots)
    path = tmp_path / "cameras.xml"
    text = path.read_text()
    sensor = re.search(r'<sensor id="3".*?</sensor>', text, re.S)[0]
    turn, move = (" ".join(map(repr, values.ravel().tolist())) for values in OFFSET)
    slave = sensor.replace('id="3"', 'id="4" master_id="3"').replace(
        "<resolution", f"<rotation>{turn}</rotation><location>{move}</location><resolution", 1
    )
    text = text.replace(sensor, sensor + slave)
    inverse = np.eye(4)
    inverse[:3, :3], inverse[:3, 3] = OFFSET
    inverse = np.linalg.inv(inverse)
    for i in range(1, 8, 2):
        entry = re.search(rf'<camera id="{i}".*?</camera>', text, re.S)[0]
        words = re.search(r"<transform>(.*)</transform>", entry)[1].split()
        master = np.array(words, dtype=float).reshape(4, 4) @ inverse
        numbers = " ".join(map(repr, master.ravel().tolist()))
        hidden = f'<camera id="{i + 100}" sensor_id="3" enabled="0" label="m{i}"><transform>'
        own = f'<camera id="{i}" sensor_id="4" master_id="{i + 100}" label="DSC{i:04d}"/>'
        text = text.replace(entry, f"{hidden}{numbers}</transform></camera>{own}")
    path.write_text(text)
    read_back(lambda root, shots: root, tmp_path, odd_shots)
    path.write_text(re.sub(r"<location>.*?</location>", "", text))
    refused(tmp_path, "rig of cameras", "without a rig")


def test_a_rig_of_meshroom(odd_shots, tmp_path):
    app_writers.meshroom(tmp_path, odd_shots, (1, 2, 14))
    turn, move = OFFSET

    def as_rig(content):
        plain = {"rotation": np.eye(3).ravel().tolist(), "center": [0.0, 0.0, 0.0]}
        # the numbers of a rotation are stored column by column from world to camera
        second = {"rotation": turn.ravel().tolist(), "center": move.tolist()}
        poses = [{"status": "constant", "pose": pose} for pose in (plain, second)]
        content["rigs"] = [{"rigId": "5", "subPoses": poses}]
        for i, (view, entry) in enumerate(zip(content["views"], content["poses"], strict=False)):
            view |= {"rigId": "5", "subPoseId": str(i % 2), "isPoseIndependant": "0"}
            if i % 2:
                transform = entry["pose"]["transform"]
                own = np.array(transform["rotation"], dtype=float).reshape(3, 3)
                rig = own @ turn.T
                centre = np.array(transform["center"], dtype=float) - rig @ move
                transform |= {"rotation": rig.ravel().tolist(), "center": centre.tolist()}

    edit(tmp_path / "cameras.sfm", as_rig)
    read_back(lambda root, shots: root, tmp_path, odd_shots)


def test_metashape_chunks_without_a_common_frame(odd_shots, tmp_path):
    app_writers.metashape(tmp_path, odd_shots, placed=False)
    path = tmp_path / "cameras.xml"
    text = path.read_text()
    chunk = re.search(r"<chunk.*</chunk>", text, re.S)[0]
    copy = re.sub(r'<camera id="[0-2]".*?</camera>', "", chunk, flags=re.S)
    path.write_text(text.replace(chunk, copy + chunk))
    frames = read_frames(tmp_path)
    assert len(frames.frames) == 8
    assert "each in a frame of its own; the one of 8 is read" in said(tmp_path)["several-parts"]


def test_bad_frames_and_splits_are_heeded(odd_shots, tmp_path):
    writers.nerfstudio(tmp_path, odd_shots)

    def mark(content):
        content["frames"][0]["is_bad"] = True
        content["frames"][1]["split"] = "val"
        content["test_frames"] = [content["frames"].pop()]

    edit(tmp_path / "transforms.json", mark)
    frames = read_frames(tmp_path).frames
    assert len(frames) == 7
    assert [frame.split for frame in frames].count("test") == 2
    assert "1 photographs are left out" in said(tmp_path)["bad-frames"]


def test_paths_of_another_machine(odd_shots, tmp_path):
    writers.nerfstudio(tmp_path / "here", odd_shots)

    def elsewhere(content):
        for frame in content["frames"]:
            frame["file_path"] = f"C:\\captures\\mug\\{frame['file_path']}".replace("/", "\\")
            frame["mask_path"] = f"../../old/{frame['mask_path']}"

    edit(tmp_path / "here/transforms.json", elsewhere)
    frames = read_frames(tmp_path / "here").frames
    assert all(frame.image.is_file() and frame.mask.is_file() for frame in frames)
    assert "found by their names" in said(tmp_path / "here")["found-by-name"]


def test_of_several_files_of_poses_one_is_taken_and_the_rest_named(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=True)
    app_writers.metashape(tmp_path, odd_shots)
    writers.llff(tmp_path, odd_shots, numeric=False)
    message = said(tmp_path)["several-poses"]
    assert "from sparse/0" in message
    assert "cameras.xml, poses_bounds.npy is left aside" in message


def test_known_files_that_are_not_read_are_named_with_how_to_convert_them(shots, tmp_path):
    writers.save_pictures(tmp_path / "images", shots, [f"{i}.png" for i in range(8)], alpha=False)
    (tmp_path / "truck.psx").write_text("<document/>")
    with pytest.raises(CaptureRefusedError) as caught:
        read_capture(tmp_path, None, CaptureConfig())
    (named,) = [f for f in caught.value.findings if f.code == "poses-not-read"]
    assert "truck.psx is a Metashape project" in named.message
    assert "Export Cameras" in named.cure


@pytest.mark.parametrize("folder", ["confidence", "depth", "albedo", "my_masks", "normals"])
def test_other_pictures_are_never_photographs(folder, shots, tmp_path):
    names = [f"{i}.png" for i in range(8)]
    writers.save_pictures(tmp_path / "views", shots, names, alpha=False)
    writers.save_pictures(tmp_path / folder, shots, names, alpha=False)
    others = [f"{i}_{folder}.png" for i in range(8)]
    writers.save_pictures(tmp_path / "views", shots, others, alpha=False)
    assert find_photographs(tmp_path) == [tmp_path / "views" / name for name in names]


def test_a_recording_of_stray_scanner_without_frames(shots, tmp_path):
    program_writers.stray_scanner(tmp_path, shots)
    assert said(tmp_path)["unused-cameras"].startswith("8 poses")
    (tmp_path / "rgb").rename(tmp_path / "depth")
    refused(tmp_path, "still in its video", "ffmpeg -i rgb.mp4")


def blended(rgba: np.ndarray) -> np.ndarray:
    """A picture (H, W, 3) on the grey that writers put under it."""
    share = rgba[:, :, 3:] / 255
    return rgba[:, :, :3] * share + 90 * (1 - share)


def test_a_recording_of_stray_scanner_with_its_video(odd_shots, tmp_path):
    """The odometry has twice as many rows as the film has frames; the capture stays as it is."""
    av = pytest.importorskip("av", reason="VIDEO NOT TESTED: no av")
    root = program_writers.stray_scanner(tmp_path / "scan", odd_shots)
    pictures = sorted((root / "rgb").iterdir())
    with av.open(str(root / "rgb.mp4"), "w") as film:
        stream = film.add_stream("mpeg4", rate=24)
        stream.width, stream.height, stream.pix_fmt = 48, 48, "yuv420p"
        for picture in (file for file in pictures for _ in range(2)):
            film.mux(stream.encode(av.VideoFrame.from_image(Image.open(picture))))
        film.mux(stream.encode())
    shutil.rmtree(root / "rgb")
    before = sorted(root.rglob("*"))
    workshop = Workshop(folder=tmp_path / "work", seed=0)
    found = read_or_filmed(root, CaptureConfig(), workshop, unheard)
    assert sorted(root.rglob("*")) == before
    assert found.root == workshop.folder
    assert found.findings[0].code == "video-frames"
    assert len(found.frames) == 16
    for number, frame in enumerate(found.frames):
        assert frame.image == workshop.folder / f"frame_{number:06d}.png"
        truth = odd_shots[number // 2].camera
        np.testing.assert_allclose(frame.camera_to_world, truth.camera_to_world, atol=1e-9)
    with Image.open(found.frames[6].image) as taken:
        apart = np.asarray(taken.convert("RGB"), float) - blended(odd_shots[3].rgba)
    assert np.abs(apart).mean() < 12


@pytest.mark.parametrize("name", ["metadata", "metadata.json"])
def test_a_recording_of_record3d_as_it_was_unpacked(name, odd_shots, tmp_path):
    program_writers.record3d(tmp_path, odd_shots)
    (tmp_path / "EXR_RGBD/metadata.json").rename(tmp_path / name)
    (tmp_path / "EXR_RGBD/rgb").rename(tmp_path / "rgbd")
    read_back(lambda root, shots: root, tmp_path, odd_shots)
    assert said(tmp_path) == {}


@pytest.mark.parametrize(
    ("write", "name", "old", "new", "words"),
    [
        (program_writers.sdfstudio, "meta_data.json", '"camtoworld": [[', '"camtoworld": [[7], [',
         ["no 4x4 matrix"]),
        (program_writers.record3d, "EXR_RGBD/metadata.json", '"w": 48', '"w": "wide"', ['"w"']),
        (program_writers.arkit, "frame_00000.json", '"intrinsics": [', '"intrinsics": ["x", ',
         ['"intrinsics', "All Data"]),
        (program_writers.splats, "cameras.json", '"fx"', '"focal"', ['"fx"', "missing"]),
        (program_writers.nerfactor, "train_000/metadata.json", '_mat": "', '_mat": "7,',
         ["cam_transform_mat", "length <= 16"]),
        (program_writers.bundler, "bundle.out", "9 ", "12 ", ["12 cameras"]),
        (program_writers.opensfm, "opensfm/reconstruction.json", '"v2 drone": {', '"x": {',
         ["camera of", "is missing"]),
    ],
)  # fmt: skip
def test_damage_is_named(write, name, old, new, words, shots, tmp_path):
    write(tmp_path, shots)
    path = tmp_path / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    refused(tmp_path, *words)
