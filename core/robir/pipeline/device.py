# SPDX-License-Identifier: Apache-2.0
"""Chooses the device and how many threads work side by side, and says what they are."""

from __future__ import annotations

import os
import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from robir.errors import DeviceError
from robir.workers import use_workers


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """What a run works with; no part of any fingerprint."""

    device: str  # torch device, "cpu" or "cuda"
    threads: int  # that work side by side, see `robir.workers`


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """What a device is."""

    name: str  # of the processor or the graphics card
    memory_bytes: int  # all its memory; 0 if unknown
    free_memory_bytes: int  # what a new process can have of it; 0 if unknown


def choose_execution(asked: Literal["cpu", "cuda", "auto"], threads: int | None) -> Execution:
    """The device to work on; also sets the number of threads, None for all cores there are.

    An operation of torch has one thread, whatever their number: sums split over threads come out
    otherwise, and operations of a fit are so short that waking a second one costs more than it
    saves. "auto" takes a CUDA device where there is one; `DeviceError` if it is asked for and there
    is none.
    """
    import torch

    torch.set_num_threads(1)
    has_cuda = torch.cuda.is_available()
    if asked == "cuda" and not has_cuda:
        raise DeviceError(_why_no_cuda())
    device = "cuda" if has_cuda and asked != "cpu" else "cpu"
    return Execution(device=device, threads=use_workers(threads))


def machine(device: str) -> Machine:
    """Name and memory of a torch device, "cpu" or "cuda"."""
    if device == "cuda":
        import torch

        free, total = torch.cuda.mem_get_info()
        name = torch.cuda.get_device_name()
        return Machine(name=name, memory_bytes=total, free_memory_bytes=free)
    total, free = _main_memory()
    return Machine(name=_processor(), memory_bytes=total, free_memory_bytes=free)


def _why_no_cuda() -> str:
    """What keeps torch from CUDA, and the cure."""
    import torch

    if torch.version.cuda is None:
        return (
            f"torch {torch.__version__} was built without CUDA; use --device cpu, or install torch "
            "for CUDA"
        )
    try:
        torch.cuda.init()
        said = "it finds none"
    except (RuntimeError, AssertionError) as error:
        said = str(error).strip().partition(". ")[0]
    return (
        f"torch {torch.__version__} for CUDA {torch.version.cuda} finds no CUDA device ({said}); "
        "use --device cpu, or install or update NVIDIA's driver"
    )


def _processor() -> str:
    cores = f"{os.cpu_count()} cores"
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = models[0] if models else platform.processor() or platform.machine()
    return f"{name}, {cores}"


def _main_memory() -> tuple[int, int]:
    """All main memory and what is available of it, bytes; 0 where the system does not say."""
    if sys.platform == "win32":
        return _windows_memory()
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        lines = Path("/proc/meminfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return total, 0
    available = [int(line.split()[1]) for line in lines if line.startswith("MemAvailable")]
    return total, 1024 * available[0] if available else 0


def _windows_memory() -> tuple[int, int]:
    """As `_main_memory`, from GlobalMemoryStatusEx."""
    import ctypes

    # dwLength and dwMemoryLoad share the first eight bytes; seven sizes of eight bytes follow
    status = (ctypes.c_uint64 * 8)(64)
    if not ctypes.windll.kernel32.GlobalMemoryStatusEx(status):  # type: ignore[attr-defined]
        return 0, 0
    return status[1], status[2]
