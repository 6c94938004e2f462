# SPDX-License-Identifier: Apache-2.0
"""What each command of the command line does; heavy imports happen only where they are used."""

from __future__ import annotations

import json
import sys
import traceback
from argparse import Namespace
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from robir.config import RunConfig, resolve
from robir.errors import CaptureError, ConfigError, RobirError, UsageError
from robir.jobs.folder import refuse_special
from robir.jobs.paths import STAGES, JobPaths, write_json


def reconstruct(options: Namespace) -> int:
    """Make an asset from a capture; prints the result folder.

    5 if the result failed the program's own quality check; it is whole all the same.
    """
    from robir.display import display_for
    from robir.export.asset import read_facts
    from robir.pipeline.device import choose_execution, keep_freed_memory
    from robir.pipeline.ledger import judged
    from robir.pipeline.runner import RunRequest, load_stages
    from robir.pipeline.runner import reconstruct as run

    keep_freed_memory()
    config, (masks, mesh) = _settings(options)
    asset = None if options.asset is None else read_facts(options.asset)
    with display_for(options.progress) as display:
        request = RunRequest(
            source=options.capture,
            masks=masks,
            out=options.out,
            config=config,
            execution=choose_execution(options.device, options.threads),
            is_resume=options.resume,
            mesh=mesh,
            asset=asset,
            until=options.until,
        )
        paths = run(request, display, load_stages())
    doubt, is_whole = judged(paths), paths.manifest(STAGES[-1]).exists()
    if is_whole and doubt is None and options.progress != "json":
        print("quality check passed", file=sys.stderr)
    print(options.out.resolve())
    return 0 if doubt is None else doubt.exit_code


def batch(options: Namespace) -> int:
    """Bring a library of many results about; prints its page, or what was handed to a farm."""
    from robir.batch.start import batch as start

    return start(options)


def check(options: Namespace) -> int:
    """Say what is noticed about a capture; 3 if it would be refused."""
    from robir.capture.recognise import check_capture, stands_of
    from robir.capture.refusal import describe
    from robir.capture.store import plain_view
    from robir.display import display_for

    with display_for(options.progress) as display:

        def show(fraction: float, message: str) -> None:
            event = {"kind": "progress", "stage": "check", "message": message}
            display.event(event, fraction, None)

        config = resolve(RunConfig(), None, options.assignments).capture
        capture, findings, posed = check_capture(options.capture, options.masks, config, show)
    facts: dict[str, Any] = {"accepted": capture is not None}
    if capture is not None:
        facts |= {
            "format": capture.format,
            "views": len(capture.train),
            "held_out": len(capture.held_out),
            "radius": capture.bounds.radius,
            "centre": capture.bounds.centre.tolist(),
        }
    if options.json:
        if capture is not None:
            facts["cameras"] = [
                plain_view(replace(view, camera=view.camera.uncut()))
                | {"image": str(capture.photographs[view.name].resolve())}
                for view in capture.views
            ]
        elif posed is not None:
            facts |= stands_of(posed) or {}
        print(json.dumps(facts | {"findings": [asdict(finding) for finding in findings]}))
    else:
        if capture is not None:
            print(f"{capture.format}: {facts['views']} views, {facts['held_out']} held out")
        for finding in findings:
            print(f"{finding.level}: {describe(finding)}")
    return 0 if capture is not None else CaptureError.exit_code


def evaluate(options: Namespace) -> int:
    """Say at which level a result loses the photographs; the bench compares it with a truth.

    Scores and pictures go beside the report, the levels into it.
    """
    paths = _finished(options.out)
    from robir.evaluation.levels import level_lines, level_scores
    from robir.export.report.write import show_levels

    levels = level_scores(paths, paths.levels_strip)
    write_json(paths.levels, levels)
    show_levels(paths, levels)
    scores, lines = {}, level_lines(levels)
    if options.truth is not None:
        scores, told = options.compare(paths, options.truth)
        lines = [*told, "", *lines]
    print(json.dumps(scores | {"levels": levels}, indent=2) if options.json else "\n".join(lines))
    return 0


