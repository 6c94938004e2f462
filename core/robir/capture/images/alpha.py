# SPDX-License-Identifier: Apache-2.0
"""Whether a picture's colours were multiplied by its alpha, as programs that composite write it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FEWEST = 20
"""Soft pixels that have to be there to tell by."""


def is_premultiplied(codes: NDArray[Any]) -> bool:
    """Whether no pixel has a channel above its alpha, and soft pixels are as much darker.

    The second is for dark objects, whose straight colours are below nearly any alpha.

    Args:
        codes: (H, W, 4) uint8 or uint16.
    """
    most = np.iinfo(codes.dtype).max
    brightest, alpha = codes[:, :, :3].max(axis=2), codes[:, :, 3]
    soft, full = (alpha > 0) & (alpha < most), alpha == most
    if (brightest > alpha).any() or soft.sum() < _FEWEST or not full.any():
        return False
    share = float(alpha[soft].mean()) / most
    # brightness of the soft pixels: that of the object if straight, else a share of it
    return float(brightest[soft].mean()) < np.sqrt(share) * float(brightest[full].mean())


def straight_codes(codes: NDArray[Any]) -> NDArray[Any]:
    """Codes with colours divided by alpha.

    Args:
        codes: (H, W, 4) uint8 or uint16, no channel above its alpha.
    """
    most = np.iinfo(codes.dtype).max
    alpha = np.maximum(codes[:, :, 3:], 1).astype(np.float32)
    colour = np.rint(codes[:, :, :3] * (np.float32(most) / alpha)).astype(codes.dtype)
    return np.dstack([colour, codes[:, :, 3]])
