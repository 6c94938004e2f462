# SPDX-License-Identifier: Apache-2.0
"""A command line whose results are perfect at once, for tests of what the bench makes of them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import ClassVar

from evaluation import sphere_run

from robir.evaluation.levels import level_scores
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir_bench.truth.files import has_truth


def write_plan(folder: Path, text: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def scores(albedo: float, shadow: float | None = 1.0, family: str = "filmic") -> dict:
    return {
        "albedo": {
            "psnr_linear": {"per_channel_lsq": albedo, "raw": albedo - 2.0},
            "scale": {"per_channel_lsq": [1.0, 1.0, 1.0]},
        },
        "photo_as_albedo": {"psnr_linear": {"per_channel_lsq": 12.0}},
        "shadow": {"ratio": shadow},
        "light": {"strongest_lobe_degrees": None},
        "normals": {"mean_degrees": 6.0},
        "mask_iou": 0.99,
        "chamfer": {"chamfer": 5.0},
        "roughness": {"rmse": 0.15, "best_constant_rmse": 0.2},
        "tone_curve": {"family": family, "true_view_transform": "Filmic"},
    }


class FakeRobir:
    """Stands for the command line: a perfect sphere as the result; captures "bad" fail.

    Attributes:
        commands: What was asked for.
        idle: Names of the steps that change nothing, by stage.
    """

    _levels: ClassVar[dict | None] = None

    def __init__(self) -> None:
        self.commands: list[tuple[str, ...]] = []
        self.idle: dict[str, list[str]] = {}

    def __call__(self, *words: str) -> subprocess.CompletedProcess[str]:
        self.commands.append(words)
        if words[0] == "relight":
            return subprocess.CompletedProcess(words, 0, "", "")
        if words[0] == "evaluate" and "--truth" not in words:
            if self._levels is None:  # the same of every perfect sphere
                FakeRobir._levels = level_scores(JobPaths(Path(words[1])))
            answer = json.dumps({"levels": self._levels})
            return subprocess.CompletedProcess(words, 0, answer, "")
        if words[0] == "evaluate" and not has_truth(Path(words[3])):
            return subprocess.CompletedProcess(words, 3, "", "robir: no truth\n")
        if words[0] == "evaluate":
            albedo = 18.0 if "no-visibility" in words[1] else 22.0
            albedo = 13.0 if "noise" in words[1] else albedo
            return subprocess.CompletedProcess(words, 0, json.dumps(scores(albedo)), "")
        if words[1].endswith("bad") or "views_1" in words[1]:
            return subprocess.CompletedProcess(words, 3, "", "working\nrobir: no masks\n")
        paths = JobPaths(Path(words[3]))
        shutil.rmtree(paths.root, ignore_errors=True)
        sphere_run.make_run(paths.root)
        write_json(paths.manifest("export"), {"made by": list(words)})
        for stage, names in self.idle.items():
            write_json(
                paths.steps(stage), {"idle": names, "cpu_seconds": dict.fromkeys(names, 1.5)}
            )
        paths.config.write_text("seed = 0\n")
        seconds = {stage: {"wall": 1.0, "cpu": 2.0} for stage in STAGES}
        about = {"state": "done", "seconds": seconds}
        write_json(paths.run, about | {"peak_memory_bytes": {"geometry": 2e9}})
        trust = {"is_trusted": "noise" not in words[1], "doubts": []}
        write_json(paths.report_json, {"held_out": {"psnr": 25.0}, "trust": trust})
        return subprocess.CompletedProcess(words, 0 if trust["is_trusted"] else 5, "", "")