def relight(options: Namespace) -> int:
    """Render a finished result under another light; prints the pictures' paths."""
    paths = _finished(options.out)
    from robir.display import display_for
    from robir.evaluation.light import refuse_light
    from robir.export.blender import run_headless
    from robir.jobs.folder import folder_lock
    from robir.pipeline.faults import stop_requested

    if Path(options.environment).is_file():
        refuse_light(Path(options.environment))
    words = ["relight", str(paths.root), f"--environment={options.environment}"]
    for name in ("views", "rotation", "turntable", "samples", "max_side"):
        value = getattr(options, name)
        if value is not None:
            words.append(f"--{name.replace('_', '-')}={value}")
    with folder_lock(paths.lock), stop_requested(), display_for(options.progress) as display:

        def show(fraction: float, message: str) -> None:
            event = {"kind": "progress", "stage": "relight", "message": message}
            display.event(event, fraction, None)

        outcome = run_headless(words, show)
    for note in outcome.notes:
        print(note, file=sys.stderr)
    for file in outcome.files:
        print(file)
    return 0


def selftest(options: Namespace) -> int:
    """Say whether this machine can reconstruct; with --json the last line is the verdict."""
    from robir.selftest import run_selftest

    def show(fraction: float, message: str) -> None:
        if options.json:
            line = json.dumps({"progress": round(fraction, 3), "message": message})
            print(line, flush=True)

    verdict = asdict(run_selftest(options.device, show))
    code = verdict.pop("exit_code")
    if options.json:
        print(json.dumps(verdict))
    else:
        print("\n".join(f"{name}: {value}" for name, value in verdict.items()))
    return code


def _settings(options: Namespace) -> tuple[RunConfig, tuple[Path | None, Path | None]]:
    """Configuration, masks and mesh; with --resume the folder's settings are the default."""
    from robir.pipeline import folder

    paths = JobPaths(options.out)
    before = folder.read_run(paths) if options.resume else None
    base, masks, mesh = RunConfig(), options.masks, options.mesh
    if before is not None:
        folder.refuse_unnamed(paths, before, "masks", masks)
        folder.refuse_unnamed(paths, before, "mesh", mesh)
    if before is not None and not options.defaults and paths.config.exists():
        try:
            base = folder.read_config(paths)
        except ConfigError as error:
            hint = "add --defaults to go on with today's settings"
            raise ConfigError(f"{error}; {hint}") from error
        if base.capture.outside == "take":  # the folder may be a stranger's: only the user says so
            base = replace(base, capture=replace(base.capture, outside="refuse"))
    config = resolve(base, options.config, options.assignments)
    if options.seed is not None:
        config = replace(config, seed=options.seed)
    if options.constants:
        config = replace(config, constants=tuple(options.constants))
    if config.geometry.fit_mesh and mesh is None:
        raise UsageError("--fit-mesh moves the mesh that --mesh FILE names; give that too")
    return config, (masks, mesh)


def _finished(out: Path) -> JobPaths:
    """Paths of a finished result folder, or UsageError."""
    paths = JobPaths(out)
    refuse_special(paths.root)
    missing = [stage for stage in STAGES if not paths.manifest(stage).exists()]
    if missing:
        raise UsageError(
            f"{out} is not a finished result folder ({missing[0]} is not done); "
            "run or resume `robir reconstruct` first"
        )
    return paths


def show_failure(options: Namespace, message: str, exit_code: int) -> None:
    """Say on standard error why a command ended; as JSON where progress is."""
    if getattr(options, "progress", "") == "json":
        event = {"kind": "failed", "message": message, "exit_code": exit_code}
        sys.stderr.write(json.dumps(event, ensure_ascii=False) + "\n")
    else:
        sys.stderr.write(f"robir: {message}\n")


def fault_of_folder(options: Namespace, error: Exception) -> RobirError | None:
    """What a disk or another user's result folder has against a command, or None."""
    from robir.pipeline.faults import translated

    told = translated(error, options.command.__name__, getattr(options, "out", None))
    return told if isinstance(told, RobirError) else None


def describe_bug(options: Namespace, error: Exception) -> str:
    """One sentence about an error that is ours; the traceback goes to the result folder's log."""
    summary = f"internal error, {type(error).__name__}: {error}"
    text = "".join(traceback.format_exception(error))
    out = getattr(options, "out", None)
    if out is not None and JobPaths(out).run.exists():
        log = JobPaths(out).log
        try:
            with log.open("a", encoding="utf-8") as file:
                file.write(text)
            return f"{summary}; please report it with {log}"
        except OSError:
            pass
    return f"{summary}; please report it with the traceback\n{text}"
