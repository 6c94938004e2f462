# SPDX-License-Identifier: Apache-2.0
"""Captures of photogrammetry programs: cameras exact, lenses by the programs' own equations."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from capture import app_writers
from capture.readers.test_readers import assert_same, read
from capture.scene import cameras, shoot

from robir.capture.capture import Capture
from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion
from robir.capture.readers.reality_scan import rotation
from robir.capture.recognise import read_capture, read_frames

NEWEST = (1, 2, 14)


@pytest.fixture(scope="module")
def wide_shots() -> list:
    """Eight pictures wider than high with square pixels and an off-centre lens."""
    return [shoot(replace(c, cx=22.25, cy=21.5)) for c in cameras(size=(48, 40))]


@pytest.fixture(scope="module")
def tall_shots() -> list:
    """Eight pictures higher than wide with square pixels and an off-centre lens."""
    return [shoot(replace(c, cx=22.25, cy=25.5)) for c in cameras(size=(40, 52))]


def read_with_masks(root) -> Capture:
    masks = root / "masks"
    return read_capture(root, masks if masks.is_dir() else None, CaptureConfig())


def codes(root) -> dict[str, str]:
    return {finding.code: finding.level for finding in read_with_masks(root).findings}


def test_polycam(odd_shots, tmp_path):
    app_writers.polycam(tmp_path / "session", odd_shots)
    capture = read(tmp_path / "session")
    assert capture.format == "polycam"
    assert_same(capture, odd_shots)
    assert "raw-poses" not in {finding.code for finding in capture.findings}
    # The folder of keyframes itself, and exports with one more folder around them.
    assert_same(read(tmp_path / "session/keyframes"), odd_shots)
    assert_same(read(tmp_path), odd_shots)


def test_polycam_without_corrected_cameras_is_told(odd_shots, tmp_path):
    app_writers.polycam(tmp_path, odd_shots, ("cameras", "images"))
    extra = tmp_path / "keyframes/cameras/7.json"
    extra.write_bytes(next(iter((tmp_path / "keyframes/cameras").iterdir())).read_bytes())
    capture = read(tmp_path)
    assert_same(capture, odd_shots)
    levels = {finding.code: finding.level for finding in capture.findings}
    assert (levels["raw-poses"], levels["unused-cameras"]) == ("warning", "note")


@pytest.mark.parametrize("shape", ["wide", "tall"])
def test_reality_scan(shape, request, tmp_path):
    shots = request.getfixturevalue(f"{shape}_shots")
    app_writers.reality_scan(tmp_path, shots)
    capture = read_with_masks(tmp_path)
    assert capture.format == "realityscan"
    assert_same(capture, shots)
    (tmp_path / "cameras.csv").rename(tmp_path / "export.txt")
    assert_same(read_with_masks(tmp_path), shots)


def test_reality_scan_angles_match_a_real_export():
    """CSV angles and the XMP matrix (world to camera, y down) of one camera, Epic forum 710449."""
    xmp = np.array(
        [
            [0.982594073038806, 0.185426733553445, -0.0112166890261935],
            [-0.032113633044729, 0.11008102707942, -0.993403685341366],
            [-0.18296885582437, 0.976472781986697, 0.114],
        ]
    )
    turned = rotation(163.736597399311, 83.4154313461628, 174.386496244756)
    np.testing.assert_allclose(np.diag([1, -1, -1]) @ turned.T, xmp, atol=2e-4)


def test_reality_scan_lens(wide_shots, tmp_path):
    app_writers.reality_scan(tmp_path, wide_shots, extra="0.1,-0.2,0.03,-0.004,0.005,-0.006")
    lenses = [frame.lens for frame in read_frames(tmp_path).frames]
    bent = Distortion(radial=(0.1, -0.2, 0.03, -0.004), tangential=(-0.006, 0.005))
    assert {lens.distortion for lens in lenses} == {bent}


@pytest.mark.parametrize("placed", [True, False])
def test_metashape(placed, odd_shots, tmp_path):
    app_writers.metashape(tmp_path, odd_shots, placed)
    capture = read_with_masks(tmp_path)
    assert capture.format == "metashape"
    assert_same(capture, odd_shots)
    assert codes(tmp_path)["unaligned-cameras"] == "note"


def test_metashape_component_transform(odd_shots, tmp_path):
    app_writers.metashape(tmp_path, odd_shots)
    path = tmp_path / "cameras.xml"
    text = path.read_text()
    start, end = text.rindex("<transform><rotation"), text.rindex("</chunk>")
    component = f'<components><component id="4">{text[start:end]}</component></components>'
    text = (text[:start] + component + text[end:]).replace("<camera ", '<camera component_id="4" ')
    path.write_text(text)
    assert_same(read_with_masks(tmp_path), odd_shots)


@pytest.mark.parametrize("kind", ["frame", "fisheye"])
def test_metashape_lens(kind, odd_shots, tmp_path):
    """Pixels by the equations of the manual's appendix, term by term."""
    app_writers.metashape(tmp_path, odd_shots)
    values = {
        "k1": -0.2,
        "k2": 0.05,
        "k3": -0.01,
        "k4": 0.002,
        "p1": 0.01,
        "p2": -0.02,
        "b2": 1.7,
    }
    path = tmp_path / "cameras.xml"
    extra = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
    text = path.read_text().replace("</calibration>", f"{extra}</calibration>")
    path.write_text(text.replace('type="frame"', f'type="{kind}"'))
    lens = read_frames(tmp_path).frames[0].lens
    generator = np.random.default_rng(3)
    x, y = generator.uniform(-0.6, 0.6, (2, 50))
    found_x, found_y = lens.distortion.apply(x, y)
    if kind == "fisheye":
        x0, y0, r0 = x, y, np.hypot(x, y)
        x, y = x0 * np.arctan(r0) / r0, y0 * np.arctan(r0) / r0
    v, r = values, np.hypot(x, y)
    radial = 1 + v["k1"] * r**2 + v["k2"] * r**4 + v["k3"] * r**6 + v["k4"] * r**8
    x1 = x * radial + v["p1"] * (r**2 + 2 * x**2) + 2 * v["p2"] * x * y
    y1 = y * radial + v["p2"] * (r**2 + 2 * y**2) + 2 * v["p1"] * x * y
    f, b1 = 63.0, 58.0 - 63.0
    assert lens.fx is not None
    assert lens.fy is not None
    column = 48 * 0.5 + (22.25 - 24) + x1 * f + x1 * b1 + y1 * v["b2"]
    np.testing.assert_allclose(found_x * lens.fx + lens.cx, column, rtol=1e-12)
    row = 48 * 0.5 + (25.5 - 24) + y1 * f
    np.testing.assert_allclose(found_y * lens.fy + lens.cy, row, rtol=1e-12)


