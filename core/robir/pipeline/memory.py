# SPDX-License-Identifier: Apache-2.0
"""How the process keeps memory that it has freed."""

from __future__ import annotations

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # numbers of glibc's settings, see mallopt(3)
# freed memory at the end of the heap that is kept: more than the tensors of a step take
KEPT_BYTES = 1 << 29
# Larger blocks go back at once. Old versions of glibc allow no more than the second.
LARGEST_KEPT_BYTES = (1 << 28, 32 << 20)


def keep_freed_memory() -> None:
    """Have freed memory used again instead of handed back to the system.

    A step of a fit makes and drops hundreds of tensors of some megabytes each. By default glibc
    returns those to the system and asks for them anew, and every page that comes back is cleared
    and mapped: a seventh of the processor time of the geometry fit. Nothing happens where the C
    library is another one.
    """
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        any(set_option(_MMAP_THRESHOLD, size) for size in LARGEST_KEPT_BYTES)
        set_option(_TRIM_THRESHOLD, KEPT_BYTES)
