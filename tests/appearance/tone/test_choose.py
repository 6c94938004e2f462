# SPDX-License-Identifier: Apache-2.0
"""The tone curve that made the photographs is told from the others."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import fit
from robir.appearance.tone.choose import choose_tone_curve
from robir.appearance.tone.clipping import clipping_evidence
from robir.appearance.tone.ranking import Judged, best_shoulder, chosen_number
from robir.appearance.tone.shoulder import Lead, PlainLead
from robir.maths.tone import curve_from_name
from robir.steps import Course
from robir.transport.observe import Observations

CONFIG = AppearanceConfig(num_scan_directions=400, num_sharp_lobes=1, iterations=60)
SUN, SKY = 5.0, 0.25


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor(1000)


def ranked(stage, name):
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name(name), 700)
    choice = choose_tone_curve(scene, CONFIG, 0, Course())
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


NAMES = ["standard", "filmic", "agx", "robir_aces"]


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ((9.0, 10.0, 10.5, 11.0), "filmic"),
        ((9.0, 10.5, 10.0, 11.0), "agx"),
        # within a tenth of a code the simpler one
        ((9.0, 10.05, 10.0, 11.0), "filmic"),
        # the curve between all others must lead them all, the plain one too
        ((11.0, 11.0, 11.5, 10.0), "robir_aces"),
        ((10.05, 11.0, 11.5, 10.0), "filmic"),
        ((11.0, 10.05, 11.5, 10.0), "filmic"),
    ],
)
def test_the_best_curve_with_a_shoulder(scores, expected):
    chosen = best_shoulder(NAMES, [table(score) for score in scores])
    assert NAMES[chosen] == expected


@pytest.mark.parametrize(
    ("plain", "neutral", "scores", "expected"),
    [
        (0.0, 0.0, (9.0, 10.0, 9.0), "filmic"),  # what display errors say of these is not asked
        (3.0, 0.0, (9.0, 10.0, 9.0), "standard"),
        (0.0, 3.0, (9.0, 10.0, 9.0), "khronos_pbr_neutral"),
        (0.0, 3.0, (9.0, 10.0, 10.0), "filmic"),
        (3.0, 0.0, (9.0, 10.0, 8.5), "khronos_pbr_neutral"),  # of these two they are
    ],
)
def test_plain_and_neutral_curve_must_lead_a_shoulder_clearly(plain, neutral, scores, expected):
    names = ["standard", "filmic", "khronos_pbr_neutral"]
    leads = {(0, 1): plain, (2, 1): neutral}

    def lead_of(index, shoulder, steps, seed):
        shadows = Lead(value=leads[index, shoulder], error=1.0)
        return PlainLead(
            plain=names[index],
            shoulder=names[shoulder],
            shadows=shadows,
            highlights=None,
            margin=2.0,
        )

    tables = [table(score) for score in scores]
    judged = SimpleNamespace(tables=tables, lead=lead_of, config=CONFIG)
    number, lead = chosen_number(judged, names, 10, 0)
    assert names[number] == expected
    assert lead.total == plain


@pytest.mark.parametrize(
    ("camera", "plain", "expected"),
    [(1.9, 3.0, "standard"), (2.1, 3.0, "camera"), (2.1, 1.0, "filmic"), (1.9, 1.0, "filmic")],
)
def test_a_cameras_response_must_lead_the_plain_curve(camera, plain, expected):
    """And then lead a shoulder in its place."""
    names, asked = ["standard", "camera", "filmic"], []

    def lead_of(index, shoulder, steps, seed):
        asked.append((index, shoulder))
        shadows = Lead(value=camera if (index, shoulder) == (1, 0) else plain, error=1.0)
        return PlainLead(
            plain=names[index],
            shoulder=names[shoulder],
            shadows=shadows,
            highlights=None,
            margin=2.0,
        )

    tables = [table(score) for score in (9.0, 9.0, 10.0)]
    judged = SimpleNamespace(tables=tables, lead=lead_of, config=CONFIG)
    number, _ = chosen_number(judged, names, 10, 0)
    assert names[number] == expected
    assert asked == [(1, 0), (1 if camera > 2.0 else 0, 2)]
    assert names[chosen_number(judged, names[:2], 10, 0)[0]] == (
        "camera" if camera > 2.0 else "standard"
    )


def models_of(scene, steps):
    """The scene under the plain curve and Filmic, with lights of so many steps."""
    models = []
    for name in ("standard", "filmic"):
        problem = make_problem(scene, curve_from_name(name))
        models.append((problem, fit(problem, synthetic.SUN[None], np.float32([2000.0]), steps)))
    return models


def test_lights_are_settled_before_the_plain_curve_is_compared(stage):
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name("filmic"), 700)
    models = models_of(scene, 2)
    early, settled = (Judged.of(models, CONFIG).lead(0, 1, steps, 0).shadows for steps in (0, 150))
    assert settled.value < early.value - 0.02
    assert settled.errors < -2


@pytest.mark.parametrize(("origin", "margin"), [("auto", -1.0), ("camera", -2.0), ("render", 2.0)])
def test_where_photographs_are_from_is_a_prior_on_the_curve(stage, origin, margin):
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name("filmic"), 700)
    told = replace(CONFIG, origin=origin)
    assert Judged.of(models_of(scene, 2), told).lead(0, 1, 0, 0).margin == margin
