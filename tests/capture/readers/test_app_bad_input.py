# SPDX-License-Identifier: Apache-2.0
"""Bad exports of photogrammetry programs are refused in words that name the file and the cure."""

from __future__ import annotations

from pathlib import Path

import pytest
from capture import app_writers, writers
from capture.readers.test_bad_input import edit, refused
from capture.scene import cameras, shoot

FILES = {
    "polycam": "keyframes/corrected_cameras/4000000048.json",
    "realityscan": "cameras.csv",
    "metashape": "cameras.xml",
    "meshroom": "cameras.sfm",
}


@pytest.fixture(scope="module")
def few() -> list:
    """Eight coarse pictures with a centred lens."""
    return [shoot(camera, samples=1) for camera in cameras()]


def write(form: str, root: Path, shots: list) -> Path:
    """The capture; path of its file of poses."""
    {
        "polycam": lambda: app_writers.polycam(root, shots),
        "realityscan": lambda: app_writers.reality_scan(root, shots),
        "metashape": lambda: app_writers.metashape(root, shots),
        "meshroom": lambda: app_writers.meshroom(root, shots, (1, 2, 14)),
    }[form]()
    return root / FILES[form]


def swap(path: Path, *pairs: tuple[str, str]) -> None:
    """Replace texts in a file, each of which is there."""
    text = path.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


@pytest.mark.parametrize(
    ("form", "stem"), [("realityscan", "IMG 03"), ("metashape", "DSC0003"), ("meshroom", "P1003")]
)
def test_a_missing_photograph_is_named(form, stem, few, tmp_path):
    write(form, tmp_path, few)
    next(p for p in tmp_path.rglob(f"{stem}.png") if "masks" not in p.parts).unlink()
    refused(tmp_path, "1 of 8", "missing", stem)


@pytest.mark.parametrize("form", FILES)
def test_a_pose_that_is_no_number(form, few, tmp_path):
    path = write(form, tmp_path, few)
    match form:
        case "polycam":
            edit(path, lambda content: content.update(t_12="far"))
            refused(tmp_path, "4000000048.json", "t_12", "number", "Polycam")
        case "realityscan":
            lines = path.read_text().splitlines()
            lines[4] = lines[4].replace(",", ",x", 1)
            path.write_text("\n".join(lines))
            refused(tmp_path, "cameras.csv", '"x" of the row of IMG 02.png', "CSV")
        case "metashape":
            swap(path, ("<transform>", "<transform>a "))
            refused(tmp_path, "cameras.xml", "transform of DSC0001", "16 numbers", "Agisoft XML")
        case "meshroom":
            edit(path, lambda content: content["poses"][2]["pose"]["transform"].pop("center"))
            refused(tmp_path, "cameras.sfm", "center", "StructureFromMotion")


@pytest.mark.parametrize("form", FILES)
def test_poses_of_nan(form, few, tmp_path):
    path = write(form, tmp_path, few)
    match form:
        case "polycam":
            edit(path, lambda content: content.update(t_12=float("nan")))
        case "realityscan":
            lines = path.read_text().splitlines()
            fields = lines[4].split(",")
            fields[4] = "inf"
            path.write_text("\n".join([*lines[:4], ",".join(fields), *lines[5:]]))
        case "metashape":
            swap(path, ("<translation>7.0", "<translation>nan"))
        case "meshroom":

            def change(content):
                content["poses"][2]["pose"]["transform"]["center"][1] = "nan"

            edit(path, change)
    refused(tmp_path, "pose", "NaN")


@pytest.mark.parametrize("form", FILES)
def test_focal_lengths_that_make_no_sense(form, few, tmp_path):
    path = write(form, tmp_path, few)
    match form:
        case "polycam":
            edit(path, lambda content: content.update(fx=-3))
        case "realityscan":
            lines = path.read_text().splitlines()
            fields = lines[4].split(",")
            fields[7] = "0"
            path.write_text("\n".join([*lines[:4], ",".join(fields), *lines[5:]]))
        case "metashape":
            swap(path, ("<f>60.0", "<f>-60.0"))
        case "meshroom":
            edit(path, lambda content: content["intrinsics"][0].update(focalLength="nan"))
    word = {"polycam": '"fx"', "meshroom": '"focalLength"'}.get(form, "focal length")
    refused(tmp_path, path.name, word)