@pytest.mark.parametrize("version", [(1, 2, 0), (1, 2, 1), (1, 2, 4), (1, 2, 6), NEWEST])
def test_meshroom(version, odd_shots, tmp_path):
    app_writers.meshroom(tmp_path, odd_shots, version)
    frames = read_frames(tmp_path)
    assert len(frames.points) > 100
    capture = read_with_masks(tmp_path)
    assert capture.format == "meshroom"
    assert_same(capture, odd_shots)
    assert codes(tmp_path)["unposed-views"] == "note"


def test_meshroom_of_old(tall_shots, tmp_path):
    app_writers.meshroom(tmp_path, tall_shots, (1, 0, 0))
    assert_same(read_with_masks(tmp_path), tall_shots)


def test_meshroom_numbers_of_a_real_file(odd_shots, tmp_path):
    """The same camera in AliceVision's compatibility scenes of 1.2.0, 1.2.4 and 1.2.14."""
    size = {"width": "4092", "height": "2048", "sensorWidth": "36", "type": "radial3"}
    files = {
        (1, 2, 0): {"pxFocalLength": ["2000", "4000"], "principalPoint": ["2020", "1040"]},
        (1, 2, 14): {
            "focalLength": "17.595307917888562",
            "pixelRatio": "2",
            "principalPoint": ["-26", "16"],
        },
    }
    app_writers.meshroom(tmp_path, odd_shots, NEWEST)
    path = tmp_path / "cameras.sfm"
    content = json.loads(path.read_text())
    for version, keys in files.items():
        entry = {"intrinsicId": "77", "distortionParams": ["0.1", "0.05", "-0.001"]}
        content |= {"version": list(map(str, version)), "intrinsics": [size | entry | keys]}
        path.write_text(json.dumps(content))
        lens = read_frames(tmp_path).frames[0].lens
        np.testing.assert_allclose([lens.fx, lens.fy], [2000, 4000], rtol=1e-12)
        assert (lens.cx, lens.cy) == (2020.5, 1040.5)
        assert lens.distortion == Distortion(radial=(0.1, 0.05, -0.001, 0.0))


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("radialk1", [0.3], Distortion(radial=(0.3, 0.0, 0.0, 0.0))),
        (
            "brown",
            [0.3, 0.2, 0.1, 0.01, -0.02],
            Distortion(radial=(0.3, 0.2, 0.1, 0.0), tangential=(0.01, -0.02)),
        ),
        (
            "fisheye4",
            [0.3, 0.2, 0.1, 0.4],
            Distortion(radial=(0.3, 0.2, 0.1, 0.4), is_fisheye=True),
        ),
        ("none", [], Distortion()),
    ],
)
def test_meshroom_lenses(kind, values, expected, odd_shots, tmp_path):
    app_writers.meshroom(tmp_path, odd_shots, NEWEST)
    path = tmp_path / "cameras.sfm"
    content = json.loads(path.read_text())
    content["intrinsics"][0] |= {"distortionType": kind, "distortionParams": list(map(str, values))}
    path.write_text(json.dumps(content))
    assert read_frames(tmp_path).frames[0].lens.distortion == expected


def test_photographs_are_found_where_they_lie(odd_shots, tmp_path):
    """Among pictures of the same names, those with the agreeing folder, then with most names."""
    app_writers.metashape(tmp_path, odd_shots)
    (tmp_path / "masks").rename(tmp_path / "mattes")
    (tmp_path / "export").mkdir()
    (tmp_path / "cameras.xml").rename(tmp_path / "export/cameras.xml")
    (tmp_path / "small").mkdir()
    (tmp_path / "small/DSC0003.png").write_bytes(b"a preview")
    masks = tmp_path / "mattes"
    capture = read_capture(tmp_path / "export/cameras.xml", masks, CaptureConfig())
    assert_same(capture, odd_shots)
