# SPDX-License-Identifier: Apache-2.0
"""Work side by side on the processor's cores, with the same bits whatever their number.

What is done at a time is one item or one block of fixed size, never a share that depends on the
number of threads, and results come back in the items' order. So a sum over them has one order, and
a run that another number of cores goes on with ends with the same bits. Threads do, as torch,
NumPy, OpenCV, Embree and zlib let others go on while they compute.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from robir.errors import CancelledError

Item = TypeVar("Item")
Result = TypeVar("Result")

_state = threading.local()
_chosen: list[int] = []


# environment variable by which who starts several runs at a time shares the cores out
CORES = "ROBIR_CORES"


def available_cores() -> int:
    """Cores that this process may use: of the machine, its affinity and its control groups.

    Fewer where whoever started it says so, see `CORES`.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity else os.cpu_count() or 1
    quota = min(_quotas(Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")), default=float(count))
    told = os.environ.get(CORES, "")
    share = int(told) if told.isascii() and told.isdigit() else count
    return max(1, min(count, int(quota + 0.5), share))


def _quotas(told: Path, root: Path) -> Iterator[float]:
    """Cores that control groups allow, of this process' group and all above it (cgroups(7))."""
    try:
        lines = told.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return
    for _, controllers, name in (line.split(":", 2) for line in lines if line.count(":") > 1):
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = root / controllers if controllers else root
        group = mount / name.strip("/")
        for folder in (group, *group.parents):
            if folder.is_relative_to(mount):
                yield from _quota(folder)


def _quota(folder: Path) -> Iterator[float]:
    """Cores of one control group, of version 2 or 1; nothing where it has no limit."""
    files = (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))
    for names in files:
        try:
            words = " ".join((folder / name).read_text(encoding="utf-8") for name in names).split()
            quota, period = (int(word) for word in words)
        except (OSError, ValueError):  # not there, or "max"
            continue
        if quota > 0 and period > 0:
            yield quota / period


def use_workers(count: int | None) -> int:
    """Set how many threads work side by side from now on, all cores if None; returns how many."""
    _chosen[:] = [count or available_cores()]
    return _chosen[0]


def num_workers() -> int:
    """How many threads work side by side; one inside of what is done so itself."""
    if getattr(_state, "is_worker", False):
        return 1
    return _chosen[0] if _chosen else use_workers(None)


def side_by_side(
    function: Callable[[Item], Result], items: Iterable[Item], most: int | None = None
) -> list[Result]:
    """Results of a function, in the items' order, several at a time, at most `most`.

    It must not change what another item's call reads. What is raised is the exception of the first
    item, in order, that raised one; no further item is begun then.
    """
    listed, is_in_vain = list(items), getattr(_state, "is_in_vain", threading.Event())

    def done(item: Item) -> Result:
        if is_in_vain.is_set():
            raise CancelledError("nobody waits for it any more")
        return function(item)

    threads = min(num_workers(), len(listed), most or len(listed))
    if threads < 2:
        return [done(item) for item in listed]
    with ThreadPoolExecutor(threads, "robir", _become_worker) as pool:
        begun = [pool.submit(done, item) for item in listed]
        try:
            return [future.result() for future in begun]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def blocks(count: int, size: int) -> list[slice]:
    """Slices of a fixed size, the last one shorter, that cover so many things in their order."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


@contextmanager
def meanwhile(function: Callable[[], Result]) -> Iterator[Callable[[], Result]]:
    """Do something beside the block; yields what waits for it and gives its result.

    With one worker it is done when its result is asked for. Where the block ends by a fault, it
    ends at the next item that it has `side_by_side`.
    """
    if num_workers() < 2:
        yield function
        return
    is_in_vain = threading.Event()

    def begin() -> None:
        _state.is_in_vain = is_in_vain

    with ThreadPoolExecutor(1, "robir", begin) as pool:
        begun: Future[Result] = pool.submit(function)
        try:
            yield begun.result
        except BaseException:
            is_in_vain.set()
            raise


def _become_worker() -> None:
    _state.is_worker = True
