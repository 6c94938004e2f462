# SPDX-License-Identifier: Apache-2.0
"""Highlights tell a clipping curve from one that rolls off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.blocks import difference_error, mean_of
from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import Amplitudes
from robir.appearance.light.problem import make_problem
from robir.appearance.tone.highlight_evidence import highlight_tables
from robir.maths.tone import curve_from_name

DARK = synthetic.Material(np.float32([0.05, 0.1, 0.06]), 0.42)
BRIGHT = synthetic.Material(np.float32([0.5, 0.45, 0.4]), 0.61)


def models(name):
    """A ball with a dark and a bright half under the plain curve and under Filmic."""
    light = synthetic.sun_and_uneven_sky()
    dimmed = Amplitudes(soft=0.5 * light.amplitudes.soft, sharp=0.5 * light.amplitudes.sharp)
    light = replace(light, amplitudes=dimmed)
    parts = [(lambda p: p[:, 1] < 0, DARK), (lambda p: p[:, 1] >= 0, BRIGHT)]
    scene, _ = synthetic.ball(parts, light, curve_from_name(name))
    curves = [curve_from_name(each) for each in ("standard", "filmic")]
    return tuple((make_problem(scene, curve), light) for curve in curves)


@pytest.mark.parametrize(("name", "right"), [("standard", 0), ("filmic", 1)])
def test_highlights_are_explained_under_the_true_curve(name, right):
    scene, errors = models(name), []
    # what is one material is left to chance, and one draw of five is an unlucky one
    for seed in range(5):
        tables = highlight_tables(scene, AppearanceConfig(), seed)
        true, false = tables[right], tables[1 - right]
        lead = mean_of(false) - mean_of(true)
        assert 255 * lead > 0.2
        errors.append(lead / difference_error(false, true))
    assert np.median(errors) > 2


def test_without_a_sun_highlights_say_nothing():
    curve, light = curve_from_name("filmic"), synthetic.true_light(1.0, 0.1)
    scene = synthetic.scene_of(synthetic.boxes_on_a_floor(500), 1.0, 0.1, curve)
    sky = replace(light.amplitudes, sharp=light.amplitudes.sharp[:0])
    overcast = replace(light, axes=light.axes[:0], sharpness=light.sharpness[:0], amplitudes=sky)
    models = ((make_problem(scene, curve), overcast),)
    assert highlight_tables(models, AppearanceConfig(), 0) is None
