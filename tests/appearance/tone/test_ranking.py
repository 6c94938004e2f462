# SPDX-License-Identifier: Apache-2.0
"""How far apart two explanations put albedo, against albedos made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.light.problem import make_problem
from robir.appearance.tone.ranking import CurveCandidate, albedo_apart
from robir.maths.tone import curve_from_name

SUN, SKY = 2.4, 0.12


@pytest.fixture(scope="module")
def candidate():
    stage, curve = synthetic.boxes_on_a_floor(), curve_from_name("filmic")
    problem = make_problem(synthetic.scene_of(stage, SUN, SKY, curve), curve)
    light = synthetic.true_light(SUN, SKY)
    return CurveCandidate(curve=curve, score=3.0, standard_error=0.0, light=light, problem=problem)


def under(candidate, factor):
    """The same scene with all samples' radiance so many times (S, 3) as bright."""
    radiance = candidate.problem.radiance
    other = replace(radiance, linear=radiance.linear * factor)
    return replace(candidate, problem=replace(candidate.problem, radiance=other))


def test_a_tint_of_all_albedo_is_no_other_explanation(candidate):
    tinted = under(candidate, synthetic.COOL.astype(np.float32) * 0.5)
    assert albedo_apart(candidate, tinted) > 60


def test_shadows_taken_for_paint_are(candidate):
    problem = candidate.problem
    rng = np.random.default_rng(0)
    factor = rng.uniform(0.4, 1.0, (len(problem.radiance.seen), 3)).astype(np.float32)
    rows = problem.scene.rows
    irradiance = candidate.light.irradiance(problem, rows).numpy()
    radiance = problem.radiance
    albedo = np.pi * radiance.linear[rows].numpy() / irradiance
    whole = ~radiance.clipped[rows].numpy().any(1)
    first, second = albedo[whole].clip(max=1), (albedo * factor[rows])[whole].clip(max=1)
    # the best factor of each channel, by least squares
    scaled = second * np.stack(
        [
            np.linalg.lstsq(own[:, None], wanted, rcond=None)[0][0]
            for wanted, own in zip(first.T, second.T, strict=True)
        ]
    )
    expected = -10 * np.log10(((first - scaled) ** 2).mean())
    assert albedo_apart(candidate, under(candidate, factor)) == pytest.approx(expected, abs=0.2)
    assert expected < 30
