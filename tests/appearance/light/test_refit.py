# SPDX-License-Identifier: Apache-2.0
"""Strengths found anew: what neighbours tell of them, and by which samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import NO_PRIOR
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import refit
from robir.maths.tone import curve_from_name

SUN, SKY = 2.4, 0.12  # irradiance of the sun at normal incidence and amplitude of each soft lobe


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor()


def test_paint_of_another_hue_does_not_brighten_the_sky_before_it(stage):
    """Sides that face away from the sun are yellow, everything else is dark."""
    side = stage.surfels.normal[:, 0] < -0.9
    albedo = np.where(side[:, None], np.float32([0.8, 0.75, 0.1]), np.float32([0.1, 0.12, 0.1]))
    curve = curve_from_name("filmic")
    scene = synthetic.scene_of(replace(stage, albedo=albedo), SUN, SKY, curve)
    problem, true = make_problem(scene, curve), synthetic.true_light(SUN, SKY)
    rows = scene.rows[side[scene.rows]]
    found = refit(problem, true, NO_PRIOR, AppearanceConfig(iterations=240))
    before, after = (light.irradiance(problem, rows).log().mean() for light in (true, found))
    # .07 by neighbours of all hues
    assert float(after - before) == pytest.approx(0, abs=0.03)
