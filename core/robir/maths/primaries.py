# SPDX-License-Identifier: Apache-2.0
"""Linear RGB of other primaries and whites in linear Rec.709, and sRGB codes (IEC 61966-2-1).

Whites are adapted by Bradford's cones, as ICC profiles are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

D50, D65 = (0.3457, 0.3585), (0.3127, 0.3290)  # whites, CIE xy

# red, green and blue of Rec.709 and sRGB, CIE xy; their white is D65
REC709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))

_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def rgb_to_rec709(primaries: Any, white: Any) -> Matrix:
    """Linear values of primaries and a white, CIE xy, to linear Rec.709, (3, 3)."""
    return xyz_to_rec709(white) @ _to_xyz(primaries, white)


def xyz_to_rec709(white: Any) -> Matrix:
    """XYZ under a white, CIE xy, to linear Rec.709, (3, 3)."""
    gains = (_BRADFORD @ _xyz(D65)) / (_BRADFORD @ _xyz(white))
    adapted = np.linalg.solve(_BRADFORD, gains[:, None] * _BRADFORD)
    return np.linalg.solve(_to_xyz(REC709, D65), adapted)


def linear_from_srgb(code: Matrix) -> Matrix:
    """Linear values of sRGB codes in [0, 1]."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def srgb_codes(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit sRGB codes of linear Rec.709 values; what lies outside is clipped."""
    value = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    curved = 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055
    return np.rint(255 * np.where(value <= 0.0031308, 12.92 * value, curved)).astype(np.uint8)


def _to_xyz(primaries: Any, white: Any) -> Matrix:
    """Linear values to XYZ under their own white."""
    columns = np.array([_xyz(point) for point in primaries]).T
    return columns * np.linalg.solve(columns, _xyz(white))


def _xyz(point: Any) -> Matrix:
    x, y = point
    return np.array([x / y, 1.0, (1 - x - y) / y])
