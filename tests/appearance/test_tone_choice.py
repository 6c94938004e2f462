# SPDX-License-Identifier: Apache-2.0
"""The tone curve that made the photographs is told from the others."""

from __future__ import annotations

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.tone_choice import (
    Candidate,
    choose_tone_curve,
    clipping_evidence,
    preferred_order,
)
from robir.maths.tone import curve_from_name
from robir.transport.observe import Observations

CONFIG = AppearanceConfig(num_scan_directions=400, num_sharp_lobes=1, iterations=60)
SUN, SKY = 5.0, 0.25


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor(1000)


def ranked(stage, name):
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name(name), 700)
    choice = choose_tone_curve(scene, CONFIG, 0)
    return choice.candidates, choice.evidence


def test_a_clipping_curve_is_known_by_its_clipped_pixels(stage):
    candidates, evidence = ranked(stage, "standard")
    assert evidence.verdict is True
    assert candidates[0].curve.name == "standard"
    # Curves that roll off are not even tried.
    assert all(candidate.curve.is_clipping for candidate in candidates)


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
        # a few highlights that nothing leads up to are cut off; one glint is none
        ([100] * 9990 + [255] * 10, True),
        ([100] * 9990 + [255] * 10 + [250] * 2, None),
        ([100] * 9999 + [255], None),
    ],
)
def test_verdict_of_the_histogram(codes, verdict):
    assert clipping_evidence(histogram(codes)).verdict is verdict


def test_the_histogram_is_read_with_a_power_undone():
    retoned = histogram([100] * 900 + [255] * 5 + [236] * 95)  # 245 ^ 2 and 255 ^ 2
    assert clipping_evidence(retoned).bright_share == 0
    assert clipping_evidence(retoned, 2.0).bright_share == pytest.approx(0.095)
    assert clipping_evidence(retoned, 2.0).verdict is False


def test_shares_count_only_what_is_seen():
    seen = histogram([255, 255, 250, 100])
    seen.weight[0] = 0
    evidence = clipping_evidence(seen)
    assert evidence.clipped_share == pytest.approx(1 / 3)
    assert evidence.bright_share == pytest.approx(1 / 3)


def scored(name, score, standard_error):
    return Candidate(
        curve=curve_from_name(name),
        score=score,
        standard_error=standard_error,
        light=None,
        problem=None,
    )


@pytest.mark.parametrize(("lead", "expected"), [(0.2, "standard"), (0.5, "robir_aces")])
def test_the_curve_between_all_others_must_lead_clearly(lead, expected):
    candidates = [
        scored("standard", 10 + lead, 0.1),
        scored("filmic", 10.9, 0.1),
        scored("robir_aces", 10.0, 0.0),
    ]
    order = [candidate.curve.name for candidate in preferred_order(candidates, None)]
    assert order[0] == expected
    assert sorted(order) == ["filmic", "robir_aces", "standard"]


@pytest.mark.parametrize(
    ("lead", "verdict", "expected"),
    [(0.25, None, "filmic"), (0.35, None, "standard"), (0.25, True, "standard")],
)
def test_the_plain_curve_must_lead_clearly_where_nothing_is_bright(lead, verdict, expected):
    candidates = [scored("standard", 10.0, 0.0), scored("filmic", 10.0 + lead, 0.1)]
    assert preferred_order(candidates, verdict)[0].curve.name == expected
