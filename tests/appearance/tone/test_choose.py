# SPDX-License-Identifier: Apache-2.0
"""The tone curve that made the photographs is told from the others."""

from __future__ import annotations

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.tone.choose import choose_tone_curve, clipping_evidence
from robir.appearance.tone.ranking import camera_lags, simplest_near_best
from robir.maths.tone import curve_from_name
from robir.steps import Pipeline
from robir.transport.observe import Observations

CONFIG = AppearanceConfig(num_scan_directions=400, num_sharp_lobes=1, iterations=60)
SUN, SKY = 5.0, 0.25


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor(1000)


def ranked(stage, name):
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name(name), 700)
    choice = choose_tone_curve(scene, CONFIG, 0, Pipeline())
    return choice.candidates, choice.evidence


def test_a_clipping_curve_is_known_by_its_clipped_pixels(stage):
    candidates, evidence = ranked(stage, "standard")
    assert evidence.verdict is True
    assert candidates[0].curve.name == "standard"
    # Curves that roll off are not even tried.
    assert {candidate.curve.name for candidate in candidates} <= {"standard", "camera"}


def test_filmic_is_known_by_cross_prediction(stage):
    candidates, evidence = ranked(stage, "filmic")
    assert evidence.verdict is not True
    names = [candidate.curve.name for candidate in candidates]
    assert names[0] == "filmic" and "agx" in names
    scores = {candidate.curve.name: candidate.score for candidate in candidates}
    assert scores["filmic"] == min(scores.values())
    assert scores["khronos_pbr_neutral"] > 1.2 * scores["filmic"]
    assert candidates[0].standard_error == 0
    sun = candidates[0].light.axes[0]
    assert np.degrees(np.arccos(sun @ synthetic.SUN)) < 4


def test_the_response_of_a_camera_is_known_from_the_srgb_curve(stage):
    candidates, evidence = ranked(stage, "camera")
    assert evidence.verdict is True
    assert [candidate.curve.name for candidate in candidates] == ["camera", "standard"]
    sun = candidates[0].light.axes[0]
    assert np.degrees(np.arccos(sun @ synthetic.SUN)) < 4


def histogram(codes: list[int]) -> Observations:
    display = np.repeat(np.array(codes, np.uint8)[:, None, None], 3, axis=2)
    return Observations(
        display=display,
        weight=np.ones(display.shape[:2], np.float32),
        clipped=display == 255,
        off_axis=np.zeros(display.shape[:2], np.uint8),
        positions=np.zeros((1, 3), np.float32),
        views=("a",),
    )


@pytest.mark.parametrize(
    ("codes", "verdict"),
    [
        ([100] * 900 + [255] * 50 + [250] * 10, True),
        ([100] * 900 + [255] * 5 + [250] * 95, False),
        ([100] * 900 + [250] * 50, False),
        ([100] * 900, None),
        # a white plate that just clips leads up to white as much as it clips
        ([100] * 860 + [255] * 60 + [250] * 80, None),
        ([100] * 900 + [255] * 20 + [250] * 80, False),
        # a few highlights that nothing leads up to are cut off; one glint is none
        ([100] * 9990 + [255] * 10, True),
        ([100] * 9990 + [255] * 10 + [250] * 2, None),
        ([100] * 9999 + [255], None),
    ],
)
def test_verdict_of_the_histogram(codes, verdict):
    assert clipping_evidence(histogram(codes)).verdict is verdict


def table(mean, noise=0.0, count=400):
    """Errors of blocks, 0..1, of a mean in codes; noise in codes is that of one block."""
    spread = np.random.default_rng(0).standard_normal(count)
    return (mean + noise * (spread - spread.mean())) / 255, np.ones(count)


NAMES = ["standard", "camera", "filmic", "agx", "robir_aces"]


@pytest.mark.parametrize(
    ("origin", "scores", "expected"),
    [
        ("auto", (9.0, 9.0, 9.0, 9.0, 9.0), "camera"),
        ("auto", (8.85, 9.0, 9.0, 9.0, 9.0), "camera"),  # errors of the light do as much
        ("auto", (8.7, 9.0, 9.0, 9.0, 9.0), "standard"),
        ("auto", (9.5, 9.0, 8.5, 9.0, 9.0), "filmic"),
        ("auto", (8.45, 9.0, 8.5, 9.0, 9.0), "filmic"),  # most renderers roll off
        ("auto", (9.5, 9.0, 8.58, 8.5, 9.0), "filmic"),  # within a tenth of a code the simpler one
        ("auto", (9.5, 9.0, 8.65, 8.5, 9.0), "agx"),
        ("camera", (5.0, 9.0, 9.0, 9.0, 9.0), "camera"),
        ("render", (9.0, 5.0, 8.5, 9.0, 9.0), "filmic"),
    ],
)
def test_the_lowest_error_is_taken_if_a_cameras_response_lags(origin, scores, expected):
    """Every table agrees from block to block, so that the standard error is a tenth of a code."""
    tables = [table(score) for score in scores]
    lags = camera_lags(tables, NAMES, origin)
    assert (NAMES[simplest_near_best(tables, NAMES)] if lags else "camera") == expected


def test_a_lag_counts_by_its_standard_error():
    noisy = [table(8.0), table(9.0, noise=10.0)]  # 0.5 codes over 400 blocks
    assert not camera_lags(noisy, NAMES[:2], "auto")
    assert camera_lags([table(8.0), table(9.0)], NAMES[:2], "auto")


def test_an_only_curve_is_taken():
    assert simplest_near_best([table(9.0)], ["camera"]) == 0
    assert not camera_lags([table(9.0)], ["camera"], "render")
