# SPDX-License-Identifier: Apache-2.0
"""Scores of images: albedo under each usual alignment, structure, baked shadows, roughness, light.

Letters: N pixels, H W image rows and columns. A is the truth, B the estimate, both linear Rec.709
unless a name says otherwise. PSNR is 10 log10(1 / mean squared error) with peak 1, the mean taken
over all given pixels and the three channels together. An alignment is one factor (or three) for
all given pixels of all views, never one per view, so a shadow or a wrong object cannot hide in it.
Aligned estimates are clipped to [0, 1], where albedo lives, before they are compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter
from scipy.special import ndtri

from robir.evaluation.metrics import psnr, srgb_from_linear
from robir.maths import tone

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
ALIGNMENTS = ("raw", "one_scalar", "per_channel_lsq", "per_channel_median")
NOMINAL_SHARES = (0.5, 0.68, 0.8, 0.9, 0.95)
MIN_ALBEDO = 0.01
_MATERIAL_STEP = 1.0 / 16.0
_MIN_MATERIAL_PIXELS = 20


def linear_from_srgb(encoded: Array) -> Array:
    """Inverse of `srgb_from_linear` on [0, 1]; float64."""
    return tone.linear_from_srgb(torch.from_numpy(np.asarray(encoded, float)).clamp(0, 1)).numpy()


def alignment_scale(estimate_linear: Array, truth_linear: Array, alignment: str) -> Array:
    """Factors (3,) that bring the estimate B (N, 3) to the truth A (N, 3), linear.

    "one_scalar" is sum(A B) / sum(B B) over all channels; "per_channel_lsq" the same for each
    (NeRFactor); "per_channel_median" is the median of A_c / max(B_c, 1e-6) (TensoIR).
    """
    a, b = np.asarray(truth_linear, np.float64), np.asarray(estimate_linear, np.float64)
    if alignment == "raw":
        return np.ones(3)
    if alignment == "one_scalar":
        return np.full(3, np.sum(a * b) / max(float(np.sum(b * b)), 1e-12))
    if alignment == "per_channel_lsq":
        return np.sum(a * b, axis=0) / np.maximum(np.sum(b * b, axis=0), 1e-12)
    if alignment == "per_channel_median":
        return np.median(a / np.maximum(b, 1e-6), axis=0)
    raise ValueError(f"alignment {alignment!r} is none of {', '.join(ALIGNMENTS)}")


def albedo_scores(estimate_linear: Array, truth_linear: Array) -> dict[str, dict[str, Any]]:
    """PSNR in dB, linear and sRGB, by alignment, and their "scale"; (N, 3), truth in [0, 1]."""
    scores: dict[str, dict[str, Any]] = {"psnr_linear": {}, "psnr_srgb": {}, "scale": {}}
    for alignment in ALIGNMENTS:
        scale = alignment_scale(estimate_linear, truth_linear, alignment)
        aligned = np.clip(np.asarray(estimate_linear) * scale, 0.0, 1.0)
        scores["psnr_linear"][alignment] = psnr(aligned, truth_linear)
        encoded = srgb_from_linear(aligned), srgb_from_linear(truth_linear)
        scores["psnr_srgb"][alignment] = psnr(*encoded)
        scores["scale"][alignment] = [float(s) for s in scale]
    return scores


def band_coverage(estimate_linear: Array, truth_linear: Array, error: Array) -> dict[str, Any]:
    """How often the truth lies within the bands that a stated standard error promises.

    A band of nominal share p is albedo times exp(+-z error), z the normal quantile of (1 + p) / 2,
    error (N,) of the natural log of albedo. Albedos (N, 3) are linear; the estimate is first scaled
    as for "per_channel_lsq"; both are kept from MIN_ALBEDO up, below which logarithms say nothing.
    "nominal" and "observed" shares of NOMINAL_SHARES; "share_90", the observed one at 0.9;
    "median", of the error.
    """
    scale = alignment_scale(estimate_linear, truth_linear, "per_channel_lsq")
    off = np.log(np.clip(np.asarray(estimate_linear) * scale, MIN_ALBEDO, 1.0))
    off = np.abs(off - np.log(np.clip(truth_linear, MIN_ALBEDO, 1.0)))
    observed = [float(np.mean(off <= z * error[:, None])) for z in normal_quantiles()]
    return {
        "nominal": list(NOMINAL_SHARES),
        "observed": observed,
        "share_90": observed[NOMINAL_SHARES.index(0.9)],
        "median": float(np.median(error)),
    }


def normal_quantiles() -> list[float]:
    """Half widths, in standard deviations, of the central bands of NOMINAL_SHARES."""
    return [float(ndtri(0.5 * (1.0 + share))) for share in NOMINAL_SHARES]


def shadow_regions(
    sun_visibility: Array, normal: Array, mask: Mask, sun_direction: Array
) -> tuple[Mask, Mask]:
    """Pixels (H, W) safely in the true sun, and those safely in its cast shadow.

    `sun_visibility` (H, W) is the share of the sun that the surface sees, `sun_direction` points to
    it. Left out: pixels that face away from the sun or graze it (cosine at most 0.1, there shadow
    is shading, not cast), pixels at the mask's border, pixels next to a shadow's edge (visibility
    varies by more than 0.1 in the 3x3 neighbourhood) and penumbrae (visibility in 0.05..0.95).
    """
    # background pixels must not read as shadow's edges: the border is dropped by the erosion
    inside = binary_erosion(mask, np.ones((3, 3), bool))
    varies = maximum_filter(sun_visibility, 3) - minimum_filter(sun_visibility, 3) > 0.1
    usable = inside & ~varies & (normal @ sun_direction > 0.1)
    return usable & (sun_visibility > 0.95), usable & (sun_visibility < 0.05)


def shadow_ratio(
    estimate_linear: Array, truth_linear: Array, in_sun: Mask, in_shadow: Mask
) -> dict[str, Any]:
    """Brightness of the estimate in true sun shadow over that in the sun, material by material.

    Materials are cells of the true albedo: sRGB-encoded, each channel cut into 16 steps. For a
    material g(S) = sum of the estimate over S / sum of the truth over S (all channels), so that
    texture inside a cell cancels; its ratio is g(shadow) / g(sun). The score is the mean over
    materials weighted with the smaller of the two pixel counts; materials with fewer than 20 pixels
    on either side are left out. Needs no alignment: a common factor cancels.
    Both (..., 3), the regions (...) of `shadow_regions`. "ratio": 1 nothing baked, below shadow
    baked in, above over-corrected, None if no material has both sides; "materials",
    "pixels_in_shadow", "pixels_in_sun": what it rests on.
    """
    cell = np.minimum((srgb_from_linear(truth_linear) / _MATERIAL_STEP).astype(np.int64), 15)
    label = cell[..., 0] * 256 + cell[..., 1] * 16 + cell[..., 2]
    ours, true = np.sum(estimate_linear, axis=-1), np.sum(truth_linear, axis=-1)

    def totals(region: Mask) -> tuple[Array, Array, Array]:
        keys = label[region]
        return tuple(  # type: ignore[return-value]
            np.bincount(keys, weights, minlength=4096)
            for weights in (np.ones(len(keys)), ours[region], true[region])
        )

    (sun_n, sun_b, sun_a), (shade_n, shade_b, shade_a) = totals(in_sun), totals(in_shadow)
    weight = np.minimum(sun_n, shade_n)
    used = (weight >= _MIN_MATERIAL_PIXELS) & (sun_b > 0) & (sun_a > 0) & (shade_a > 0)
    facts = {
        "materials": int(used.sum()),
        "pixels_in_shadow": int(shade_n[used].sum()),
        "pixels_in_sun": int(sun_n[used].sum()),
    }
    if not used.any():
        return {"ratio": None, **facts}
    ratios = (shade_b[used] / shade_a[used]) / (sun_b[used] / sun_a[used])
    return {"ratio": float(np.average(ratios, weights=weight[used])), **facts}


def roughness_scores(estimate: Array, truth: Array) -> dict[str, float]:
    """Errors of perceptual roughness (N,): "rmse", "mae", and that of the best constant."""
    difference = np.asarray(estimate, np.float64) - truth
    return {
        "rmse": float(np.sqrt(np.mean(difference**2))),
        "mae": float(np.mean(np.abs(difference))),
        "best_constant_rmse": float(np.std(truth)),
    }


def environment_log_rmse(estimate_linear: Array, truth_linear: Array) -> float:
    """Error of an environment (H, W, 3), lat-long, in log radiance after one common factor.

    With d = ln(B + e) - ln(A + e), e a thousandth of each image's own mean, the score is the
    standard deviation of d over solid angle and channels: the factor is the one that suits best.
    0.69 is a typical error of a factor 2.
    """
    rows = truth_linear.shape[0]
    solid = np.sin((np.arange(rows) + 0.5) * np.pi / rows)[:, None, None]
    weight = np.broadcast_to(solid, truth_linear.shape) / np.sum(
        np.broadcast_to(solid, truth_linear.shape)
    )

    def log(image: Array) -> Array:
        floor = 1e-3 * max(float(np.sum(weight * image)), 1e-12)
        return np.log(np.maximum(image, 0.0) + floor)

    difference = log(np.asarray(estimate_linear, np.float64)) - log(
        np.asarray(truth_linear, np.float64)
    )
    mean = np.sum(weight * difference)
    return float(np.sqrt(np.sum(weight * (difference - mean) ** 2)))


def direction_error(estimate: Array, truth: Array) -> float:
    """Angle between two directions in degrees, 0..180; neither needs to be unit."""
    a, b = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    # atan2 keeps its precision at small angles, where arccos of the cosine loses half its digits
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b))))
