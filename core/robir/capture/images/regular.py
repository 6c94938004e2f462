# SPDX-License-Identifier: Apache-2.0
"""Every file of a capture is opened here: a regular one of sane size, and nothing else."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from robir.jobs.names import open_regular

# largest file of poses that is read; those of thousands of photographs have a tenth of it
MAX_BYTES = 1 << 28


@contextmanager
def regular(path: Path, most: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """A regular file of sane size, opened for reading; everything a capture holds is read by it."""
    with os.fdopen(open_regular(path), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(f"{path.name} has {size} bytes; at most {most} are read")
        yield file
