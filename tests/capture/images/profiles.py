# SPDX-License-Identifier: Apache-2.0
"""Colours of other programs, written by published numbers: profiles, codes and PNG chunks."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

# situations that people report, rebuilt small; None where the folder is absent
REPORTS = next(
    (p / "shared/reports" for p in Path(__file__).parents if (p / "shared/reports").is_dir()), None
)

# red, green and blue in the columns, XYZ under D50 (ICC)
COLORANTS = {
    "srgb": [[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.7141]],
    "p3": [[0.51512, 0.29198, 0.1571], [0.2412, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]],
    "adobe": [[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.7446]],
    "prophoto": [[0.79767, 0.13519, 0.03134], [0.28804, 0.71188, 0.00009], [0.0, 0.0, 0.82491]],
}  # fmt: skip

# exponents; 0 for the curve of sRGB
GAMMAS = {"p3": 0.0, "adobe": 563 / 256, "prophoto": 1.8, "srgb": 0.0}


def linear(code: np.ndarray) -> np.ndarray:
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def curved(value: np.ndarray) -> np.ndarray:
    value = np.clip(value, 0, 1)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def in_space(srgb: np.ndarray, name: str) -> np.ndarray:
    """sRGB codes in [0, 1] as codes of another space."""
    matrix = np.linalg.solve(np.array(COLORANTS[name]), np.array(COLORANTS["srgb"]))
    values = np.clip(linear(srgb) @ matrix.T, 0, 1)
    return values ** (1 / GAMMAS[name]) if GAMMAS[name] else curved(values)


def profile(name: str) -> bytes:
    """A matrix profile (ICC version 2); sRGB's curve as a version 4 formula."""
    text = name.encode() + b"\0"
    described = b"desc" + struct.pack(">II", 0, len(text)) + text + bytes(78)
    if GAMMAS[name]:
        curve = b"curv" + struct.pack(">IIH", 0, 1, round(256 * GAMMAS[name])) + b"\0\0"
    else:
        numbers = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
        curve = b"para" + struct.pack(">IHH5i", 0, 3, 0, *(round(65536 * n) for n in numbers))
    tags = {b"desc": described, b"cprt": b"text\0\0\0\0none\0", b"wtpt": xyz(0.9642, 1, 0.8249)}
    for axis, column in zip(b"rgb", np.array(COLORANTS[name]).T, strict=True):
        tags |= {bytes([axis]) + b"XYZ": xyz(*column), bytes([axis]) + b"TRC": curve}
    table, body, at = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for key, content in tags.items():
        table += key + struct.pack(">II", at + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = struct.pack(">I4sI4s4s4s", 132 + len(table) - 4 + len(body), b"none", 0x02400000,
                       b"mntr", b"RGB ", b"XYZ ")  # fmt: skip
    head += bytes(12) + b"acsp" + bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return head.ljust(128, b"\0") + table + body


def xyz(*values: float) -> bytes:
    return b"XYZ " + struct.pack(">I3i", 0, *(round(65536 * value) for value in values))


def with_chunk(path: Path, kind: bytes, content: bytes) -> None:
    """Put a chunk after the first of a PNG file."""
    data = path.read_bytes()
    check = struct.pack(">I", zlib.crc32(kind + content))
    chunk = struct.pack(">I", len(content)) + kind + content + check
    path.write_bytes(data[:33] + chunk + data[33:])
