# SPDX-License-Identifier: Apache-2.0
"""Shadows and highlights together tell the plain curve from one with a shoulder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.blocks import mean_of
from robir.appearance.light import lobes
from robir.appearance.light.problem import blocks_of, make_problem
from robir.appearance.photometry.statistics import Radiance
from robir.appearance.tone.shoulder import PlainLead, mismatch_table
from robir.maths.tone import curve_from_name

SUN, SKY = 3.0, 0.25


def table(mean, noise=0.0, count=400):
    """Errors of blocks about a mean; noise is that of one block."""
    spread = np.random.default_rng(0).standard_normal(count)
    return mean + noise * (spread - spread.mean()), np.ones(count)


@pytest.mark.parametrize(
    ("shadows", "highlights", "noise", "clear"),
    [
        (0.02, None, 0.0, True),
        # what all blocks agree on may still be a common error
        (0.008, None, 0.0, False),
        (-0.02, None, 0.0, False),
        # both errors speak, and either may overrule the other
        (-0.005, 1.0, 0.0, True),
        (0.03, -0.1, 0.0, True),
        (0.02, -0.2, 0.0, False),
        (0.008, 0.2, 0.0, True),
        # the noise of both counts
        (0.03, 0.5, 10.0, False),
    ],
)
def test_the_plain_curve_must_lead_clearly(shadows, highlights, noise, clear):
    pairs = table(0.1), table(0.1 + shadows, 0.1 * noise)
    codes = (table(3.0 / 255), table((3.0 + (highlights or 0)) / 255, noise / 255))
    bright = None if highlights is None else codes
    lead = PlainLead.of(("standard", "filmic"), pairs, bright)
    lead = replace(lead, margin=2.0)
    assert lead.shoulder == "filmic"
    assert lead.shadows.value == pytest.approx(shadows)
    assert lead.highlights is None or lead.highlights.value == pytest.approx(highlights)
    assert lead.is_clear is clear


@pytest.fixture(scope="module")
def problem():
    stage = synthetic.boxes_on_a_floor(1000)
    scene = synthetic.scene_of(stage, SUN, SKY, curve_from_name("filmic"), 700)
    return make_problem(scene, curve_from_name("filmic"))


@dataclass
class Fake:
    """A light that is told."""

    values: torch.Tensor

    def irradiance(self, problem, rows):
        assert len(rows) == len(self.values)
        return self.values


def known(problem, log_irradiance, log_albedo, clipped=None):
    """The problem with given light and albedo of those samples that take part."""
    scene = problem.scene
    linear = torch.full((len(scene.transport.surfels), 3), lobes.MEAN_ALBEDO)
    linear[scene.rows] = (log_irradiance + log_albedo).exp() / np.pi
    top = torch.zeros_like(linear, dtype=torch.bool)
    if clipped is not None:
        top[scene.rows[clipped]] = True
    radiance = Radiance(linear=linear, clipped=top, seen=torch.ones(len(linear), dtype=torch.bool))
    return replace(problem, radiance=radiance), Fake(log_irradiance.exp())


def logs(problem, seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(len(problem.scene.rows), 3, generator=generator)


def judged(problem, light):
    blocks = blocks_of(problem.scene)
    return mismatch_table(problem, light, blocks, np.ones(len(blocks)))


def test_mismatch_is_what_albedos_differ_by_over_the_contrast_of_the_light(problem):
    light, albedo = 2 + 0.5 * logs(problem, 0), 0.05 * logs(problem, 1)
    mismatch = mean_of(judged(*known(problem, light, albedo)))
    assert mismatch == pytest.approx(0.1, rel=0.1)
    assert mean_of(judged(*known(problem, light, 0 * albedo))) == pytest.approx(0, abs=1e-3)


def test_clipped_pairs_say_nothing(problem):
    light, albedo = 2 + 0.5 * logs(problem, 0), 0.05 * logs(problem, 1)
    rows = np.arange(len(problem.scene.rows))
    wrong = rows % 5 == 0
    albedo[torch.from_numpy(wrong)] += 3.0
    mismatch = mean_of(judged(*known(problem, light, albedo, rows[wrong])))
    assert mismatch == pytest.approx(0.1, rel=0.15)
    total, weight = judged(*known(problem, light, albedo, rows))
    assert weight.sum() == 0
    assert total.sum() == 0
