# SPDX-License-Identifier: Apache-2.0
"""The machine: its device and threads, its memory, and what a stage costs of it."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
import time
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
    models = _told("/proc/cpuinfo", "model name")
    name = models[0] if models else platform.processor() or platform.machine()
    return f"{name}, {cores}"


def _main_memory() -> tuple[int, int]:
    """All main memory and what is available of it, bytes; 0 where the system does not say."""
    if sys.platform == "win32":
        return _windows_memory()
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    available = _told("/proc/meminfo", "MemAvailable")
    return total, 1024 * int(available[0].split()[0]) if available else 0


def _told(file: str, key: str) -> list[str]:
    """Values of a key in a file of Linux; none on other systems."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    return [line.partition(":")[2].strip() for line in lines if line.startswith(key)]


def _windows_memory() -> tuple[int, int]:
    import ctypes

    # dwLength and dwMemoryLoad share the first eight bytes; seven sizes of eight bytes follow
    status = (ctypes.c_uint64 * 8)(64)
    if not ctypes.windll.kernel32.GlobalMemoryStatusEx(status):  # type: ignore[attr-defined]
        return 0, 0
    return status[1], status[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Clock readings of this process and the children it has waited for."""

    wall: float  # monotonic clock, seconds
    cpu: float  # user plus system time, seconds

    @classmethod
    def now(cls) -> Usage:
        """Read the clocks."""
        times = os.times()
        cpu = times.user + times.system + times.children_user + times.children_system
        return cls(wall=time.monotonic(), cpu=cpu)

    def seconds_since(self, earlier: Usage) -> dict[str, float]:
        """Wall and CPU seconds between two readings."""
        return {"wall": round(self.wall - earlier.wall, 2), "cpu": round(self.cpu - earlier.cpu, 2)}


def peak_memory_bytes() -> int:
    """Largest resident size so far, of this process or of one of its children; 0 if unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return unit * max(
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # numbers of glibc's settings, see mallopt(3)
KEPT_BYTES = 1 << 29  # of freed memory at the heap's end: more than the tensors of a step take
LARGEST_KEPT_BYTES = (1 << 28, 32 << 20)  # the second for old versions of glibc


def keep_freed_memory() -> None:
    """Have freed memory used again, where glibc would return it to the system and clear it anew.

    That costs a seventh of the processor time of the geometry fit. Other C libraries stay.
    """
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        any(set_option(_MMAP_THRESHOLD, size) for size in LARGEST_KEPT_BYTES)
        set_option(_TRIM_THRESHOLD, KEPT_BYTES)
