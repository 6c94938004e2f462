# SPDX-License-Identifier: Apache-2.0
"""A bench over a population: which captures, what counts, and what it leaves behind."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from bench.fake_robir import scores, write_plan

from robir import cli
from robir.errors import ConfigError
from robir.evaluation.scores import ALBEDO, LEVEL, NORMALS, SHADOW, SUN
from robir_bench.population import (
    below_photo,
    capture_classes,
    distribution,
    figure,
    population_tables,
    read_population,
    spread,
    verdicts,
)

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
        "seed_0000_draft_ours_0",
        "seed_0001_draft_ours_0",
        "seed_1000bad_draft_ours_0",
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
    assert "| seed_1000bad_draft_ours_0 | 3 | robir: no masks |" in text
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


def test_what_leaves_no_asset_is_not_shown_under_it(population, tmp_path, robir):
    (population / "seed_0000" / "truth" / "second_light.exr").write_bytes(b"a map")
    plan = write_plan(
        tmp_path,
        f'captures = ["{population / "seed_0000"}"]\npresets = ["draft"]\n'
        'methods = ["ours", "photo"]\nseeds = [0]\n',
    )
    cli.main(["bench", str(plan), "-o", str(tmp_path / "out")])
    shown = [command for command in robir.commands if command[0] == "relight"]
    assert [Path(command[1]).name for command in shown] == ["seed_0000_draft_ours_0"]
    records = (tmp_path / "out" / "scores.jsonl").read_text().splitlines()
    assert len(records) == 2 and not any("error" in json.loads(one) for one in records)


@pytest.mark.parametrize("words", [[], ["plan.toml", "--population", "p"]])
def test_a_plan_or_a_population_not_both(words, tmp_path, capsys):
    assert cli.main(["bench", *words, "-o", str(tmp_path)]) == 2
    assert "either PLAN.toml or --population" in capsys.readouterr().err


def test_figures_are_distances_from_what_is_right():
    light = {"strongest_lobe_degrees": 4.0, "level_log_error": -0.3}
    one = record("a", 22.0, scores=scores(22.0, shadow=1.25) | {"light": light})
    assert figure(SHADOW, one, SUNNY) == pytest.approx(0.25)
    assert figure(LEVEL, one, SUNNY) == pytest.approx(0.3)
    assert figure(SUN, one, SUNNY) == 4.0


def test_without_a_sun_neither_shadow_nor_angle_counts_and_a_missed_sun_does():
    one = record("a", 22.0)
    assert figure(SHADOW, one, DULL) is None
    assert figure(SUN, one, DULL) is None
    assert figure(SUN, one, SUNNY) == 90.0
    assert figure(LEVEL, one, SUNNY) is None


def test_the_worst_tenth_is_at_the_bad_end():
    classes = {f"c{k}": SUNNY for k in range(11)}
    members = [
        record(f"c{k}", 20.0 + k, scores=scores(20.0 + k) | {"normals": {"mean_degrees": float(k)}})
        for k in range(11)
    ]
    high, low = spread(ALBEDO, members, classes), spread(NORMALS, members, classes)
    assert (high.median.value, high.worst_tenth.value) == (25.0, 21.0)
    assert (low.median.value, low.worst_tenth.value) == (5.0, 9.0)


def test_a_run_without_a_result_is_below_the_photograph():
    """The photograph stands at 12 dB in these scores."""
    members = [record("a", 11.0), record("b", 13.0), record("c", 30.0), failed("d")]
    found = below_photo(members)
    assert (found.value, found.count) == (0.5, 4)


def test_classes_are_told_apart():
    classes = {"a": SUNNY, "b": DULL, "c": DULL, "d": DULL}
    members = [record("a", 30.0), record("b", 10.0), record("c", 20.0), failed("d")]
    found = distribution(members, classes)["classes"]
    assert found["sun: no sun"][ALBEDO.title]["median"]["value"] == 15.0
    assert found["sun: no sun"]["captures"] == 3
    assert found["sun: sun"][ALBEDO.title]["median"] == {
        "value": 30.0, "low": None, "high": None, "count": 1,
    }  # fmt: skip
    titles = [table.title for table in population_tables(members, classes)]
    assert titles[0] == "All captures"
    assert titles[-2:] == ["Captures", "Failed"]
