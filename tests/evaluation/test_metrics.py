# SPDX-License-Identifier: Apache-2.0
"""Each score against its definition written out another way, on random input."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from skimage.metrics import peak_signal_noise_ratio

from robir.evaluation.metrics import masked_ssim, sharpness
from robir_bench.truth import metrics


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_srgb_agrees_with_its_table_and_inverts(rng):
    # values of IEC 61966-2-1 as printed in many tables
    assert metrics.srgb_from_linear(np.array(0.18)) == pytest.approx(0.46135, abs=1e-5)
    assert metrics.srgb_from_linear(np.array(0.002)) == pytest.approx(0.02584, abs=1e-5)
    value = rng.random(1000)
    assert metrics.linear_from_srgb(metrics.srgb_from_linear(value)) == pytest.approx(value)


def test_psnr_is_scikit_images(rng):
    a, b = rng.random((2, 40, 3))
    assert metrics.psnr(b, a) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=1.0))
    assert metrics.psnr(a, a) == 100.0


@pytest.mark.parametrize("channel", range(3))
def test_least_squares_scale_minimises(rng, channel):
    a = rng.random((500, 3))
    b = a * rng.uniform(0.3, 0.6, 3) + 0.05 * rng.random((500, 3))
    scale = metrics.alignment_scale(b, a, "per_channel_lsq")[channel]
    best = minimize_scalar(lambda s: np.sum((a[:, channel] - s * b[:, channel]) ** 2))
    assert scale == pytest.approx(best.x, rel=1e-6)


def test_median_scale_ignores_a_minority(rng):
    a = 0.2 + 0.5 * rng.random((1000, 3))
    b = a / np.array([2.0, 3.0, 4.0])
    b[:400] *= rng.random((400, 1))  # dark outliers: the median of the ratio moves, by rank only
    scale = metrics.alignment_scale(b, a, "per_channel_median")
    ratios = np.sort(a / b, axis=0)
    assert scale == pytest.approx(0.5 * (ratios[499] + ratios[500]))
    clean = metrics.alignment_scale(b[400:], a[400:], "per_channel_median")
    assert clean == pytest.approx([2.0, 3.0, 4.0])


def test_albedo_scores_undo_exactly_what_each_alignment_can(rng):
    a = 0.1 + 0.4 * rng.random((300, 3))
    scores = metrics.albedo_scores(a * [0.5, 0.6, 0.9], a)["psnr_linear"]
    assert scores["per_channel_lsq"] == scores["per_channel_median"] == 100.0
    assert scores["raw"] < scores["one_scalar"] < 60.0
    grey = metrics.albedo_scores(a * 0.5, a)
    assert grey["psnr_linear"]["one_scalar"] == 100.0
    direct = 10 * np.log10(1 / np.mean((0.5 * a) ** 2))
    assert grey["psnr_linear"]["raw"] == pytest.approx(direct)
    encoded = 1.055 * (a * 0.5) ** (1 / 2.4) - (1.055 * a ** (1 / 2.4))
    assert grey["psnr_srgb"]["raw"] == pytest.approx(10 * np.log10(1 / np.mean(encoded**2)))


def test_bands_of_a_normal_error_hold_what_they_promise(rng):
    truth = rng.uniform(0.05, 0.6, (60_000, 3))
    error = rng.uniform(0.01, 0.06, 60_000)  # small: noise also biases the scale, by its square
    noise = np.exp(error[:, None] * rng.standard_normal(truth.shape))
    found = metrics.band_coverage(truth * noise * [0.5, 0.7, 0.9], truth, error)
    np.testing.assert_allclose(found["observed"], found["nominal"], atol=0.01)
    assert found["share_90"] == pytest.approx(0.9, abs=0.01)
    assert found["median"] == pytest.approx(0.035, abs=0.001)
    # Errors stated at half or twice their size: the normal's share at z / 2 and 2 z.
    half = metrics.band_coverage(truth * noise, truth, error / 2)["share_90"]
    assert half == pytest.approx(0.589, abs=0.01)
    assert metrics.band_coverage(truth * noise, truth, 2 * error)["share_90"] > 0.995


def test_ssim_is_its_formula(rng):
    a, b = rng.random((2, 32, 32, 3))
    mask = np.zeros((32, 32), bool)
    mask[12:20, 11:22] = True
    x = np.arange(-5, 6)
    kernel = np.exp(-(x**2) / (2 * 1.5**2))
    kernel = np.outer(kernel, kernel) / kernel.sum() ** 2
    total = []
    for i, j in zip(*np.nonzero(mask), strict=True):
        for c in range(3):
            rows, columns = slice(i - 5, i + 6), slice(j - 5, j + 6)
            p = (a[..., c] * mask)[rows, columns]
            q = (b[..., c] * mask)[rows, columns]
            mp, mq = (kernel * p).sum(), (kernel * q).sum()
            vp, vq = (kernel * p * p).sum() - mp**2, (kernel * q * q).sum() - mq**2
            cov = (kernel * p * q).sum() - mp * mq
            c1, c2 = 0.01**2, 0.03**2
            top = (2 * mp * mq + c1) * (2 * cov + c2)
            total.append(top / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    assert masked_ssim(b, a, mask) == pytest.approx(np.mean(total), abs=1e-9)


def test_shadow_ratio_compares_within_materials_only():
    # a dark material in shadow beside a bright one in the sun is no baked shadow
    truth = np.full((40, 40, 3), 0.6)
    truth[:, 20:] = 0.1
    shade = np.zeros((40, 40), bool)
    shade[:, 20:] = True
    assert metrics.shadow_ratio(truth, truth, ~shade, shade)["ratio"] is None
    truth[:, 15:20] = 0.1
    found = metrics.shadow_ratio(truth, truth, ~shade, shade)
    assert (found["ratio"], found["materials"]) == (pytest.approx(1.0), 1)
    assert found["pixels_in_sun"] == 5 * 40


def test_shadow_regions_leave_out_edges_and_attached_shadow():
    visibility = np.ones((40, 40))
    visibility[:, 20:] = 0.0
    mask = np.zeros((40, 40), bool)
    mask[2:38, 2:38] = True
    normal = np.zeros((40, 40, 3))
    normal[..., 2] = 1.0
    normal[:10] = [0.0, 0.0, -1.0]
    sun = np.array([0.0, 0.0, 1.0])
    in_sun, in_shadow = metrics.shadow_regions(visibility, normal, mask, sun)
    expected = np.zeros((40, 40), bool)
    expected[10:37, 3:19] = True
    np.testing.assert_array_equal(in_sun, expected)
    np.testing.assert_array_equal(in_shadow, expected[:, ::-1])


def test_roughness_scores(rng):
    truth = rng.random(200)
    scores = metrics.roughness_scores(truth + 0.1, truth)
    assert scores["rmse"] == pytest.approx(0.1)
    assert scores["mae"] == pytest.approx(0.1)
    best = minimize_scalar(lambda c: np.sqrt(np.mean((c - truth) ** 2)))
    assert scores["best_constant_rmse"] == pytest.approx(best.fun)


def test_sharpness_of_a_blurred_wave_is_the_filter_s_response():
    across = 2 * np.pi * np.arange(48) / 12
    wave = np.broadcast_to(0.5 + 0.4 * np.sin(across)[None, :, None], (16, 48, 3))
    mask = np.zeros((16, 48), bool)
    mask[2:-2, 6:42] = True
    assert sharpness(wave, wave, mask) == 1.0
    # brightness and place do not count, contrast does
    assert sharpness(np.roll(wave, 6, axis=1) + 0.1, wave, mask) == pytest.approx(1.0)
    # a mean of three neighbours leaves (1 + 2 cos w) / 3 of a wave of w radians a pixel
    blurred = (np.roll(wave, 1, axis=1) + wave + np.roll(wave, -1, axis=1)) / 3
    left = (1 + 2 * np.cos(2 * np.pi / 12)) / 3
    assert sharpness(blurred, wave, mask) == pytest.approx(left)
    assert sharpness(wave, np.zeros_like(wave), mask) is None
