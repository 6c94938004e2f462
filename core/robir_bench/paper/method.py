# SPDX-License-Identifier: Apache-2.0
"""The methods `paper`, its ablations and `invrender`: other methods' work in our result folder.

They take the capture as our capture stage reads it and leave what our metrics read. A method takes
over the stages that another of them has done already, and their seconds with them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from robir.appearance.texturing import solved_side
from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.store import load_capture
from robir.config import RunConfig
from robir.evaluation.photos import mean_scores, photo_scores
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.pipeline.device import Usage, peak_memory_bytes
from robir_bench.paper.config import VARIANTS, PaperConfig
from robir_bench.paper.stages import PaperRun, run_appearance, run_geometry, run_transport


def reconstruct_published(
    paths: JobPaths, config: RunConfig, method: str, schedule: PaperConfig
) -> dict[str, Any]:
    """Do what is not done yet of a published method's stages.

    One thread, as our own stages of the kind: the sums are short.

    Args:
        paths: Result folder with the capture stage done.
        config: For the seed, the size of mesh and texture.
        method: Name in VARIANTS.
        schedule: How long and how large.

    Returns:
        Scores of the re-rendered held-out views, as `mean_scores` gives them.
    """
    capture = load_capture(paths.stage("capture")).normalised()
    job = PaperRun(
        paths=paths,
        capture=capture,
        config=schedule,
        variant=VARIANTS[method],
        seed=config.seed,
    )
    work: dict[str, Callable[[], None]] = {
        "geometry": lambda: run_geometry(job, config.geometry),
        "transport": lambda: run_transport(job),
        "appearance": lambda: run_appearance(job, solved_side(config.appearance)),
    }
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for stage, task in work.items():
            if not paths.manifest(stage).exists():
                _do(paths, stage, task, method)
    finally:
        torch.set_num_threads(threads)
    write_json(paths.manifest("export"), {"stage": "export", "method": method})
    pictures = stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)
    return mean_scores([photo_scores(pictures[v.name], v) for v in capture.held_out])


def _do(paths: JobPaths, stage: str, task: Callable[[], None], method: str) -> None:
    """Work, and note what it cost."""
    before = Usage.now()
    task()
    about = read_json(paths.run)
    about["seconds"][stage] = Usage.now().seconds_since(before)
    about["peak_memory_bytes"][stage] = peak_memory_bytes()
    write_json(paths.run, about)
    write_json(paths.manifest(stage), {"stage": stage, "method": method})
