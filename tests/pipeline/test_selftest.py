# SPDX-License-Identifier: Apache-2.0
"""The tiny fit that judges a machine: its pictures, its verdict, and what it says of faults."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time

import numpy as np
import pytest
import torch

from robir import cli, specimen
from robir.errors import DeviceError
from robir.pipeline.device import Machine
from robir.selftest import SelfTestVerdict, run_selftest


def quiet(fraction: float, message: str) -> None:
    pass


def verdict_of(
    error: Exception, monkeypatch: pytest.MonkeyPatch, on: str = "cpu"
) -> SelfTestVerdict:
    """What is said when the fit ends with an error."""

    def fail(execution, progress):
        raise error

    monkeypatch.setattr(specimen, "judged_fit", fail)
    if on == "cuda":
        monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
        card = Machine(name="Card 1", memory_bytes=8 << 30, free_memory_bytes=1 << 30)
        monkeypatch.setattr("robir.selftest.machine", lambda chosen: card)
    return run_selftest("auto", quiet)


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> tuple[int, list[dict], float, list[str]]:
    """Exit code, JSON lines, CPU seconds and leftovers of a real run."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("temporary")
        patch.setattr(tempfile, "tempdir", str(folder))
        out = folder / "lines"
        start = time.process_time()
        with out.open("w") as file:
            patch.setattr(sys, "stdout", file)
            code = cli.main(["selftest", "--json", "--device", "cpu"])
        seconds = time.process_time() - start
        lines = [json.loads(line) for line in out.read_text().splitlines()]
        out.unlink()
        return code, lines, seconds, [path.name for path in folder.glob("robir*")]


def test_a_sound_machine_passes_and_says_what_it_is(told):
    code, lines, seconds, leftovers = told
    verdict = lines[-1]
    assert code == 0
    assert verdict["ok"] is True
    assert verdict["device"] == "cpu"
    assert verdict["torch"] == torch.__version__
    assert verdict["numpy"] == np.__version__
    assert verdict["memory_bytes"] > verdict["free_memory_bytes"] > 0
    assert verdict["held_out_psnr"] > specimen.LOWEST_PSNR
    assert verdict["blender"]
    assert "small fit" in verdict["message"]
    assert seconds < 20.0
    assert leftovers == []


def test_a_bad_fit_is_refused(monkeypatch):
    """Photographs mirrored against their masks' cameras: everything runs, nothing fits."""
    honest, drawn = specimen.photograph, []

    def mirrored(pose):
        drawn.append(pose)
        picture = honest(pose)
        if len(drawn) <= specimen.VIEWS["train"]:
            picture[..., :3] = picture[:, ::-1, :3]
        return picture

    monkeypatch.setattr(specimen, "photograph", mirrored)
    verdict = run_selftest("cpu", quiet)
    assert not verdict.ok
    assert verdict.exit_code == 5
    assert "ended badly" in verdict.message
    assert verdict.cure


def test_the_sphere_is_lit_as_the_formula_says():
    """Straight from the sun: full sun in the middle, and a disc of the size a sphere has."""
    pose = specimen._pose(specimen.SUN_DIRECTION)
    picture = specimen.photograph(pose)
    middle = specimen.SIDE // 2
    # the octant of (2, -1, 2) has a negative product
    radiance = specimen.ALBEDO[0] / math.pi * (math.pi * specimen.SKY + specimen.SUN)
    shown = 1.055 * radiance ** (1 / 2.4) - 0.055
    assert picture[middle, middle, :3] == pytest.approx(shown, abs=2e-3)
    angle = math.asin(specimen.RADIUS / specimen.DISTANCE)
    area = math.pi * (specimen.FOCAL * math.tan(angle)) ** 2
    assert picture[..., 3].sum() == pytest.approx(area, rel=3e-3)


def test_cuda_that_torch_does_not_know(monkeypatch, capsys):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", None)
    assert cli.main(["selftest", "--device", "cuda"]) == 4
    said = capsys.readouterr().out
    assert "was built without CUDA" in said
    assert "cure: use --device cpu" in said


def test_memory_that_runs_out(monkeypatch):
    full = DeviceError("out of memory in geometry: lower geometry.level_cells with --set")
    verdict = verdict_of(full, monkeypatch, on="cuda")
    assert verdict.exit_code == 4
    assert verdict.message == "even a small fit runs out of memory on Card 1 (1.0 GB free)"
    assert verdict.cure == "close other programs"


def test_a_full_temporary_folder(monkeypatch):
    verdict = verdict_of(OSError(28, "No space left on device"), monkeypatch)
    assert verdict.exit_code == 6
    assert "temporary folder" in verdict.message
    assert "make room" in verdict.cure
