# SPDX-License-Identifier: Apache-2.0
"""Runs what has to be run of the five stages, in order, in one result folder."""

from __future__ import annotations

import gc
import importlib
import logging
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from robir.config import RunConfig
from robir.constants import changed
from robir.errors import CancelledError, RobirError, StorageError
from robir.export.asset import AssetFacts, is_current, make_asset
from robir.jobs.context import StageContext
from robir.jobs.folder import create, folder_lock
from robir.jobs.paths import STAGES, JobPaths, replacing, write_json
from robir.pipeline import folder
from robir.pipeline.device import Execution, Usage, peak_memory_bytes
from robir.pipeline.faults import refuse_nan, stop_requested, translated
from robir.pipeline.ledger import (
    StageModule,
    StageState,
    capture_fingerprint,
    clear_for_rerun,
    judged,
    mesh_fingerprint,
    remove_leftovers,
    stage_fingerprints,
    stage_state,
    write_manifest,
)
from robir.pipeline.reporter import Display, RunReporter
from robir.settings import toml_from_settings

_NO_ASSET = "no asset for Blender's library: "


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRequest:
    """What the user asked for."""

    source: Path  # capture
    masks: Path | None  # folder of masks, or None
    out: Path  # result folder
    config: RunConfig  # resolved configuration
    execution: Execution  # device and threads
    is_resume: bool  # whether an unfinished or outdated folder may be worked on
    mesh: Path | None = None  # mesh that takes the place of a surface of our own, or None
    asset: AssetFacts | None = None  # facts of the asset to be made, or None
    until: str = STAGES[-1]  # stage after which the run ends; the next one goes on from there

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages that are to be done."""
        return STAGES[: STAGES.index(self.until) + 1]


def load_stages() -> dict[str, StageModule]:
    """The real stages; imports torch."""
    stages = {
        stage: cast(StageModule, importlib.import_module(f"robir.{stage}.stage"))
        for stage in STAGES
    }
    # what is loaded stays: to look for garbage in it takes a tenth of a second again and again
    gc.freeze()
    return stages


def reconstruct(
    request: RunRequest, display: Display, stages: Mapping[str, StageModule]
) -> JobPaths:
    """Bring a result folder to the state the request asks for, finished up to `until`.

    A folder that is there already is left alone. Whatever ends the run early leaves a folder that
    `is_resume` continues. `judged` says whether a whole result passed the quality check.
    `RobirError` with a sentence for the user.
    """
    paths = JobPaths(request.out)
    follows_links = request.config.capture.outside == "take"
    capture = capture_fingerprint(request.source, request.masks, request.out, follows_links)
    mesh = mesh_fingerprint(request.mesh)
    with changed(request.config.constants):
        create(paths)
        try:
            with folder_lock(paths.lock), _logging_to(paths.log), stop_requested():
                _bring_up_to_date(request, paths, display, stages, (capture, mesh))
        except OSError as error:
            raise translated(error, "", paths.root) from error
    return paths


def _bring_up_to_date(
    request: RunRequest,
    paths: JobPaths,
    display: Display,
    stages: Mapping[str, StageModule],
    inputs: tuple[str, str],
) -> None:
    """Look at what is there, refuse what must not be touched, and run the rest."""
    capture, mesh = inputs
    revisions = {name: stages[name].REVISION for name in STAGES}
    expected = stage_fingerprints(request.config, revisions, capture, mesh)
    states: dict[str, StageState] = {
        stage: stage_state(paths, stage, expected[stage]) for stage in STAGES
    }
    run = folder.read_run(paths)
    if run is not None:
        folder.refuse_other_capture(paths, run, request.source, capture)
        folder.refuse_other_mesh(paths, run, request.mesh, mesh)
    pending = [stage for stage in STAGES if states[stage] != "done"]
    reporter = RunReporter(paths, display, pending)
    wanted = [stage for stage in pending if stage in request.stages]
    asset = request.asset if request.until == STAGES[-1] else None
    lacks_asset = not pending and asset is not None and not is_current(paths, asset)
    if run is not None and not wanted and not lacks_asset:
        remove_leftovers(paths)
        if pending:
            reporter.pause(f"{request.until} is done already; go on with --resume")
        else:
            _finish(paths, run, reporter, f"{request.out} is finished already; nothing to do")
        return
    is_worth_keeping = any(state in ("done", "stale") for state in states.values())
    if run is not None and wanted and is_worth_keeping and not request.is_resume:
        folder.refuse_without_resume(paths, run, capture, request.config)
    _Run(request, paths, reporter, run, inputs).work(stages, states, expected)


def _finish(paths: JobPaths, run: Mapping[str, Any], reporter: RunReporter, message: str) -> None:
    """Note that a result is whole, and with which exit code its quality lets the run end."""
    doubt = judged(paths)
    code = 0 if doubt is None else doubt.exit_code
    write_json(paths.run, {**run, "state": "done", "exit_code": code})
    reporter.finish(message if doubt is None else f"{message}, but {doubt}", code)


class _Run:
    """One working pass over a result folder that is ours and locked."""

    def __init__(
        self,
        request: RunRequest,
        paths: JobPaths,
        reporter: RunReporter,
        before: dict[str, Any] | None,
        inputs: tuple[str, str],
    ) -> None:
        self._request = request
        self._paths = paths
        self._reporter = reporter
        self._facts = folder.new_run(
            capture=folder.capture_facts(request.source, request.masks, request.mesh, inputs),
            config=request.config,
            execution=request.execution,
        )
        if before is not None:
            for key in ("seconds", "peak_memory_bytes", "warnings"):
                self._facts[key] = before[key]

    def work(
        self,
        stages: Mapping[str, StageModule],
        states: Mapping[str, StageState],
        expected: Mapping[str, str],
    ) -> None:
        """Run every stage that is not done; see `reconstruct` for the errors."""
        try:
            self._open()
            for stage in self._request.stages:
                if states[stage] == "done":
                    self._reporter.skip(stage)
                    continue
                clear_for_rerun(self._paths, stage, states[stage])
                self._work_stage(stage, stages[stage], expected[stage])
            if self._request.until != STAGES[-1]:
                self._reporter.pause(f"{self._request.until} is done; go on with --resume")
                return
            if self._request.asset is not None:
                self._make_asset(self._request.asset)
            _finish(self._paths, self._facts, self._reporter, f"{self._paths.root} is finished")
        except BaseException as error:
            fault = translated(error, self._reporter.stage, self._paths.root)
            code = fault.exit_code if isinstance(fault, RobirError) else 1
            self._reporter.fail(str(fault) or type(fault).__name__, code)
            if fault is error:
                raise
            raise fault from error

    def _open(self) -> None:
        self._paths.cancel.unlink(missing_ok=True)
        remove_leftovers(self._paths)
        write_json(self._paths.run, self._facts)
        with replacing(self._paths.config) as temporary:
            temporary.write_text(toml_from_settings(self._request.config), encoding="utf-8")

    def _work_stage(self, stage: str, module: StageModule, expected: str) -> None:
        request, paths = self._request, self._paths
        # The report reads run.json, where a killed attempt may have left this stage's warnings.
        self._facts["warnings"] = [w for w in self._facts["warnings"] if w["stage"] != stage]
        write_json(paths.run, self._facts)
        self._reporter.begin(stage)
        paths.stage(stage).mkdir(parents=True, exist_ok=True)
        _seed_everything(request.config.seed)
        before = Usage.now()
        given: dict[str, Any] = {
            "source": request.source,
            "masks": request.masks,
            "mesh": request.mesh,
        }
        how: dict[str, Any] = {"seed": request.config.seed, "device": request.execution.device}
        config = getattr(request.config, stage)
        context = StageContext(paths=paths, config=config, reporter=self._reporter, **given, **how)
        metrics = dict(module.run(context))
        refuse_nan(stage, metrics, paths.stage(stage))
        seconds = Usage.now().seconds_since(before)
        memory = peak_memory_bytes()
        self._facts["seconds"][stage], self._facts["peak_memory_bytes"][stage] = seconds, memory
        self._facts["warnings"] += self._reporter.take_warnings()
        write_json(paths.run, self._facts)
        facts = {"revision": module.REVISION, "fingerprint": expected, "seed": context.seed}
        costs = {"seconds": seconds, "peak_memory_bytes": memory, "metrics": metrics}
        write_manifest(paths, stage, facts | costs)
        self._reporter.end(stage, metrics, seconds)

    def _make_asset(self, facts: AssetFacts) -> None:
        """Make the asset for Blender's library; without Blender the result is whole as well."""

        def follow(_fraction: float, message: str) -> None:
            self._reporter.progress(0.0, message)

        kept = [w for w in self._facts["warnings"] if not w["message"].startswith(_NO_ASSET)]
        try:
            if not is_current(self._paths, facts):
                make_asset(self._paths, facts, follow)
        except (CancelledError, StorageError):
            raise
        except RobirError as error:
            self._reporter.warn(f"{_NO_ASSET}{error}")
        self._facts["warnings"] = kept + self._reporter.take_warnings()


def _seed_everything(seed: int) -> None:
    """Seed the global generators, for libraries that know no other."""
    import numpy as np
    import torch

    random.seed(seed)
    np.random.seed(seed)
    torch.manual_seed(seed)


@contextmanager
def _logging_to(path: Path) -> Iterator[None]:
    """Copy our log and Python's warnings to a file for the length of the block."""
    handler = _RunLog(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    loggers = [logging.getLogger(name) for name in ("robir", "py.warnings")]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _RunLog(logging.FileHandler):
    """The log for people; that a disk is full is told by the run itself, once."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  the name is logging's
        """A line that cannot be written is lost."""
