# SPDX-License-Identifier: Apache-2.0
"""Every bad capture is refused in words that name the file and the cure, and left untouched."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from PIL import Image

from robir.capture.config import CaptureConfig
from robir.capture.recognise import check_capture, read_capture, read_frames
from robir.capture.views import without_left_out
from robir.errors import CaptureError


def refused(root: Path, *words: str, masks: Path | None = None) -> str:
    """The message of the refusal; reading and checking agree, and nothing was written."""
    before = _state(root)
    with pytest.raises(CaptureError) as caught:
        read_capture(root, masks, CaptureConfig())
    assert caught.value.exit_code == 3
    capture, findings, _ = check_capture(root, masks, CaptureConfig())
    assert capture is None
    assert findings[0].level == "error"
    assert findings[0].cure
    assert _state(root) == before
    message = str(caught.value)
    for word in words:
        assert word in message, message
    return message


def _state(root: Path) -> list:
    return [(p.name, p.stat().st_mtime_ns, p.stat().st_size) for p in sorted(root.rglob("*"))]


def edit(path: Path, change) -> None:
    """Rewrite a JSON file."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.fixture
def synthetic(shots, tmp_path) -> Path:
    return writers.nerf_synthetic(tmp_path, shots)


@pytest.fixture
def studio(odd_shots, tmp_path) -> Path:
    return writers.nerfstudio(tmp_path, odd_shots)


@pytest.fixture
def sparse(odd_shots, tmp_path) -> Path:
    return writers.colmap(tmp_path, odd_shots, binary=True)


def test_nothing_there(tmp_path):
    refused(tmp_path / "nowhere", "does not exist")
    refused(tmp_path, "neither photographs nor camera poses", "transforms_train.json")


def test_a_folder_of_captures(shots, tmp_path):
    writers.nerf_synthetic(tmp_path / "mug", shots)
    refused(tmp_path, "no capture itself", "mug")


def test_photographs_without_poses(shots, tmp_path):
    writers.save_pictures(tmp_path, shots, [f"{i}.jpg" for i in range(8)], alpha=False)
    refused(tmp_path, "8 photographs but no camera poses", "COLMAP", "--masks DIR")


def test_missing_photographs_are_all_named(synthetic):
    (synthetic / "train/r_2.png").unlink()
    (synthetic / "train/r_5.png").unlink()
    refused(synthetic, "2 of 8", "missing", "train/r_2", "train/r_5")


def test_missing_photographs_are_skipped_if_allowed(synthetic):
    (synthetic / "train/r_2.png").unlink()
    capture, findings, _ = check_capture(synthetic, None, CaptureConfig(missing="skip"))
    assert capture is not None
    assert len(capture.views) == 7
    (skipped,) = [f for f in findings if f.code == "missing-skipped"]
    assert "1 of 8" in skipped.message
    assert skipped.level == "warning"
    assert "r_2" in skipped.files[0]


def test_photographs_are_left_out_by_the_names_that_findings_use(synthetic):
    frames = read_frames(synthetic)
    unwanted = (frames.frames[3].relative, frames.frames[4].name, "nobody")
    left = without_left_out(frames, CaptureConfig(leave_out=unwanted))
    names = [frame.name for frame in frames.frames]
    assert [frame.name for frame in left.frames] == names[:3] + names[5:]
    known = {finding.code: finding for finding in left.findings}
    assert len(known["left-out"].files) == 2
    assert known["unknown-photographs"].files == ("nobody",)


def test_truncated_photograph(synthetic):
    path = synthetic / "train/r_3.png"
    path.write_bytes(path.read_bytes()[:400])
    refused(synthetic, "r_3.png", "truncated")


def test_truncated_jpeg(synthetic):
    generator = np.random.default_rng(0)
    noise = Image.fromarray(generator.integers(0, 255, (48, 48, 3), dtype=np.uint8))
    path = synthetic / "train/r_3.png"
    noise.save(path, format="JPEG")
    path.write_bytes(path.read_bytes()[:1500])
    refused(synthetic, "r_3.png", "truncated")


@pytest.mark.parametrize("content", [b"", b"not a picture at all", b"\x89PNG\r\n\x1a\n"])
def test_not_a_photograph(synthetic, content):
    (synthetic / "train/r_3.png").write_bytes(content)
    refused(synthetic, "r_3.png")


