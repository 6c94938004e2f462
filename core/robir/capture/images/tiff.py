# SPDX-License-Identifier: Apache-2.0
"""Directories of TIFF files, looked at before a decoder makes millions of numbers of them."""

from __future__ import annotations

import struct
from typing import BinaryIO

MAX_VALUES = 1 << 17  # numbers that an entry may have: a picture of 65,535 rows has as many strips
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_TEXTS = (1, 2, 7)  # kinds of entries that stay bytes
_EXIF = 34665
_SAMPLE_FORMAT, _FLOATING = 339, 3


def check_directories(file: BinaryIO) -> bool:
    """Refuse a TIFF file with endless entries; other files are let pass.

    Args:
        file: At its beginning, where it is left.

    Returns:
        Whether it is a TIFF file of floating-point numbers.
    """
    order = _ORDERS.get(file.read(4))
    try:
        if order is not None:
            return _check(file, order, *struct.unpack(f"{order}I", file.read(4)))
    except struct.error:
        pass  # it ends too early, which the decoder says
    finally:
        file.seek(0)
    return False


def _check(file: BinaryIO, order: str, start: int, is_exif: bool = False) -> bool:
    file.seek(start)
    is_floating = False
    (count,) = struct.unpack(f"{order}H", file.read(2))
    for _ in range(count):
        tag, kind, values, content = struct.unpack(f"{order}HHII", file.read(12))
        if kind not in _TEXTS and values > MAX_VALUES:
            raise ValueError(f"its entry {tag} has {values} numbers")
        after = file.tell()
        if tag == _SAMPLE_FORMAT:
            file.seek(content if values > 2 else after - 4)
            is_floating = struct.unpack(f"{order}H", file.read(2))[0] == _FLOATING
            file.seek(after)
        if tag == _EXIF and not is_exif:
            _check(file, order, content, is_exif=True)
            file.seek(after)
    return is_floating
