# SPDX-License-Identifier: GPL-3.0-or-later
"""Follows what works outside of Blender, and tells the panels about it.

Two kinds of work: a *task* is a subprocess that prints JSON lines and ends with Blender; a *job* is
a reconstruction, which goes on without Blender and is followed by its result folder. One of either
is at work at a time. All of it is looked at from one timer in the main thread; the thread that
reads a task's lines touches nothing of Blender's.
"""

import atexit
import json
import queue
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ..command_line import worker_environment
from ..engine.errors import AddonError
from ..gateway import client
from ..words import told
from . import growth
from .task import OnEnd, OnLine, Task
from .worker import problem_and_cure, result_folder

# called with the result folder of a job that was followed to its good end
on_done: list[Callable[[Path], None]] = []
_PULSE = 0.1
_JOB_PERIOD = 0.5
# seconds from the request to stop until a job is told to end; half as many later it is made to
_PATIENCE = 10.0
_STOPPING = "Stopping"


@dataclass
class _Job:
    """A reconstruction that is followed."""

    root: Path
    shown: growth.Growth
    stopped_at: float | None = None
    next_look: float = 0.0


@dataclass
class _Work:
    """All that is followed."""

    task: Task | None = None
    job: _Job | None = None
    steps: deque[Iterator[object]] = field(default_factory=deque)


_work = _Work()


def is_busy() -> bool:
    """Whether a task or a job is at work."""
    return _work.task is not None or _work.job is not None


def run_task(*work: Any) -> None:
    """Start a task (`_begin_task`); what comes of it is told later, in the main thread."""
    _begin_task(*work)
    _wake()


def wait_task(*work: Any) -> None:
    """Run a task to its end."""
    task = _begin_task(*work)
    try:
        while _work.task is task:
            with suppress(queue.Empty):
                _take_line(task, task.next_line(1.0))
    except BaseException:
        task.kill()
        _work.task, _state().task = None, ""
        raise


def watch(root: Path) -> None:
    """Follow the job at work in a result folder, started here or by another Blender."""
    _begin_job(root)
    _wake()


def wait_job(root: Path) -> client.Snapshot:
    """Follow a job to its end; interrupting this stops the job."""
    job = _begin_job(root)
    while True:
        try:
            snapshot = _look_at(job)
            if not snapshot.is_live:
                return snapshot
            time.sleep(_PULSE)
        except KeyboardInterrupt:
            cancel()


def cancel() -> None:
    """Ask what is at work to stop; the answer is shown at once, whatever it does."""
    if _work.task is not None:
        _work.task.stop()
    elif _work.job is not None:
        _work.job.stopped_at = time.monotonic()
        try:
            client.request_cancel(_work.job.root)
        except OSError:  # no room for the request, or the folder is gone
            client.stop(_work.job.root)
    else:
        return
    _state().message = told(_STOPPING)
    redraw()


def do_in_steps(steps: Iterator[object]) -> None:
    """Do work piece by piece, so that the window stays alive; without a window all at once."""
    if bpy.app.background:
        deque(steps, maxlen=0)
    else:
        _work.steps.append(steps)
        _wake()


def drop_steps() -> None:
    """Leave undone what `do_in_steps` has not done."""
    _work.steps.clear()


@contextmanager
def in_window() -> Iterator[None]:
    """A context with a window for operators; timers and handlers have none of their own."""
    windows = bpy.context.window_manager.windows
    if bpy.context.window is None and len(windows):
        with bpy.context.temp_override(window=windows[0]):
            yield
    else:
        yield


def show_problem(sentence: str) -> None:
    """Show what went wrong and the cure; an empty sentence takes both away."""
    state = _state()
    state.error, state.error_cure = problem_and_cure(sentence)


