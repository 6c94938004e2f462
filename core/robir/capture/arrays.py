# SPDX-License-Identifier: Apache-2.0
"""Arrays of numbers in numpy's files, looked at before their numbers are read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as numpy_format
from numpy.typing import NDArray

from robir.capture.frames import Array
from robir.capture.refusal import DAMAGED_ARRAYS
from robir.errors import StorageError
from robir.jobs.names import regular

MAX_STORED_BYTES = 1 << 32  # of a result that is read at once; 8192 texels a side take half of it
PICTURES = {...: "u1 + + 3|4"}  # form of pictures by the views' names, for `stored_arrays`
_HEADERS = {(1, 0): numpy_format.read_array_header_1_0, (2, 0): numpy_format.read_array_header_2_0}


def read_matrix(file: IO[bytes], most: int) -> Array:
    """A matrix of at most so many numbers, float64, of what `numpy.save` wrote; else ValueError."""
    shape, is_fortran, dtype = _head(file)
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


def stored_arrays(path: Path, form: Mapping[Any, str]) -> dict[str, NDArray[Any]]:
    """Arrays of a file of `numpy.savez` by name, looked at before their numbers are read.

    The form has for each name the kind of its numbers and its sides, as in "f4 V 3|4": a side is a
    number, one of several, a letter that means the same number above 0 wherever it stands, "*" for
    any number or "+" for one above 0. A name that ends in "?" may be missing; `...` means all
    others. What a form does not name is left out. `StorageError` if it holds something else.
    """
    try:
        with regular(path, MAX_STORED_BYTES) as file, np.load(file, allow_pickle=False) as archive:
            wanted = _wanted(archive.files, form)
            size, sides = 0, dict[str, int]()
            for name, words in wanted.items():
                with archive.zip.open(f"{name}.npy") as member:
                    shape, _, dtype = _head(member)
                if not _fits(words.split(), dtype, shape, sides):
                    raise ValueError(f"{name} is {dtype} of shape {shape}")
                size += math.prod(shape) * dtype.itemsize
            if size > MAX_STORED_BYTES:
                raise ValueError(f"it holds {size} bytes")
            arrays = {name: archive[name] for name in wanted}
        for name, array in arrays.items():
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{name} holds numbers that are not finite")
    except (*DAMAGED_ARRAYS, TypeError, AttributeError) as fault:
        raise StorageError(
            f"{path} is missing or damaged ({fault}); run `robir reconstruct` with --resume"
        ) from fault
    return arrays


def _head(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and kind of the array that comes next in a file."""
    version = numpy_format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"it is of numpy's format {version}")
    return _HEADERS[version](file)


def _wanted(names: Sequence[str], form: Mapping[Any, str]) -> dict[str, str]:
    wanted = dict.fromkeys(names, form[...]) if ... in form else {}
    stated = {key.removesuffix("?"): key for key in form if key is not ...}
    return wanted | {n: form[key] for n, key in stated.items() if n == key or n in names}


def _fits(
    words: Sequence[str], dtype: np.dtype[Any], shape: Sequence[int], sides: dict[str, int]
) -> bool:
    """Whether an array is as its form says; `sides` holds what letters stand for, so far."""
    kind, *wanted = words
    if not dtype.str[1:].startswith(kind) or len(shape) != len(wanted):
        return False
    for word, side in zip(wanted, shape, strict=True):
        if word.isalpha():
            if sides.setdefault(word, side) != side or not side:
                return False
        elif word == "+" and side > 0:
            continue
        elif word != "*" and str(side) not in word.split("|"):
            return False
    return min(shape, default=0) >= 0
