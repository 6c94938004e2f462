# SPDX-License-Identifier: Apache-2.0
"""Scores against independent implementations, on random input."""

from __future__ import annotations

from collections import defaultdict
from statistics import median

import numpy as np
import pytest
from scipy.spatial.distance import cosine

from robir_bench.truth import metrics, surfaces


@pytest.fixture(params=range(3))
def rng(request):
    return np.random.default_rng(request.param)


def test_angles_are_those_of_scipys_cosine_distance(rng):
    a, b = rng.normal(size=(2, 60, 3))
    angles = [np.degrees(np.arccos(1.0 - cosine(p, q))) for p, q in zip(a, b, strict=True)]
    one_by_one = [metrics.direction_error(p, q) for p, q in zip(a, b, strict=True)]
    assert one_by_one == pytest.approx(angles)
    unit = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in (a, b))
    scores = surfaces.normal_scores(*unit, np.ones(60, bool))
    assert scores["mean_degrees"] == pytest.approx(sum(angles) / 60)
    assert scores["median_degrees"] == pytest.approx(median(angles))


def test_environment_error_is_numpys_weighted_variance(rng):
    truth, estimate = rng.uniform(0.1, 5.0, (2, 12, 24, 3))
    # the exact solid angle of a row, where the score takes the sine of its middle
    edges = np.cos(np.linspace(0.0, np.pi, 13))
    weights = np.repeat(edges[:-1] - edges[1:], 24 * 3)
    logs = []
    for image in (estimate, truth):
        floor = 1e-3 * np.average(image.ravel(), weights=weights)
        logs.append(np.log(image.ravel() + floor))
    variance = np.cov(logs[0] - logs[1], aweights=weights, ddof=0)
    assert metrics.environment_log_rmse(estimate, truth) == pytest.approx(
        float(np.sqrt(variance)), rel=1e-4
    )


def test_shadow_ratio_is_its_definition_pixel_by_pixel(rng):
    palette = rng.random((4, 3))
    label = rng.integers(0, 4, (50, 60))
    truth = palette[label]
    estimate = rng.random((50, 60, 3))
    in_sun = rng.random((50, 60)) < 0.5
    in_shadow = ~in_sun & (rng.random((50, 60)) < 0.4)
    sums = defaultdict(lambda: {"sun": [0, 0.0, 0.0], "shade": [0, 0.0, 0.0]})
    for row in range(50):
        for column in range(60):
            side = "sun" if in_sun[row, column] else "shade"
            if side == "shade" and not in_shadow[row, column]:
                continue
            entry = sums[label[row, column]][side]
            entry[0] += 1
            entry[1] += float(estimate[row, column].sum())
            entry[2] += float(truth[row, column].sum())
    total = weight = 0.0
    for entry in sums.values():
        (sun_n, sun_b, sun_a), (shade_n, shade_b, shade_a) = entry["sun"], entry["shade"]
        smaller = min(sun_n, shade_n)
        if smaller >= 20:
            total += smaller * (shade_b / shade_a) / (sun_b / sun_a)
            weight += smaller
    found = metrics.shadow_ratio(estimate, truth, in_sun, in_shadow)
    assert found["ratio"] == pytest.approx(total / weight)