def test_realityscan_exported_without_intrinsics(few, tmp_path):
    path = write("realityscan", tmp_path, few)
    rows = [line.split(",")[:7] for line in path.read_text().splitlines()[1:]]
    path.write_text("\n".join(",".join(row) for row in rows))
    refused(tmp_path, "no column f", "Internal/External camera parameters")


def test_realityscan_row_cut_short(few, tmp_path):
    path = write("realityscan", tmp_path, few)
    path.write_text(path.read_text()[:-30])
    refused(tmp_path, "row 8 has", "cameras.csv")


def test_realityscan_unreadable_photograph(few, tmp_path):
    write("realityscan", tmp_path, few)
    (tmp_path / "photos/IMG 03.png").write_bytes(b"nothing")
    refused(tmp_path, "IMG 03.png")


@pytest.mark.parametrize(
    ("kind", "extra", "words"),
    [
        ("spherical", "", "type spherical"),
        ("frame", "<p3>0.1</p3>", "P3"),
        ("equisolid_fisheye", "", "equisolid_fisheye"),
    ],
)
def test_metashape_sensors_that_are_not_read(kind, extra, words, few, tmp_path):
    path = write("metashape", tmp_path, few)
    swap(path, ('type="frame"', f'type="{kind}"'), ("</calibration>", f"{extra}</calibration>"))
    refused(tmp_path, words, "Undistort Photos")


def test_metashape_without_calibration(few, tmp_path):
    path = write("metashape", tmp_path, few)
    swap(path, ("<f>", "<fx>"), ("</f>", "</fx>"))
    refused(tmp_path, "no calibration with a focal length", "DSC0001")


def test_metashape_without_aligned_cameras(few, tmp_path):
    path = write("metashape", tmp_path, few)
    swap(path, ("<camera ", '<camera enabled="false" '))
    refused(tmp_path, "no aligned camera", "Align the photographs")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content.pop("poses"), ("no view with a pose", "StructureFromMotion")),
        (lambda content: content["intrinsics"].clear(), ("'77'", "cameras.sfm")),
        (
            lambda content: content["intrinsics"][0].update(distortionType="3deanamorphic4"),
            ("3deanamorphic4", "undistorted"),
        ),
        (
            lambda content: content["intrinsics"][0].update(type="equirectangular"),
            ("equirectangular", "undistorted"),
        ),
        (
            lambda content: content["views"][0].update(isPoseIndependant="false"),
            ("rig of cameras",),
        ),
    ],
)
def test_meshroom_files_that_are_not_read(change, words, few, tmp_path):
    path = write("meshroom", tmp_path, few)
    edit(path, change)
    refused(tmp_path, *words)


@pytest.mark.parametrize(
    "keys",
    [
        {"applied_scale": 0},
        {"applied_scale": "1"},
        {"applied_transform": [[1, 0], [0, 1]]},
        {"applied_transform": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
        {"applied_transform": [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
        {"applied_transform": "none"},
    ],
)
def test_applied_transforms_that_cannot_be_undone(keys, few, tmp_path):
    writers.nerfstudio(tmp_path, few)
    edit(tmp_path / "transforms.json", lambda content: content.update(keys))
    refused(tmp_path, "transforms.json", "applied_")


@pytest.mark.parametrize("values", [[1, 2, "x"], [1] * 7, {"k1": 1}, [1, float("nan")]])
def test_lists_of_lens_parameters_that_make_no_sense(values, few, tmp_path):
    writers.nerfstudio(tmp_path, few)
    edit(tmp_path / "transforms.json", lambda content: content.update(distortion_params=values))
    refused(tmp_path, "distortion_params", "transforms.json")
