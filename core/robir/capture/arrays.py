# SPDX-License-Identifier: Apache-2.0
"""Arrays of numbers in numpy's files, looked at before their numbers are read."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as numpy_format
from numpy.typing import NDArray

from robir.capture.frames import Array
from robir.capture.refusal import DAMAGED_ARRAYS
from robir.capture.regular import regular
from robir.errors import StorageError

MAX_STORED_BYTES = 1 << 31
"""Largest set of arrays of a result that is read at once."""

_HEADERS = {
    (1, 0): numpy_format.read_array_header_1_0,
    (2, 0): numpy_format.read_array_header_2_0,
}


def read_matrix(file: IO[bytes], most: int) -> Array:
    """A two-dimensional array of plain numbers.

    Args:
        file: At the beginning of what `numpy.save` wrote.
        most: Numbers it may have.

    Returns:
        The array as 64-bit floating-point numbers.

    Raises:
        ValueError: If it is no such array, or too large.
    """
    version = numpy_format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"it is of numpy's format {version}")
    shape, is_fortran, dtype = _HEADERS[version](file)
    if dtype.kind not in "fiu" or dtype.itemsize > 8:
        raise ValueError(f"it holds {dtype} instead of numbers")
    if len(shape) != 2 or not all(type(side) is int and 0 <= side <= most for side in shape):
        raise ValueError(f"it has {len(shape)} dimensions or an impossible size")
    count = math.prod(shape)
    if count > most:
        raise ValueError(f"it has {count} numbers; at most {most} are read")
    content = file.read(count * dtype.itemsize)
    if len(content) < count * dtype.itemsize:
        raise ValueError("it ends too early")
    order = "F" if is_fortran else "C"
    return np.frombuffer(content, dtype).reshape(shape, order=order).astype(np.float64)


def stored_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a file of a result folder, by name.

    Args:
        path: What `numpy.savez` wrote.

    Raises:
        StorageError: If it is missing, damaged, or too large to be ours.
    """
    try:
        with regular(path, MAX_STORED_BYTES) as file:
            with zipfile.ZipFile(file) as members:
                size = sum(member.file_size for member in members.infolist())
            if size > MAX_STORED_BYTES:
                raise StorageError(f"{path} holds {size} bytes and is none of ours")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files}
    except (*DAMAGED_ARRAYS, TypeError, AttributeError) as fault:
        raise StorageError(
            f"{path} is missing or damaged ({fault}); run `robir reconstruct` with --resume"
        ) from fault
