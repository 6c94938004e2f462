# SPDX-License-Identifier: Apache-2.0
"""`robir selftest`: a real but tiny fit, to see that this machine can reconstruct at all.

Nothing heavy is imported before the test runs: that torch cannot be loaded is one of its findings.
"""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

from robir import __version__
from robir.errors import CancelledError, DeviceError, RobirError, StorageError
from robir.export.blender import missing_blender
from robir.pipeline.device import Machine, choose_execution, machine

USUAL_BYTES = 2 << 30  # memory that a usual capture takes at most

_DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES})


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfTestVerdict:
    """What the test found; every field is plain."""

    ok: bool  # whether reconstructions will work
    # 0, 4 (no usable device or memory), 5 (the fit is bad), or that of another error
    exit_code: int
    seconds: float  # wall seconds of the whole test
    device: str  # "cpu" or "cuda"; empty where none could be used
    device_name: str  # name of the processor or graphics card
    memory_bytes: int  # memory of the device; 0 if unknown
    free_memory_bytes: int  # how much of it is free; 0 if unknown
    torch: str  # version; empty if it is not installed. The same for the next three
    numpy: str  # version
    robir: str  # version
    python: str  # version
    blender: str  # how Cycles would be run, or why it cannot be
    held_out_psnr: float | None  # dB on views that were kept aside; None if the fit did not end
    message: str  # one sentence: that it works, or what is wrong
    cure: str  # what to do; may be said of a machine that just about works, too


def run_selftest(
    asked: Literal["cpu", "cuda", "auto"], progress: Callable[[float, str], None]
) -> SelfTestVerdict:
    """Fit a tiny capture on a device as on the command line, and judge the machine by it.

    `CancelledError` if the user asked to stop.
    """
    begin = time.monotonic()
    found = Machine(name="", memory_bytes=0, free_memory_bytes=0)
    device, psnr, code, message, cure = "", None, 0, "", ""
    try:
        from robir.specimen import judged_fit

        execution = choose_execution(asked, None)
        device, found = execution.device, machine(execution.device)
        psnr = judged_fit(execution, progress)
        message = f"A small fit on {found.name} took {time.monotonic() - begin:.0f} s"
        if 0 < found.free_memory_bytes < USUAL_BYTES:
            message += f", but only {_gigabytes(found.free_memory_bytes)} of memory are free"
            cure = f"a usual capture needs up to {_gigabytes(USUAL_BYTES)}: close other programs"
    except CancelledError:
        raise
    except (ImportError, OSError, RuntimeError, RobirError) as error:
        fault = _in_words(error, device, found)
        code = fault.exit_code
        message, _, cure = str(fault).partition("; ")
    return SelfTestVerdict(
        ok=code == 0,
        exit_code=code,
        seconds=round(time.monotonic() - begin, 1),
        device=device,
        device_name=found.name,
        memory_bytes=found.memory_bytes,
        free_memory_bytes=found.free_memory_bytes,
        torch=_version("torch"),
        numpy=_version("numpy"),
        robir=__version__,
        python=".".join(map(str, sys.version_info[:3])),
        blender=missing_blender() or os.environ.get("ROBIR_BLENDER") or f"bpy {_version('bpy')}",
        held_out_psnr=psnr,
        message=message,
        cure=cure,
    )


def _in_words(error: Exception, device: str, found: Machine) -> RobirError:
    """An error as a sentence with the cure behind the first semicolon; bugs are raised again."""
    if isinstance(error, DeviceError) and str(error).startswith("out of memory"):
        free = f" ({_gigabytes(found.free_memory_bytes)} free)" if found.free_memory_bytes else ""
        return DeviceError(
            f"even a small fit runs out of memory on {found.name}{free}; close other programs"
        )
    if isinstance(error, RobirError):
        return error
    if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
        return StorageError(
            f"the temporary folder cannot be written ({error.strerror}); make room on its disk"
        )
    if isinstance(error, ImportError | OSError):
        return DeviceError(f"a part is missing or broken ({error}); install the engine again")
    if device == "cuda":
        said = str(error).partition("\n")[0]
        return DeviceError(
            f"torch {_version('torch')} cannot compute on {found.name} ({said}); update the "
            "graphics driver, or choose the processor as device"
        )
    raise error


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _gigabytes(count: int) -> str:
    return f"{count / 2**30:.1f} GB"
