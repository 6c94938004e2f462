# SPDX-License-Identifier: Apache-2.0
"""A perfect result scores perfectly; each kind of damage moves its own score and no other."""

import numpy as np
import pytest
from evaluation import sphere_run
from PIL import Image

from robir.errors import CaptureError, StorageError
from robir.evaluation.light import load_light
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import read_json, write_json
from robir.maths.vectors import equirect_solid_angles
from robir_bench.truth.evaluate import evaluate


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return sphere_run.make_truth(tmp_path_factory.mktemp("truth") / "capture")


def test_a_perfect_result_scores_perfectly(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    scores = evaluate(paths, truth, tmp_path / "sheet.png")
    for alignment, decibel in scores["albedo"]["psnr_linear"].items():
        assert decibel > 55, alignment
    assert scores["albedo"]["ssim"] == pytest.approx(1.0, abs=1e-3)
    assert scores["shadow"]["ratio"] is None  # a convex object casts no shadow on itself
    assert scores["roughness"]["rmse"] < 1e-3
    # a board of .4 and .7, its edges evened out by the pixels
    assert scores["roughness"]["best_constant_rmse"] == pytest.approx(0.135, abs=0.01)
    assert scores["normals"]["mean_degrees"] < 0.05
    assert scores["mask_iou"] == 1.0
    assert scores["chamfer"]["chamfer"] < 0.01
    assert scores["light"]["strongest_lobe_degrees"] < 1e-3
    assert scores["light"]["environment_log_rmse"] < 0.1
    assert scores["uncertainty"]["share_90"] > 0.99  # it states an error of a tenth, and has none
    assert scores["uncertainty"]["median"] == pytest.approx(0.1)
    assert scores["tone_curve"] == {
        "family": "standard",
        "parameters": {},
        "true_view_transform": "Standard",
        "true_display_power": 1.0,
        "stops": 0.0,
    }
    assert scores["photo_as_albedo"]["psnr_linear"]["per_channel_lsq"] < 25
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.width > 8 * 160
        assert sheet.height > 3 * 160


def test_a_shrunken_surface_fails_the_geometry_only(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    mesh = sphere_run.sphere_mesh()
    file = paths.stage("geometry") / "mesh.npz"
    fields = {name: getattr(mesh, name) for name in Mesh.__dataclass_fields__}
    Mesh(**fields | {"vertices": mesh.vertices * np.float32(0.95)}).save(file)
    scores = evaluate(paths, truth)
    assert scores["chamfer"]["chamfer"] == pytest.approx(50.0, rel=0.03)
    assert scores["mask_iou"] == pytest.approx(0.9, abs=0.02)
    assert scores["light"]["strongest_lobe_degrees"] < 1e-3


def test_a_wrong_sun_is_an_angle(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    file = paths.stage("appearance") / "light.json"
    table = read_json(file)
    x, y, z = sphere_run.SUN_DIRECTION
    turn = np.radians(20.0)
    flat = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z]
    table["lobes"][1]["axis"] = flat
    # a second, weaker sun at the right place does not count
    table["lobes"].append(table["lobes"][1] | {"axis": [x, y, z], "amplitude": [1.0, 1.0, 1.0]})
    write_json(file, table)
    expected = np.degrees(np.arccos(np.dot(flat, [x, y, z])))
    found = evaluate(paths, truth)["light"]["strongest_lobe_degrees"]
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("rows", [64, 256])
def test_environment_keeps_the_energy_of_every_lobe(tmp_path, rows):
    solid = equirect_solid_angles(rows).numpy()[..., None]
    for sharpness in (0.5, 11.0, 60.0, 300.0, 3e4, 1e7):
        lobe = {"axis": [0.6, -0.48, 0.64], "sharpness": sharpness, "amplitude": [2.0, 1.0, 0.5]}
        write_json(tmp_path / "light.json", {"lobes": [lobe | {"kind": "soft"}]})
        image = load_light(tmp_path / "light.json").environment(rows)
        exact = 2 * np.pi / sharpness * -np.expm1(-2 * sharpness) * np.array([2.0, 1.0, 0.5])
        assert (image * solid).sum(axis=(0, 1)) == pytest.approx(exact, rel=2e-3)
        v, u = (np.array(np.unravel_index(image[..., 0].argmax(), image.shape[:2])) + 0.5) / rows
        seen = np.degrees([2 * np.pi * (0.5 - u / 2), np.pi * (0.5 - v)])
        expected = np.degrees([np.arctan2(-0.48, 0.6), np.arcsin(0.64)])
        assert seen == pytest.approx(expected, abs=181 / rows)


def test_what_is_missing_is_said(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    with pytest.raises(CaptureError, match="truth/scene"):
        evaluate(paths, tmp_path)
    paths.manifest("appearance").unlink()
    with pytest.raises(StorageError, match="--resume"):
        evaluate(paths, truth)


def test_shading_normals_are_judged_where_the_appearance_stage_has_turned_some(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    normals = sphere_run.sphere_mesh().normals
    aside = np.cross(normals, [0.3, 0.5, 0.8])
    turned = normals + np.tan(np.radians(7.0)) * aside / np.linalg.norm(aside, axis=1)[:, None]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    np.savez(paths.stage("appearance") / "normals.npz", normals=turned.astype(np.float32))
    scores = evaluate(paths, truth)
    assert scores["normals"]["mean_degrees"] == pytest.approx(7.0, abs=0.3)
    assert scores["chamfer"]["chamfer"] < 0.01
