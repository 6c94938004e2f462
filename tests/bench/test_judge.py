# SPDX-License-Identifier: Apache-2.0
"""Scores that outlive their captures, and runs to which one quantity is told."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from bench.fake_robir import scores

from robir import cli
from robir.appearance.light.lobes import Amplitudes, sky_radiance
from robir.appearance.light.solver import Light
from robir.errors import UsageError
from robir.maths.vectors import equirect_directions, equirect_solid_angles
from robir_bench.judge.oracle_table import told_runs
from robir_bench.judge.oracles import ORACLES, Oracle, is_set_after_step, mesh_of, settings_of
from robir_bench.judge.scores import compared, keep
from robir_bench.plan import BenchRun
from robir_bench.truth.files import load_truth

CLASSES = {"sun": "no sun", "ground": "none"}


def record(name: str, albedo: float, method: str = "ours") -> dict:
    return {
        "capture": name,
        "name": f"{name}_{method}",
        "method": method,
        "scores": scores(albedo),
        "cpu_seconds": 10.0,
        "trust": {"is_trusted": True, "signs": {"outline": {"value": 0.99}}},
    }


def test_scores_of_two_days_compare_in_pairs(tmp_path, capsys):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    names = ["seed_0000", "seed_0001", "seed_0002"]
    classes = dict.fromkeys([*names, "seed_0003"], CLASSES)
    keep(before, "before", [record(name, 20.0) for name in names], classes)
    later = [record("seed_0001", 21.0), record("seed_0002", 23.0), record("seed_0003", 99.0)]
    failed = {"capture": "seed_0000", "name": "x", "method": "ours", "error": "no masks"}
    keep(after, "after", [*later, failed], classes)
    stored = json.loads(after.read_text())
    assert stored["captures"]["seed_0000"] == {"error": "no masks"}
    assert stored["captures"]["seed_0001"]["signs"] == {"outline": 0.99}
    rows = {row[0]: row for row in compared(before, after).rows}
    # only the two that both have count: 1 and 3 dB
    assert rows["albedo, per channel (dB)"][1] == "2"
    assert rows["albedo, per channel (dB)"][2].startswith("2.000 ")
    assert cli.main(["bench", "--compare", str(before), str(after)]) == 0
    assert "after against before" in capsys.readouterr().out


def test_each_quantity_is_a_run_of_its_own(capture):
    run = BenchRun(capture=capture, method="ours", seed=0, settings=())
    every = told_runs([run], [])
    assert [one.oracle for one in every] == [None, *ORACLES]
    assert len({one.name for one in every}) == len(every)
    with pytest.raises(UsageError, match="nothing is called weather"):
        told_runs([run], ["weather"])
    assert mesh_of("surface", capture).is_file() and mesh_of("level", capture) is None
    by_setting = {name for name in ORACLES if not is_set_after_step(name)}
    assert by_setting == {"family", "sun", "surface"}
    assert settings_of("family", capture)[0].startswith("appearance.families=")


def test_the_family_of_a_drawn_camera_is_the_mean_of_cameras(capture, tmp_path):
    photographs = tmp_path / "photographs"
    shutil.copytree(capture, photographs)
    scene = json.loads((photographs / "truth/scene.json").read_text())
    scene |= {"view_transform": "camera response", "response": [0.1, -0.1, 0.0]}
    (photographs / "truth/scene.json").write_text(json.dumps(scene))
    assert settings_of("family", photographs) == ('appearance.families=["camera"]',)


def test_a_told_light_is_the_map(capture, tmp_path):
    """Irradiance of the lobes against that of the true map by quadrature."""
    oracle = Oracle(capture, tmp_path)
    none = Amplitudes(soft=torch.zeros(64, 3), sharp=torch.zeros(0, 3))
    empty = np.zeros((0, 3), np.float32)
    start = Light(axes=empty, sharpness=empty[:, 0], amplitudes=none, loss=0.0, history=())
    told = oracle._true_light(start)
    truth = load_truth(capture)
    rows = len(truth.environment_linear)
    directions = equirect_directions(rows).reshape(-1, 3)
    solid = np.broadcast_to(equirect_solid_angles(rows), (rows, 2 * rows)).ravel()
    lobes = sky_radiance(directions, told.amplitudes.soft).numpy()
    up = np.maximum(directions.numpy()[:, 2], 0) * solid
    suns = np.maximum(told.axes[:, 2], 0) @ told.amplitudes.sharp.numpy()
    ours = up @ lobes + suns
    true = truth.exposed * (up @ truth.environment_linear.reshape(-1, 3))
    np.testing.assert_allclose(ours, true, rtol=0.1)
