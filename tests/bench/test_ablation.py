# SPDX-License-Identifier: Apache-2.0
"""Steps left out one at a time: which runs that makes, and what it says of a step."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from bench.fake_robir import scores

from robir import cli
from robir_bench.ablation import ENOUGH, chosen_trials, trials, worths
from robir_bench.truth.scores import ALBEDO, RAW_ALBEDO

CLASSES = {"ground": "ground", "paint": "plain", "metal": "none", "tone": "Filmic", "sun": "sun"}
TRIAL = trials()[0]


@pytest.fixture
def population(tmp_path, capture) -> Path:
    folder = tmp_path / "population"
    for seed in (0, 1):
        shutil.copytree(capture, folder / f"seed_000{seed}")
        file = folder / f"seed_000{seed}" / "truth" / "scene.json"
        scene = json.loads(file.read_text())
        file.write_text(json.dumps(scene | {"seed": seed, "classes": CLASSES}))
    return folder


def records(gains, classes=lambda number: CLASSES):
    """Runs with and without the first step, which brings each capture so much albedo."""
    found, kinds = [], {}
    for number, gain in enumerate(gains):
        name = f"seed_{number:04}"
        kinds[name] = classes(number)
        steps = {TRIAL.stage: {TRIAL.step.name: 1.0 + number}}
        for method, albedo in (("ours", 20.0 + gain), (TRIAL.method, 20.0)):
            found.append(
                {"capture": name, "name": f"{name}_{method}", "method": method}
                | {"scores": scores(albedo), "step_seconds": steps if method == "ours" else {}}
            )
    return found, kinds


def test_what_a_step_brings_is_the_mean_of_what_its_absence_costs():
    found = worths(*records([1.0, 2.0, 3.0]))[0]
    gain = found.gain(ALBEDO)
    assert gain.value == pytest.approx(2.0) and gain.low < 2.0 < gain.high
    assert found.seconds.value == pytest.approx(2.0)
    assert found.changed == 3
    assert found.verdict.startswith("open")


def test_a_step_that_helps_stays_and_one_that_does_not_goes():
    helps, harms = (worths(*records([sign * 0.5] * ENOUGH))[0] for sign in (1, -1))
    assert helps.verdict == f"stays: {ALBEDO.title}"
    assert harms.verdict == "goes"
    assert worths(*records([0.0] * ENOUGH))[0].verdict == "goes"


def test_a_step_that_a_class_needs_stays_unless_another_pays():
    def classes(number):
        return CLASSES | {"metal": "metal" if number < 5 else "none"}

    for others, verdict in ((-0.28, "stays: metal: metal"), (-0.5, "goes")):
        gains = [1.2] * 5 + [others] * (ENOUGH - 5)
        assert worths(*records(gains, classes))[0].verdict == verdict


def test_the_command_writes_table_and_chart(population, tmp_path, robir, capsys):
    words = ["bench", "--population", str(population), "--ablate", "-o", str(tmp_path / "out")]
    assert cli.main(words) == 0
    page = Path(capsys.readouterr().out.strip())
    text = page.with_name("ablation.md").read_text()
    assert f"{TRIAL.stage}: {TRIAL.step.name}" in text and RAW_ALBEDO.title in text
    assert page.with_name("ablation.svg").read_text().startswith("<svg")
    left_out = [line for line in robir.commands if line[0] == "reconstruct"]
    assert sum("without" in word for line in left_out for word in line[-1:]) == 2 * len(trials())


def test_ablating_a_plan_is_refused(tmp_path, capsys):
    (tmp_path / "plan.toml").write_text('captures = ["one"]')
    words = ["bench", str(tmp_path / "plan.toml"), "--ablate", "-o", str(tmp_path / "out")]
    assert cli.main(words) == 2
    assert "need --population" in capsys.readouterr().err


def test_named_steps_alone_are_left_out(population, tmp_path, robir, capsys):
    first, last = (f"{trial.stage}.{trial.step.name}" for trial in (trials()[0], trials()[-1]))
    out = str(tmp_path / "out")
    words = ["bench", "--population", str(population), "--ablate", last, first, "-o", out]
    assert cli.main(words) == 0
    made = [line for line in robir.commands if line[0] == "reconstruct"]
    assert len(made) == 2 * 3
    assert [trial.step for trial in chosen_trials([last, first])] == [
        trials()[0].step,
        trials()[-1].step,
    ]
    assert len(chosen_trials([])) == len(trials())
    capsys.readouterr()
    words = ["bench", "--population", str(population), "--ablate", "light.sun", "-o", out]
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert "no step on trial is called light.sun" in said and first in said
