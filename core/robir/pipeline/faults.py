# SPDX-License-Identifier: Apache-2.0
"""What can go wrong below a stage, in words for the user."""

from __future__ import annotations

import errno
import math
import os
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from robir.errors import (
    CancelledError,
    CaptureError,
    DeviceError,
    QualityError,
    RobirError,
    StorageError,
)
from robir.jobs.folder import is_full

_FAILING = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO})
# how libraries tell of them that raise an error of their own
_DISK_WORDS = {os.strerror(number).lower(): number for number in _FAILING}
# how a network drive or a disk that was pulled out is told; not every system knows all
_AWAY = ("ESTALE", "ETIMEDOUT", "ENOTCONN", "EHOSTDOWN", "ENXIO", "ENODEV")
_DISK_ERRORS = _FAILING | {getattr(errno, name) for name in _AWAY if hasattr(errno, name)}

_held: list[int] = []  # while a stop has to wait: a zero, then the signals that have come
# the setting that decides most about each stage's memory
_MEMORY_CURES = {
    "capture": "capture.max_side",
    "geometry": "geometry.level_cells",
    "transport": "transport.num_surfels",
    "appearance": "appearance.num_solve_surfels",
    "export": "export.render_max_side",
}


def translated(error: BaseException, stage: str, out: Path | None) -> BaseException:
    """The error as a RobirError with a sentence for the user, or itself where it is a bug."""
    if isinstance(error, RobirError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return CancelledError("stopped; continue with --resume")
    disk = _disk_error(error, out)
    if disk is not None:
        what, place = disk.filename or out or "a file", stage or "the result folder"
        return StorageError(
            f"{what} cannot be read or written in {place}: "
            f"{disk.strerror}; make room or mend the folder, then continue with --resume"
        )
    if _is_out_of_memory(error):
        cure = _MEMORY_CURES.get(stage, _MEMORY_CURES["capture"])
        return DeviceError(
            f"out of memory in {stage}: lower {cure} with --set, then continue with --resume"
        )
    if isinstance(error, ImportError):
        return DeviceError(
            f"the installation is damaged or not whole ({error}); install robir again"
        )
    if isinstance(error, PermissionError) and error.filename:
        path = Path(error.filename)  # or the folder on the way to it that may not be entered
        above = (folder for folder in reversed(path.parents) if folder.is_dir())
        barred = next((folder for folder in above if not os.access(folder, os.X_OK)), path)
        return CaptureError(
            f"{barred} cannot be read: {error.strerror}; give yourself the right to read it"
        )
    if out is not None and is_full(out):
        return StorageError(f"the disk of {out} is full; make room, then continue with --resume")
    return error


def refuse_nan(stage: str, metrics: Mapping[str, Any], folder: Path) -> None:
    """Refuse metrics that are not finite, and arrays with a NaN, by a `QualityError`."""
    import numpy as np

    floats = {name: value for name, value in metrics.items() if isinstance(value, float)}
    broken = [name for name, value in floats.items() if not math.isfinite(value)]
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as arrays:
            for name in arrays.files:
                array = arrays[name]
                if array.dtype.kind == "f" and np.isnan(array).any():
                    broken.append(f"{path.name}:{name}")
    if broken:
        raise QualityError(
            f"{stage} ended with numbers that are not finite ({', '.join(broken)}); "
            "run `robir check` on the capture, or try another --seed"
        )


@contextmanager
def stop_requested() -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into CancelledError for the length of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _frame: object) -> None:
        if _held:
            _held.append(number)
        else:
            raise _stopped(number)

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stop_held() -> Iterator[None]:
    """Let a stop wait for the block's end: a process started in it is then known to its ender."""
    _held.append(0)
    try:
        yield
    finally:
        numbers = [number for number in _held if number]
        _held.clear()
    if numbers:
        raise _stopped(numbers[-1])


def _stopped(number: int) -> CancelledError:
    return CancelledError(f"stopped by {signal.Signals(number).name}; continue with --resume")


def _disk_error(error: BaseException, out: Path | None) -> OSError | None:
    """The disk's own error, also where another came of it: closing a half-written file fails."""
    link: BaseException | None = error
    seen: set[int] = set()
    while link is not None and id(link) not in seen:
        seen.add(id(link))
        if isinstance(link, OSError) and (link.errno in _DISK_ERRORS or _is_below(link, out)):
            return link
        text = str(link).lower()
        for words, number in _DISK_WORDS.items():
            if words in text:
                return OSError(number, os.strerror(number))
        link = link.__cause__ or link.__context__
    return None


def _is_out_of_memory(error: BaseException) -> bool:
    text = str(error)
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError)
        and ("out of memory" in text or "can't allocate memory" in text)
    )


def _is_below(error: OSError, out: Path | None) -> bool:
    if out is None or error.filename is None:
        return False
    return Path(str(error.filename)).is_relative_to(out)
