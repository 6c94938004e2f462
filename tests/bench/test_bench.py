# SPDX-License-Identifier: Apache-2.0
"""Plans, their runs, and what bench and stability sweep leave behind."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from bench.fake_robir import write_plan
from evaluation import sphere_run

from robir import cli
from robir.config import RunConfig, resolve
from robir.errors import ConfigError
from robir.jobs.paths import JobPaths, read_json, write_json
from robir_bench import runs as bench_runs
from robir_bench.paper.config import VARIANTS
from robir_bench.plan import BORROWERS, METHODS, OURS, read_plan, read_sweep
from robir_bench.runs import carry_out, read_scores


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_settings_that_exist_and_differ(name):
    base = RunConfig()
    changed = resolve(base, None, METHODS[name])
    assert (changed == base) == (name in (OURS, *BORROWERS, *VARIANTS))


def test_a_plan_is_a_product_with_the_whole_method_first(tmp_path):
    path = write_plan(
        tmp_path,
        'captures = ["a", "b"]\nseeds = [0, 1]\nmethods = ["no visibility", "ours"]\n'
        'settings = ["export.renders=false"]',
    )
    planned = read_plan(path)
    assert len(planned) == 8
    assert [run.method for run in planned[:2]] == ["ours", "no visibility"]
    assert planned[1].settings == ("export.renders=false", "transport.use_visibility=false")
    assert planned[1].name == "a_no-visibility_0"
    assert planned[0].capture == tmp_path / "a"
    assert len({run.name for run in planned}) == 8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seeds = [0]", "captures is missing"),
        ('captures = ["a"]\nmethods = ["no light"]', "'no light' is unknown; known: ours"),
        ('captures = ["a"]\nmethods = ["photo"]', "list that too"),
        ('captures = ["a"]\nmethods = ["invrender"]', "list that too"),
        ('captures = ["a"]\npresets = ["best"]', "unknown setting 'presets'"),
        ('captures = ["a"]\nseeds = ["0"]', "must be a whole number"),
        ('captures = ["x/a", "y/a"]', "two captures are called 'a'"),
    ],
)
def test_wrong_plans_are_refused_in_words(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        read_plan(write_plan(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('captures = ["a"]', "factors is missing"),
        ('captures = ["a"]\n[factors]\nfog = [1]', "'fog' is unknown; known: views"),
        ('captures = ["a"]\n[[rendered]]\nof = "a"\nvalue = "x"', "lacks factor"),
        ('captures = ["a"]\n[factors]\nviews = ["few"]', "'few' is not a number of views"),
        ('captures = ["a"]\n[factors]\n"geometry.rays" = [1]', "geometry.rays is 1"),
        ('captures = ["a"]\n[factors]\n"geometry.fog" = [1]', "unknown setting"),
    ],
)
def test_wrong_sweeps_are_refused_in_words(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        read_sweep(write_plan(tmp_path, text), tmp_path)


def test_a_failing_run_stops_nothing_and_done_runs_are_not_repeated(
    tmp_path, robir, capture, capsys
):
    plan = write_plan(
        tmp_path, f'captures = ["{capture}", "bad"]\nmethods = ["ours", "no visibility"]'
    )
    words = ["bench", str(plan), "-o", str(tmp_path / "out")]
    assert cli.main(words) == 3
    page = Path(capsys.readouterr().out.strip())
    table = page.with_name("scores.md").read_text()
    assert "| ours: median | 22.0 | 10.0 | 20.0 | 1.00 | - |" in table
    assert "| no visibility: worst | 18.0 |" in table
    assert "| bad_ours_0 | 3 | robir: no masks |" in table
    text = page.read_text()
    assert text.count("data:image/png") == 4  # photograph, truth, two albedos
    assert not re.findall(r'(?:src|href)="(?!data:|#)', text)
    first = len(robir.commands)
    assert cli.main(words) == 3
    assert [command[0] for command in robir.commands[first:]] == ["reconstruct"] * 2


def test_a_method_starts_from_what_it_shares_with_the_whole(tmp_path, robir, capture):
    plan = write_plan(
        tmp_path, f'captures = ["{capture}"]\nmethods = ["ours", "one sharp lobe", "photo"]'
    )
    original = robir.__call__

    def look_first(*words: str) -> subprocess.CompletedProcess[str]:
        if words[0] == "reconstruct" and "one-sharp-lobe" in words[3]:
            borrowed = JobPaths(Path(words[3]))
            assert borrowed.manifest("appearance").exists()
            assert not borrowed.manifest("export").exists()
            assert borrowed.run.exists()
        return original(*words)

    bench_runs._robir = look_first
    carry_out(read_plan(plan), tmp_path / "out", None, lambda _line: None)
    records = read_scores(tmp_path / "out")
    assert len(records) == 3
    photo = records["good_photo_0"]
    assert set(photo["seconds"]) == {"capture", "geometry", "appearance"}
    assert photo["cpu_seconds"] == 4.0 + photo["seconds"]["appearance"]["cpu"]
    assert photo["held_out"]["views"] == 3


def test_a_sweep_says_what_each_factor_costs(tmp_path, robir, capture, capsys):
    factors = "views = [1]\nnoise = [0.1]\njpeg = [90]"
    plan = write_plan(tmp_path, f'captures = ["{capture}"]\n[factors]\n{factors}')
    out = tmp_path / "out"
    assert cli.main(["stability", str(plan), "-o", str(out)]) == 0  # a refusal is no bug
    page = Path(capsys.readouterr().out.strip())
    table = page.with_name("stability.md").read_text()
    assert "| views | 1 | - | - | 1 of 1 |" in table
    assert "| noise | 0.1 | 9.0 | 1.00 | 0 of 1 |" in table
    assert "| jpeg | 90 | 0.0 |" in table
    assert "exit code 3: robir: no masks" in table
    # the refused run and the noisy one, 9 dB below the unperturbed one
    assert "Of 2 wrong ones" in table
    assert "the program told 2; of 2 sound ones it doubted 0" in table
    assert (out / "captures" / "good_noise_0.1_s0" / "truth" / "mesh.ply").samefile(
        capture / "truth" / "mesh.ply"
    )


def test_a_sweep_turns_settings_on_the_capture_as_it_is(tmp_path, robir, capture, capsys):
    factors = '"geometry.level_steps" = [[2, 2, 1], [4, 4, 2]]\n"geometry.rays" = [64]'
    plan = write_plan(tmp_path, f'captures = ["{capture}"]\n[factors]\n{factors}')
    runs = read_sweep(plan, tmp_path / "out")
    assert len({run.name for run in runs}) == 4
    assert {run.capture for run in runs} == {capture.resolve()}
    assert "geometry.level_steps=[4, 4, 2]" in runs[2].settings
    assert cli.main(["stability", str(plan), "-o", str(tmp_path / "out")]) == 0
    page = Path(capsys.readouterr().out.strip())
    assert (
        "| geometry.level_steps | [2, 2, 1] | 0.0 |" in page.with_name("stability.md").read_text()
    )
    assert "geometry.level_steps" in page.with_name("cost.svg").read_text()


def test_the_photo_method_through_the_real_evaluation(tmp_path, capture):
    run = sphere_run.make_run(tmp_path / "whole")
    from robir_bench.peers.photo import texture_photographs

    config = resolve(RunConfig(), None, ["appearance.texture_size=128"])
    paths = JobPaths(tmp_path / "photo")
    for stage in ("capture", "geometry"):
        shutil.copytree(run.stage(stage), paths.stage(stage))
    held_out = texture_photographs(paths, config)
    assert held_out["psnr"] > 20  # its texture is the photograph
    for stage in ("transport", "export"):
        write_json(paths.manifest(stage), {"stage": stage})
    assert cli.main(["evaluate", str(paths.root), "--truth", str(capture)]) == 0
    found = read_json(paths.scores)
    albedo = found["albedo"]["psnr_linear"]["per_channel_lsq"]
    photo = found["photo_as_albedo"]["psnr_linear"]["per_channel_lsq"]
    # the photographs' blend is as far from the albedo as the photographs are
    assert albedo == pytest.approx(photo, abs=1.0)
    assert found["mask_iou"] == 1.0
