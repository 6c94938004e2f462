# SPDX-License-Identifier: Apache-2.0
"""Suns stay where views or shadows prove them, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.held_out_suns import lead_in_errors, together, with_tested_suns
from robir.appearance.held_out_test import HeldOutTest
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import fit, no_suns
from robir.appearance.solution import solve
from robir.appearance.tone import ranking
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import CurveCandidate
from robir.maths.tone import curve_from_name
from robir.steps import Pipeline

CONFIG = AppearanceConfig(
    num_soft_lobes=synthetic.NUM_SOFT, num_scan_directions=600, iterations=90, num_materials=4
)
VARNISHED = synthetic.Material(np.array([0.3, 0.12, 0.1], np.float32), roughness=0.3)


def tone_of(scene, names):
    """The choice as shadows might give it, the true light known under every curve."""
    candidates = []
    for name in names:
        curve = curve_from_name(name)
        candidates.append(
            CurveCandidate(
                curve=curve,
                score=1.0,
                standard_error=0.1,
                light=synthetic.sun_and_uneven_sky(),
                problem=make_problem(scene, curve),
            )
        )
    tone = ToneChoice.of(scene, CONFIG, 0)
    return replace(tone, candidates=candidates)


CAMERA = curve_from_name("camera")


def proven(scene, light, false_sun=0.0, without=()):
    """What becomes of a light that was found, and why.

    With a false sun, the strengths of which were once found somehow, the light has it as that says.
    """
    tone = tone_of(scene, ["camera"])
    problem = make_problem(tone.scene, CAMERA)
    candidate = CurveCandidate(
        curve=CAMERA, score=1.0, standard_error=0.1, light=light, problem=problem
    )
    tone = replace(tone, candidates=[candidate])
    pipeline = Pipeline(without)
    found = solve(problem, light, CONFIG, 0, pipeline)
    if false_sun:
        sharp = torch.full((1, 3), false_sun)
        amplitudes = replace(found.light.amplitudes, sharp=sharp)
        found = replace(found, light=replace(found.light, amplitudes=amplitudes))
    sky = fit(problem, *no_suns(), CONFIG.iterations)
    taken = with_tested_suns(tone, found, sky, pipeline)
    (choice,) = [each for each in taken.choices if each.choice == "suns"]
    assert choice.chosen == len(taken.light.axes)
    return taken, found, choice


def varnished_ball(light):
    scene, _ = synthetic.ball([(lambda at: at[:, 0] < 9, VARNISHED)], light, CAMERA)
    return scene


def under_the_sky(light):
    """The same light without its suns."""
    return replace(light, amplitudes=replace(light.amplitudes, sharp=torch.full((1, 3), 0.0)))


def test_highlights_prove_a_sun_that_casts_no_shadow():
    light = synthetic.sun_and_uneven_sky()
    taken, found, _ = proven(varnished_ball(light), light)
    assert taken.light is found.light


def test_a_sun_that_is_not_there_goes():
    light = synthetic.sun_and_uneven_sky()
    scene = varnished_ball(under_the_sky(light))
    taken, found, choice = proven(scene, light, false_sun=0.6)
    assert len(found.light.axes) == 1
    assert choice.chosen == 0, choice.why
    assert len(taken.light.amplitudes.sharp) == 0


@pytest.mark.parametrize("is_there", [True, False])
def test_shadows_tell_of_a_sun_on_what_has_no_highlights(is_there):
    stage = synthetic.boxes_on_a_floor()
    scene = synthetic.scene_of(stage, sun=3.0 if is_there else 0.0, sky=0.5, curve=CAMERA)
    light = synthetic.true_light(3.0, 0.5)
    # floor and boxes are brighter than paint commonly is, and throw much light on each other
    taken, _, choice = proven(scene, light, 0.0 if is_there else 0.6, without=["level"])
    assert len(taken.light.axes) == is_there, choice.why


# leads by views and across shadows of suns in captures, and whether these are true
SEEN = [
    (2.5, -4.4, True), (3.4, -5.8, True), (1.5, -5.7, True), (-1.5, 10.0, True),
    (-6.6, 2.5, False), (-5.2, 3.9, False), (-3.8, 0.0, False), (0.0, -4.0, False),
]  # fmt: skip


@pytest.mark.parametrize(("views", "shadows", "is_true"), SEEN)
def test_shadows_do_not_refuse_a_sun_that_views_speak_for(views, shadows, is_true):
    assert (together(views, shadows) > -0.5) == is_true


def test_a_lead_counts_against_its_error_and_a_tenth_of_a_code():
    rng = np.random.default_rng(4)
    views = np.repeat(np.arange(20), 50)
    plain = (10 / 255) ** 2 * rng.chisquare(3, 1000) / 3
    # half a code less everywhere: certain, but for the tenth
    rich = plain * 0.95**2
    lead = lead_in_errors(HeldOutTest.of(plain, rich, (views,)), ranking.CODE_ERROR)
    assert lead == pytest.approx(0.05 * 255 * np.sqrt(plain.mean()) / 0.1, rel=0.1)
    # noise that gains nothing
    other = (10 / 255) ** 2 * rng.chisquare(3, 1000) / 3
    assert abs(lead_in_errors(HeldOutTest.of(plain, other, (views,)), ranking.CODE_ERROR)) < 2.5
    # from the same errors twice nothing follows
    assert lead_in_errors(HeldOutTest.of(plain, plain, (views,)), ranking.CODE_ERROR) == 0
