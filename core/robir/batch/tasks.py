# SPDX-License-Identifier: Apache-2.0
"""A library as a job for a farm: one task a capture, or one for each part of its stages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from robir.batch.farm import Job, Place, Step
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import STAGES

FIT = "geometry"  # the stage that a graphics card shortens most
_WHOLE = {"Reconstruct": (STAGES[0], STAGES[-1])}
# first and last stage of each step
_PARTS = {"Read": ("capture", "capture"), "Fit": (FIT, FIT), "Finish": ("transport", STAGES[-1])}


def library_job(
    paths: LibraryPaths, captures: Path, tasks: Sequence[int], memory: int, queue: str | None
) -> Job:
    """The captures that are to be done, by their numbers in the plan, and the page after all.

    `memory` is what the most hungry of them needs, bytes. `queue` is None for all stages in one
    task. Else the fit is a task of its own that asks for a graphics card, on Slurm in the partition
    of this name; empty for the usual one.
    """
    root = paths.root.absolute()
    common = ("batch", "--resume", "-o", "{{Param.Library}}", "--captures", "{{Param.Captures}}")
    steps: list[Step] = []
    for name, (first, last) in (_WHOLE if queue is None else _PARTS).items():
        is_fit = queue is not None and first == FIT
        step = Step(
            name=name,
            words=common if queue is None else (*common, "--stages", f"{first}-{last}"),
            tasks=tuple(tasks),
            after=steps[-1].name if steps else "",
            is_paired=True,
            memory=memory,
            needs_gpu=is_fit,
            queue=queue or "" if is_fit else "",
        )
        steps.append(step)
    steps.append(Step(name="Page", words=(*common, "--page"), after=steps[-1].name))
    return Job(
        name=f"RobIR {root.name}",
        places={
            "Library": Place(
                path=root, flow="INOUT", about="Results, assets and the contact sheet"
            ),
            "Captures": Place(path=captures, flow="IN", about="Folder that holds all captures"),
        },
        steps=steps,
    )
