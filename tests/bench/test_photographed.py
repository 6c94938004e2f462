# SPDX-License-Identifier: Apache-2.0
"""What the bench makes of captures that have no truth, and of results that failed their check."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bench.fake_robir import write_plan
from evaluation import sphere_run

from robir import cli
from robir.jobs.paths import JobPaths, read_json, write_json
from robir_bench import runs as bench_runs
from robir_bench.pictures import PHOTOGRAPHED_TILES
from robir_bench.plan import read_plan
from robir_bench.runs import carry_out, read_scores


def test_a_capture_without_truth_is_scored_by_its_held_out_photographs(
    tmp_path, robir, capsys, capture
):
    methods = 'methods = ["ours", "photo"]'
    plan = write_plan(tmp_path, f'captures = ["photographed", "noise"]\n{methods}')
    out = tmp_path / "out"
    assert cli.main(["bench", str(plan), "-o", str(out)]) == 0
    page = Path(capsys.readouterr().out.strip())
    records = read_scores(out)
    assert len(records) == 4
    # a result that failed its own check counts, with that noted
    assert records["noise_ours_0"]["trust"]["is_trusted"] is False
    table = page.with_name("scores.md").read_text()
    assert "albedo" not in table.partition("##")[2]
    lines = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")]
    head = [cell.strip() for cell in lines[0]]
    cells = {line[0].strip() + line[1]: [cell.strip() for cell in line] for line in lines[2:]}
    ours = dict(zip(head, cells["photographed ours "], strict=True))
    chain = records["photographed_ours_0"]["scores"]["levels"]["chain"]
    assert ours["c' (dB)"] == f"{chain['mean']['psnr']:.1f}"
    assert ours["e (dB)"] == "100.0" and ours["f (dB)"] == "-" and ours["trusted"] == "yes"
    assert ours["CPU-s"] == "10" and "loses" in ours["most is lost"]
    assert dict(zip(head, cells["noise ours "], strict=True))["trusted"] == "no"
    median = next(line for line in lines if line[0].strip() == "median")
    assert median[head.index("trusted")].strip() == "1/2"
    text = page.read_text()
    assert text.count("data:image/png") == 4 * len(PHOTOGRAPHED_TILES)
    assert not page.with_name("chart.svg").exists()
    # with truth beside it, both tables stand there
    plan.write_text(f'captures = ["{capture}", "photographed"]')
    assert cli.main(["bench", str(plan), "-o", str(out)]) == 0
    table = page.with_name("scores.md").read_text()
    assert "| ours: median | 22.0 |" in table and "level by level" in table
    assert page.with_name("chart.svg").exists()


def test_a_fit_that_broke_off_is_no_result(tmp_path, monkeypatch):
    def diverged(*words: str) -> subprocess.CompletedProcess[str]:
        out = JobPaths(Path(words[3]))
        sphere_run.make_run(out.root)
        write_json(out.run, read_json(out.run) | {"state": "running"})
        return subprocess.CompletedProcess(words, 5, "", "robir: the fit diverged\n")

    monkeypatch.setattr(bench_runs, "_robir", diverged)
    plan = write_plan(tmp_path, 'captures = ["photographed"]')
    carry_out(read_plan(plan), tmp_path / "out", None, lambda _line: None)
    (record,) = read_scores(tmp_path / "out").values()
    assert (record["exit_code"], record["error"]) == (5, "robir: the fit diverged")
