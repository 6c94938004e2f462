# SPDX-License-Identifier: Apache-2.0
"""A ball half of metal, half of paint, under an uneven sky that is not fully known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.evidence.config import EvidenceConfig
from robir.appearance.evidence.mirrored_sky import sky_by_metal
from robir.appearance.light.lobes import Amplitudes, soft_lobes
from robir.appearance.light.problem import make_problem
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.reflections import Reflections, view_rays
from robir.maths.tone import curve_from_name

BASE, ROUGHNESS = np.array([0.8, 0.6, 0.3], np.float32), 0.3
METAL = synthetic.Material(BASE, ROUGHNESS, 1.0)
PAINT = synthetic.Material(np.array([0.3, 0.3, 0.3], np.float32), 0.6, 0.0)


def is_metal(at):
    return at[:, 1] > -0.4


@pytest.fixture(scope="module")
def ball():
    """The problem, its light, and its gloss."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(is_metal, METAL), (lambda at: ~is_metal(at), PAINT)]
    problem = make_problem(synthetic.ball(halves, light, curve)[0], curve)
    return problem, light, gloss_of(problem, is_metal)


def gloss_of(problem, where):
    """The gloss of a ball that is metal somewhere."""
    position = problem.scene.transport.surfels.position
    count = len(position)
    return Gloss(
        roughness=np.full(count, ROUGHNESS, np.float32),
        metallic=where(position).astype(np.float32),
        metal=np.tile(BASE, (count, 1)),
        metal_reads=None,
        floor=np.zeros((count, 3), np.float32),
        kept=np.ones((count, 1), np.float32),
        has_highlights=False,
        table=(),
        choices=(),
    )


def test_lobes_add_up_to_the_sky(ball):
    problem, light, _ = ball
    transport = problem.scene.transport
    rows = problem.scene.rows[::20]
    rays = view_rays(
        transport.surfels, transport.observations, rows, transport.visibility.directions
    )
    reflections = Reflections(problem, light, rows)
    lobes = reflections.from_lobes(rays, ROUGHNESS, len(light.amplitudes.soft))
    sky = reflections.from_sky(rays, ROUGHNESS)[:, 1]
    # a ball blocks nothing that lies above its own horizon
    np.testing.assert_allclose(lobes @ light.amplitudes.soft, sky, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_metal_tells_what_no_paint_sees(ball, factor):
    problem, light, gloss = ball
    soft = light.amplitudes.soft
    axes, _ = soft_lobes(len(soft))
    behind = axes[:, 1] > 0.6
    wrong = torch.where(behind[:, None], factor * soft, soft)
    supposed = replace(light, amplitudes=Amplitudes(soft=wrong, sharp=light.amplitudes.sharp))
    told = sky_by_metal(problem, supposed, gloss, EvidenceConfig())
    assert told is not None
    off = (told.amplitudes.soft.log() - soft.log()).abs()[behind].mean()
    assert float(off) < 0.3 * abs(np.log(factor))
    assert torch.equal(told.amplitudes.sharp, light.amplitudes.sharp)


def test_irradiance_of_paint_is_kept(ball):
    problem, light, gloss = ball
    tinted = light.tinted(torch.tensor([0.2, 0.0, -0.2]))
    told = sky_by_metal(problem, tinted, gloss, EvidenceConfig())
    assert told is not None
    rows = problem.scene.rows[gloss.is_paint[problem.scene.rows]]
    ratio = told.irradiance(problem, rows) / tinted.irradiance(problem, rows)
    assert float(ratio.log().abs().mean()) < 0.03


def test_little_metal_tells_nothing(ball):
    problem, light, _ = ball
    gloss = gloss_of(problem, lambda at: at[:, 1] > 0.9)
    assert sky_by_metal(problem, light, gloss, EvidenceConfig()) is None