@pytest.mark.parametrize("key", ["frames", "camera_angle_x"])
def test_missing_key_of_the_file(synthetic, key):
    edit(synthetic / "transforms_train.json", lambda content: content.pop(key))
    refused(synthetic, "transforms_train.json", f'"{key}' if key == "frames" else key, "missing")


@pytest.mark.parametrize("key", ["file_path", "transform_matrix"])
def test_missing_key_of_a_frame(synthetic, key):
    edit(synthetic / "transforms_train.json", lambda content: content["frames"][4].pop(key))
    refused(synthetic, "transforms_train.json", f'"{key}"', "frame 4")


def test_transforms_that_are_no_json(synthetic):
    (synthetic / "transforms_train.json").write_text('{"frames": [')
    refused(synthetic, "transforms_train.json", "JSON")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda pose: pose[0].__setitem__(3, float("nan")), "NaN"),
        (lambda pose: pose[0].__setitem__(3, float("inf")), "infinite"),
        (lambda pose: pose.__setitem__(1, list(pose[0])), "singular"),
        (lambda pose: [row.__setitem__(0, -row[0]) for row in pose], "mirrors"),
        (lambda pose: [row.__setitem__(0, 2 * row[0]) for row in pose], "unequal length"),
    ],
)
def test_bad_poses(synthetic, spoil, words):
    def change(content):
        spoil(content["frames"][6]["transform_matrix"])

    edit(synthetic / "transforms_train.json", change)
    refused(synthetic, "pose", words, "train/r_6")


@pytest.mark.parametrize("matrix", [[[1, 0], [0, 1]], "none", [["a"] * 4] * 4, None])
def test_poses_that_are_no_matrix(synthetic, matrix):
    def change(content):
        content["frames"][6]["transform_matrix"] = matrix

    edit(synthetic / "transforms_train.json", change)
    refused(synthetic, "transform_matrix", "frame 6")


def test_wrong_image_size(studio):
    Image.new("RGB", (40, 48), "gray").save(studio / "images/frame_00002.png")
    Image.new("L", (40, 48), 255).save(studio / "mattes/frame_00002.png")
    refused(studio, "frame_00002.png", "40x48", "its pose is for 48x48")


def test_wrong_mask_size(studio):
    Image.new("L", (40, 48), 255).save(studio / "mattes/frame_00002.png")
    refused(studio, "frame_00002.png", "40x48", "48x48", "mask")


def test_mask_paths_for_some_frames_only(studio):
    edit(studio / "transforms.json", lambda content: content["frames"][1].pop("mask_path"))
    refused(studio, "1 of 8", "mask_path", "--masks DIR")


@pytest.mark.parametrize(("key", "value"), [("fl_x", float("nan")), ("fl_x", -3), ("cx", "48")])
def test_bad_intrinsics(studio, key, value):
    edit(studio / "transforms.json", lambda content: content.update({key: value}))
    refused(studio, f'"{key}"')


@pytest.mark.parametrize(
    "change",
    [{"camera_model": "FISHEYE624"}, {"camera_model": "EQUIRECTANGULAR"}, {"orthographic": True}],
)
def test_other_projections(studio, change):
    edit(studio / "transforms.json", lambda content: content.update(change))
    refused(studio, "not supported", "ndistort")


def test_a_colmap_model_without_its_photographs(sparse):
    for path in (sparse / "images").iterdir():
        path.unlink()
    refused(sparse, "8 of 8", "missing", "IMG_000.png")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_truncated_colmap_model(sparse, name):
    path = sparse / "sparse/0" / name
    path.write_bytes(path.read_bytes()[:-5])
    refused(sparse, "sparse/0", "truncated")


@pytest.mark.parametrize(
    "model",
    [
        "FOV",
        "THIN_PRISM_FISHEYE",
        "RAD_TAN_THIN_PRISM_FISHEYE",
        "SIMPLE_DIVISION",
        "DIVISION",
        "EUCM",
        "EQUIRECTANGULAR",
    ],
)
def test_colmap_models_that_are_not_read_or_lack_parameters(model, odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=False)
    path = tmp_path / "sparse/0/cameras.txt"
    path.write_text(f"3 {model} 48 48 58 63 22 25 0.1 0 0 0\n")
    refused(tmp_path, model, "colmap image_undistorter")


@pytest.mark.parametrize(("level", "word"), [(0, "black"), (255, "white")])
def test_flat_photographs(studio, level, word):
    for index in (1, 4):
        Image.new("RGB", (48, 48), (level,) * 3).save(studio / f"images/frame_{index:05d}.png")
    refused(studio, f"2 of 8 photographs are {word}", "00001", "00004")


