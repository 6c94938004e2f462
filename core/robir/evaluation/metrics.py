# SPDX-License-Identifier: Apache-2.0
"""Scores of pictures: PSNR, structure and sharpness; PSNR is 10 log10(1 / mean squared error)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from robir.maths import tone

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]

_PSNR_CEILING = 100.0


def srgb_from_linear(linear: Array) -> Array:
    """The sRGB curve of IEC 61966-2-1, after clipping to [0, 1]; float64."""
    return tone.srgb_from_linear(torch.from_numpy(np.asarray(linear, float)).clamp(0, 1)).numpy()


def psnr(estimate: Array, truth: Array) -> float:
    """Peak signal-to-noise ratio in dB for peak 1, at most 100 (equal images); any equal shapes."""
    error = float(np.mean((np.asarray(estimate, np.float64) - truth) ** 2))
    return min(_PSNR_CEILING, -10.0 * float(np.log10(max(error, 1e-30))))


def masked_ssim(estimate: Array, truth: Array, mask: Mask) -> float:
    """Structural similarity of images (H, W, 3) in [0, 1], mean over a mask (H, W) and channels.

    Gaussian window of standard deviation 1.5 (Wang 2004), data range 1; what lies outside the mask
    is set to 0 in both images first.
    """
    a, b = truth * mask[..., None], estimate * mask[..., None]
    how = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    similarity = structural_similarity(a, b, data_range=1.0, channel_axis=-1, full=True, **how)[1]
    return float(np.mean(similarity[mask]))


def sharpness(estimate: Array, truth: Array, mask: Mask) -> float | None:
    """Sum of an image's gradients, L1, over that of the truth: 1 where it is as sharp.

    Images (H, W, 3) in [0, 1]; differences of neighbours along rows and columns that are both in
    the mask (H, W). What is blurred is below 1 wherever it lies; noise counts as sharp in both.
    None where the truth has no gradient.
    """
    own = whole = 0.0
    a, b = np.asarray(truth, np.float64), np.asarray(estimate, np.float64)
    for axis in (0, 1):
        both = np.minimum(*(np.delete(mask, end, axis) for end in (0, -1))).astype(bool)
        own += float(np.abs(np.diff(b, axis=axis)[both]).sum())
        whole += float(np.abs(np.diff(a, axis=axis)[both]).sum())
    return own / whole if whole > 0 else None
