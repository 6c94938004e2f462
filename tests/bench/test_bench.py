# SPDX-License-Identifier: Apache-2.0
"""Plans, their runs, and the table of scores."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from robir import cli
from robir.bench import runs as bench_runs
from robir.bench.plan import VARIANTS, read_plan
from robir.bench.runs import carry_out, read_scores
from robir.bench.scores import score_lines
from robir.bench.table import markdown
from robir.config import resolve
from robir.errors import ConfigError
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir.presets import PRESETS


def write_plan(folder: Path, text: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def scores(albedo: float, shadow: float | None = 1.0, family: str = "filmic") -> dict:
    return {
        "albedo": {"psnr_linear": {"per_channel_lsq": albedo, "raw": albedo - 2.0}},
        "photo_as_albedo": {"psnr_linear": {"per_channel_lsq": 12.0}},
        "shadow": {"ratio": shadow},
        "light": {"strongest_lobe_degrees": None},
        "normals": {"mean_degrees": 6.0},
        "mask_iou": 0.99,
        "chamfer": {"chamfer": 5.0},
        "roughness": {"rmse": 0.15, "best_constant_rmse": 0.2},
        "tone_curve": {"family": family, "true_view_transform": "Filmic"},
    }


@pytest.mark.parametrize("name", VARIANTS)
@pytest.mark.parametrize("preset", PRESETS)
def test_every_ablation_is_a_setting_that_exists_and_differs(name, preset):
    base = PRESETS[preset]()
    changed = resolve(base, None, VARIANTS[name])
    assert (changed == base) == (name == "full")


def test_a_plan_is_a_product_with_the_whole_method_first(tmp_path):
    path = write_plan(
        tmp_path,
        'captures = ["a", "b"]\nseeds = [0, 1]\nvariants = ["no visibility", "full"]\n'
        'settings = ["export.renders=false"]',
    )
    planned = read_plan(path)
    assert len(planned) == 8
    assert [run.variant for run in planned[:2]] == ["full", "no visibility"]
    assert planned[1].settings == ("export.renders=false", "transport.use_visibility=false")
    assert planned[1].name == "a_draft_no-visibility_0"
    assert planned[0].capture == tmp_path / "a"
    assert len({run.name for run in planned}) == 8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seeds = [0]", "captures is missing"),
        ('captures = ["a"]\nvariants = ["no light"]', "'no light' is unknown; known: full"),
        ('captures = ["a"]\npresets = ["best"]', "'best' is unknown"),
        ('captures = ["a"]\nseeds = ["0"]', "must be a whole number"),
        ('captures = ["x/a", "y/a"]', "two captures are called 'a'"),
    ],
)
def test_wrong_plans_are_refused_in_words(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        read_plan(write_plan(tmp_path, text))


class FakeRobir:
    """Stands for the command line; one capture always fails."""

    def __init__(self) -> None:
        self.commands: list[tuple[str, ...]] = []

    def __call__(self, *words: str) -> subprocess.CompletedProcess[str]:
        self.commands.append(words)
        if words[0] == "evaluate":
            albedo = 18.0 if "no-visibility" in words[1] else 22.0
            return subprocess.CompletedProcess(words, 0, json.dumps(scores(albedo)), "")
        if words[1].endswith("bad"):
            return subprocess.CompletedProcess(words, 3, "", "working\nrobir: no masks\n")
        paths = JobPaths(Path(words[3]))
        for stage in STAGES:
            write_json(paths.manifest(stage), {"made by": list(words)})
        paths.config.write_text("seed = 0\n")
        seconds = {stage: {"wall": 1.0, "cpu": 2.0} for stage in STAGES}
        write_json(paths.run, {"seconds": seconds, "peak_memory_bytes": {"geometry": 2e9}})
        return subprocess.CompletedProcess(words, 0, "", "")


@pytest.fixture
def robir(monkeypatch) -> FakeRobir:
    fake = FakeRobir()
    monkeypatch.setattr(bench_runs, "_robir", fake)
    return fake


def test_a_failing_run_stops_nothing_and_done_runs_are_not_repeated(tmp_path, robir, capsys):
    plan = write_plan(tmp_path, 'captures = ["good", "bad"]\nvariants = ["full", "no visibility"]')
    words = ["bench", str(plan), "-o", str(tmp_path / "out")]
    assert cli.main(words) == 1
    table = Path(capsys.readouterr().out.strip()).read_text()
    assert "| draft, full: median | 22.0 | 10.0 | 20.0 | 1.00 | - |" in table
    assert "| draft, no visibility: worst | 18.0 |" in table
    assert "- bad_draft_full_0: robir: no masks" in table
    first = len(robir.commands)
    assert cli.main(words) == 1
    assert [command[0] for command in robir.commands[first:]] == ["reconstruct"] * 2


def test_an_ablation_starts_from_what_it_shares_with_the_whole(tmp_path, robir):
    plan = write_plan(tmp_path, 'captures = ["good"]\nvariants = ["full", "one sharp lobe"]')
    original = robir.__call__

    def look_first(*words: str) -> subprocess.CompletedProcess[str]:
        if words[0] == "reconstruct" and "one-sharp-lobe" in words[3]:
            borrowed = JobPaths(Path(words[3]))
            assert borrowed.manifest("appearance").exists()
            assert not borrowed.manifest("export").exists()
            assert borrowed.run.exists()
        return original(*words)

    bench_runs._robir = look_first
    carry_out(read_plan(plan), tmp_path / "out", lambda _line: None)
    assert len(read_scores(tmp_path / "out")) == 2


def test_worst_follows_the_direction_of_each_score():
    facts = {"preset": "draft", "variant": "full", "capture": "a", "seed": 0, "cpu_seconds": 90.0}
    records = [
        facts | {"name": str(index), "scores": scores(*values)}
        for index, values in enumerate([(20.0, 0.9), (24.0, 1.3, "standard"), (22.0, None)])
    ]
    lines = markdown(records).splitlines()
    median, worst = (next(x for x in lines if f": {name} |" in x) for name in ("median", "worst"))
    assert median.startswith("| draft, full: median | 22.0 | 10.0 | 20.0 | 1.10 |")
    assert worst.startswith("| draft, full: worst | 20.0 | 8.0 | 18.0 | 1.30 |")
    assert median.endswith("| 2/3 |")


def test_scores_of_one_result_as_lines():
    lines = score_lines(scores(21.0, None))
    assert lines[0].split() == ["albedo,", "per", "channel", "(dB)", "21.0"]
    assert lines[3].endswith(" -")
    assert lines[-1].endswith("filmic (true: Filmic)")
