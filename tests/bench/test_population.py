# SPDX-License-Identifier: Apache-2.0
"""A bench over a population: which captures, what counts, and what it leaves behind."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from bench.fake_robir import scores

from robir import cli
from robir.errors import ConfigError
from robir_bench.population import (
    below_photo,
    capture_classes,
    read_population,
    verdicts,
)
from robir_bench.truth.scores import ALBEDO

SUNNY = {"ground": "ground", "paint": "plain", "metal": "metal", "tone": "Filmic", "sun": "sun"}
DULL = SUNNY | {"ground": "none", "sun": "no sun"}


def record(name: str, albedo: float, **changes) -> dict:
    found = {"capture": name, "name": name, "method": "ours", "scores": scores(albedo)}
    return found | {"cpu_seconds": 10.0 * albedo} | changes


def failed(name: str) -> dict:
    return {"capture": name, "name": name, "error": "no masks", "exit_code": 3}


@pytest.fixture
def population(tmp_path, capture) -> Path:
    folder = tmp_path / "population"
    for name, seed, classes in (
        ("seed_0000", 0, SUNNY),
        ("seed_0001", 1, DULL),
        ("seed_1000bad", 1000, DULL),
    ):
        shutil.copytree(capture, folder / name)
        file = folder / name / "truth" / "scene.json"
        scene = json.loads(file.read_text())
        file.write_text(json.dumps(scene | {"seed": seed, "classes": classes}))
    (folder / "notes.txt").write_text("no capture")
    return folder


def test_every_capture_with_truth_is_a_run_of_the_whole_method(population):
    runs = read_population(population)
    assert [run.name for run in runs] == [
        "seed_0000_ours_0",
        "seed_0001_ours_0",
        "seed_1000bad_ours_0",
    ]
    assert verdicts(runs) == 1
    assert capture_classes(runs)["seed_0001"] == DULL
    with pytest.raises(ConfigError, match="holds no captures with truth"):
        read_population(population / "seed_0000")


def test_the_command_reports_the_distribution_and_goes_on(population, tmp_path, robir, capsys):
    words = ["bench", "--population", str(population), "-o", str(tmp_path / "out")]
    assert cli.main(words) == 0  # a failed capture is a score, not a fault of the bench
    page = Path(capsys.readouterr().out.strip())
    text = page.with_name("population.md").read_text()
    assert "2 of 3 captures are scored, 1 failed; 1 are of seeds for verdicts" in text
    assert "| share below the photo | 3 | 0.33 [" in text
    assert "| ground: none | 2 | 1 | 0.50 [" in text
    assert "| seed_1000bad_ours_0 | 3 | robir: no masks |" in text
    found = json.loads(page.with_name("distribution.json").read_text())["classes"]
    assert found["all"][ALBEDO.title]["median"]["value"] == 22.0
    assert found["ground: none"]["failed"] == 1
    first = len(robir.commands)
    assert cli.main(words) == 0
    assert [command[0] for command in robir.commands[first:]] == ["reconstruct"]


def test_a_result_is_shown_under_the_second_light_before_it_is_judged(population, tmp_path, robir):
    light = population / "seed_0000" / "truth" / "second_light.exr"
    light.write_bytes(b"a map")
    cli.main(["bench", "--population", str(population), "-o", str(tmp_path / "out")])
    done = [command for command in robir.commands if "seed_0000" in command[1]]
    assert [command[0] for command in done] == ["reconstruct", "relight", "evaluate"]
    assert done[1][2:4] == ("--environment", str(light))
    assert sum(command[0] == "relight" for command in robir.commands) == 1


@pytest.mark.parametrize("words", [[], ["plan.toml", "--population", "p"]])
def test_a_plan_or_a_population_not_both(words, tmp_path, capsys):
    assert cli.main(["bench", *words, "-o", str(tmp_path)]) == 2
    assert "either PLAN.toml or --population" in capsys.readouterr().err


def test_a_run_without_a_result_is_below_the_photograph():
    """The photograph stands at 12 dB in these scores."""
    members = [record("a", 11.0), record("b", 13.0), record("c", 30.0), failed("d")]
    found = below_photo(members)
    assert (found.value, found.count) == (0.5, 4)
