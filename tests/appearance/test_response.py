# SPDX-License-Identifier: Apache-2.0
"""Another curve than cameras have is taken where views are predicted better under it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance import response
from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import make_problem
from robir.appearance.proof import Proof
from robir.appearance.response import lead_in_errors, solved
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import Candidate
from robir.maths.tone import curve_from_name
from robir.steps import Course

CONFIG = AppearanceConfig(
    num_soft_lobes=synthetic.NUM_SOFT, num_scan_directions=600, iterations=90, num_materials=4
)
CODE_ERROR = CONFIG.tone.code_error
VARNISHED = synthetic.Material(np.array([0.3, 0.12, 0.1], np.float32), roughness=0.3)


def tone_of(scene, names):
    """The choice as shadows might give it, the true light known under every curve."""
    candidates = []
    for name in names:
        curve = curve_from_name(name)
        candidates.append(
            Candidate(
                curve=curve,
                score=1.0,
                standard_error=0.1,
                light=synthetic.sun_and_uneven_sky(),
                problem=make_problem(scene, curve),
            )
        )
    tone = ToneChoice.of(scene, CONFIG, 0)
    return replace(tone, candidates=candidates)


def photographed(name, *, by_camera=True):
    everywhere = [(lambda at: at[:, 0] < 9, VARNISHED)]
    light = synthetic.sun_and_uneven_sky()
    scene, _ = synthetic.ball(everywhere, light, curve_from_name(name))
    return replace(scene, by_camera=by_camera)


@pytest.mark.parametrize("true", ["camera", "filmic"])
def test_views_tell_the_response_of_a_camera_from_filmic(true):
    tone, solution = solved(tone_of(photographed(true), ["filmic", "camera"]), CONFIG, 0, Course())
    assert tone.candidates[0].curve.name == solution.problem.curve.name == true
    (choice,) = [c for c in solution.choices if c.choice == "curve of a camera"]
    assert {choice.chosen, *choice.alternatives} == {"filmic", "camera"} and choice.chosen == true
    assert len(tone.candidates) == 2


@pytest.mark.parametrize(
    ("names", "by_camera"),
    [(["camera", "filmic"], True), (["filmic", "standard"], True), (["filmic", "camera"], False)],
)
def test_nothing_is_solved_twice_where_there_is_nothing_to_ask(names, by_camera, monkeypatch):
    calls = []
    monkeypatch.setattr(response, "solve", lambda *given: calls.append(given))
    tone, solution = solved(
        tone_of(photographed("camera", by_camera=by_camera), names), CONFIG, 0, Course()
    )
    assert len(calls) == 1 and solution is None
    assert tone.candidates[0].curve.name == names[0]


def test_a_lead_counts_against_its_error_and_a_tenth_of_a_code():
    rng = np.random.default_rng(4)
    views = np.repeat(np.arange(20), 50)
    plain = (10 / 255) ** 2 * rng.chisquare(3, 1000) / 3
    # half a code less everywhere: certain, but for the tenth
    rich = plain * 0.95**2
    lead = lead_in_errors(Proof.of(plain, rich, (views,)), CODE_ERROR)
    assert lead == pytest.approx(0.05 * 255 * np.sqrt(plain.mean()) / 0.1, rel=0.1)
    # noise that gains nothing
    other = (10 / 255) ** 2 * rng.chisquare(3, 1000) / 3
    assert abs(lead_in_errors(Proof.of(plain, other, (views,)), CODE_ERROR)) < 2.5
    # from the same errors twice nothing follows
    assert lead_in_errors(Proof.of(plain, plain, (views,)), CODE_ERROR) == 0
