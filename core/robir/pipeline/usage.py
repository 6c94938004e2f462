# SPDX-License-Identifier: Apache-2.0
"""What a stage costs: wall and CPU seconds, peak memory."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass


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