def redraw() -> None:
    """Draw anew what shows the state; the viewport itself only where its sidebar covers it."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
            elif area.type in ("IMAGE_EDITOR", "PREFERENCES"):
                area.tag_redraw()


def _state() -> Any:
    return bpy.context.window_manager.robir


def _wake() -> None:
    # a timer that is there when Python ends keeps the wheel from ending, and never fires there
    if not bpy.app.background and not bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.register(_pulse, persistent=True)


def _sleep() -> None:
    if bpy.app.timers.is_registered(_pulse):
        bpy.app.timers.unregister(_pulse)


def _pulse() -> float | None:
    """Look at everything; ends the timer when nothing is left."""
    try:
        _pulse_once()
    except Exception as fault:  # a timer that raises would silently never come again
        traceback.print_exc()
        show_problem(told("internal error, {fault!r}; copy the report", fault=fault))
    return _PULSE if is_busy() or _work.steps else None


def _pulse_once() -> None:
    task, job = _work.task, _work.job
    if task is not None:
        if task.stopped_at is not None:
            task.stop()
        end = time.monotonic() + 0.5 * _PULSE
        with suppress(queue.Empty):
            while _work.task is task and time.monotonic() < end:
                _take_line(task, task.next_line(0.0))
        redraw()
    if job is not None and time.monotonic() >= job.next_look:
        job.next_look = time.monotonic() + _JOB_PERIOD
        _look_at(job)
        redraw()
    if _work.steps:
        steps = _work.steps[0]
        end = time.monotonic() + 0.5 * _PULSE
        for _ in steps:
            if time.monotonic() > end:
                break
        else:
            _work.steps.popleft()
        redraw()


def _refuse_if_busy() -> None:
    if is_busy():
        raise AddonError("something is at work already; wait until it is done, or cancel it")


def _begin(name: str, message: str) -> None:
    state = _state()
    state.task, state.message = name, message
    state.fraction, state.stage = 0.0, ""
    state.seconds_left = -1.0
    show_problem("")


def _begin_task(
    name: str,
    command: Sequence[str],
    on_line: OnLine,
    on_end: OnEnd,
    environment: Mapping[str, str] | None = None,
) -> Task:
    """Start a task under its name in `WindowManager.robir.task`; an AddonError if it cannot be.

    "progress" (or "fraction") and "message" of every JSON object that it prints are shown, then
    `on_line` gets it. At the end, when nothing is at work any more, `on_end` gets the exit code,
    130 if the task was cancelled, and the last words that were no JSON. Without variables of its
    own it has those of an engine.
    """
    _refuse_if_busy()
    variables = worker_environment() if environment is None else environment
    task = Task(name, command, on_line, on_end, variables)
    _begin(name, "")
    _work.task = task
    return task


def _take_line(task: Task, line: str | None) -> None:
    """Handle one line of a task, or its end."""
    state = _state()
    if line is None:
        _work.task = None
        state.task = state.message = ""  # what is said from now on is for a user who has time
        task.on_end(*task.end())
        return
    try:
        event = json.loads(line)
    except ValueError:
        event = None
    if not isinstance(event, dict):
        if line.strip():
            task.said.append(line.rstrip())
        return
    state.task = task.name  # the state is emptied when a file is opened
    if task.stopped_at is None:
        fraction = event.get("progress", event.get("fraction"))
        if isinstance(fraction, int | float):
            state.fraction = fraction
        if isinstance(event.get("message"), str):
            state.message = event["message"]
    task.on_line(event)


def _begin_job(root: Path) -> _Job:
    _refuse_if_busy()
    _begin("reconstruct", told("starting"))
    _state().job = str(root)
    growth.forget()
    _work.job = job = _Job(root, growth.Growth(root))
    return job


def _look_at(job: _Job) -> client.Snapshot:
    """Show where a job stands; at its end forget it."""
    if job.stopped_at is not None:
        waited = time.monotonic() - job.stopped_at
        if waited > _PATIENCE:
            client.stop(job.root, is_forced=waited > 1.5 * _PATIENCE)
    snapshot = client.snapshot(job.root)
    state = _state()
    state.task, state.job = "reconstruct", str(job.root)
    state.fraction, state.stage = snapshot.fraction, snapshot.stage
    left = snapshot.seconds_left
    state.seconds_left = -1.0 if left is None else left
    state.message = snapshot.message if job.stopped_at is None else told(_STOPPING)
    if job.shown.look(snapshot.stage if snapshot.is_live else ""):
        state.preview_serial += 1
    if not snapshot.is_live:
        _end_job(job, snapshot)
    return snapshot


def _end_job(job: _Job, snapshot: client.Snapshot) -> None:
    state = _state()
    _work.job = None
    state.task = state.job = state.message = ""
    growth.clear_surface()
    if snapshot.state == "done":
        for hook in on_done:
            hook(job.root)
    elif snapshot.state == "cancelled":
        state.message = told("Stopped; Reconstruct goes on from the last finished stage")
    elif snapshot.state == "none":
        show_problem(told("the folder {name} is gone; Reconstruct begins anew", name=job.root.name))
    else:
        show_problem(snapshot.message)


def _attach_after_load(*_: object) -> None:
    """Follow a worker again that is at work on the result of one of the scenes."""
    for scene in () if bpy.app.background else bpy.data.scenes:
        root = result_folder(scene.robir)
        if root is not None and not is_busy() and client.snapshot(root).is_live:
            watch(root)


HANDLERS = (("load_post", _attach_after_load),)


def register() -> None:
    """Follow workers that are at work already."""
    atexit.register(_sleep)
    if not bpy.app.background:  # later: while add-ons register, the data cannot be looked at
        bpy.app.timers.register(_attach_after_load, first_interval=_JOB_PERIOD, persistent=True)


def unregister() -> None:
    """Follow nothing any more: tasks end, a reconstruction goes on by itself."""
    atexit.unregister(_sleep)
    if bpy.app.timers.is_registered(_attach_after_load):
        bpy.app.timers.unregister(_attach_after_load)
    _sleep()
    if _work.task is not None:
        _work.task.kill()
    if _work.job is not None:
        growth.clear_surface()
    _work.task = _work.job = None
    _work.steps.clear()