@pytest.mark.parametrize(("level", "word"), [(0, "empty"), (255, "full")])
def test_flat_masks(studio, level, word):
    Image.new("L", (48, 48), level).save(studio / "mattes/frame_00003.png")
    refused(studio, f"1 of 8 masks are {word}", "00003")


def test_no_masks_at_all(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=True)
    (tmp_path / "masks").rename(tmp_path / "mattes")
    guessed = read_capture(tmp_path, None, CaptureConfig())
    assert "backdrop-masks" in {finding.code for finding in guessed.findings}
    capture = read_capture(tmp_path, tmp_path / "mattes", CaptureConfig())
    assert len(capture.views) == 8
    assert "backdrop-masks" not in {finding.code for finding in capture.findings}


def test_an_opaque_alpha_is_no_mask(synthetic):
    for path in sorted((synthetic / "train").iterdir()):
        Image.linear_gradient("L").resize((48, 48)).convert("RGBA").save(path)
    refused(synthetic, "no masks", "could not be guessed", "--masks DIR")


def test_masks_for_some_photographs_only(sparse):
    (sparse / "masks/IMG_014.png.png").unlink()
    refused(sparse, "1 of 8 photographs have no mask", "IMG_014.png", masks=sparse / "masks")


def test_a_folder_of_masks_that_is_not_there(sparse):
    refused(sparse, "does not exist", "nomasks", masks=sparse / "nomasks")


def test_two_views_only(shots, tmp_path):
    writers.nerf_synthetic(tmp_path, shots[:2])
    refused(tmp_path, "2 posed photographs", "at least 3")


def test_masks_of_other_photographs(sparse):
    names = sorted(path.name for path in (sparse / "masks").iterdir())
    masks = [(sparse / "masks" / name).read_bytes() for name in names]
    for name, mask in zip(names, masks[3:] + masks[:3], strict=True):
        (sparse / "masks" / name).write_bytes(mask)
    _, findings, _ = check_capture(sparse, None, CaptureConfig())
    assert "masks-disagree" in {f.code for f in findings if f.level == "warning"}


def test_masks_without_a_common_object(sparse):
    for index, path in enumerate(sorted((sparse / "masks").iterdir())):
        mask = np.zeros((48, 48), dtype=np.uint8)
        corner = 34 * (index % 2), 34 * (index // 2 % 2)
        mask[corner[0] : corner[0] + 12, corner[1] : corner[1] + 12] = 255
        Image.fromarray(mask).save(path)
    refused(sparse, "do not belong together")


def test_a_photograph_named_twice(synthetic):
    edit(
        synthetic / "transforms_train.json",
        lambda content: content["frames"].append(content["frames"][0]),
    )
    refused(synthetic, "more than once", "train/r_0")


def test_damaged_neus_cameras(odd_shots, tmp_path):
    writers.neus(tmp_path, odd_shots)
    path = tmp_path / "cameras_sphere.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refused(tmp_path, "cameras_sphere.npz")
    path.write_bytes(whole)
    (tmp_path / "image/000003.png").rename(tmp_path / "image/x.png")
    (tmp_path / "image/000004.png").unlink()
    refused(tmp_path, "8 cameras", "7 photographs")


@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (0.0, "singular")])
def test_bad_neus_matrices(odd_shots, tmp_path, value, word):
    writers.neus(tmp_path, odd_shots)
    path = tmp_path / "cameras_sphere.npz"
    arrays = dict(np.load(path))
    arrays["world_mat_3"][:3, :3] = value
    np.savez(path, **arrays)
    refused(tmp_path, word, "000003.png")


def test_bad_llff_poses(shots, tmp_path):
    writers.llff(tmp_path, shots, numeric=False)
    path = tmp_path / "poses_bounds.npy"
    rows = np.load(path)
    np.save(path, rows[:, :15])
    refused(tmp_path, "(8, 15)", "17")
    np.save(path, rows[:5])
    refused(tmp_path, "5 poses", "8 photographs")
    path.write_bytes(b"")
    refused(tmp_path, "poses_bounds.npy", "no readable array")


def test_every_unreadable_photograph_is_named(synthetic):
    for name in ("r_1.png", "r_6.png"):
        (synthetic / "train" / name).write_bytes(b"nothing")
    refused(synthetic, "r_1.png", "r_6.png")
