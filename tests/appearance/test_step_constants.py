# SPDX-License-Identifier: Apache-2.0
"""Constants of single steps: what the steps find follows them; settings of before name them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.blocks import block_numbers
from robir.appearance.light.shade import irradiance_doubt
from robir.appearance.photometry.gains import real_share
from robir.appearance.proof import fitted_views
from robir.config import RunConfig, resolve
from robir.constants import changed
from robir.errors import ConfigError
from robir.maths.vectors import fibonacci_sphere


@pytest.mark.parametrize(
    ("setting", "constant"),
    [
        ("photometry.own_light.sheen_degree=3", "photometry.own_light._SHEEN_DEGREE"),
        ("photometry.robust.noise=0.02", "photometry.robust._NOISE"),
        ("light.lobes.shadow=0.25", "light.lobes._SHADOW"),
        ("light.solver.shadow=1.0", "light.solver._SHADOW"),
        ("light.problem.pair_reaches=[0.1, 0.2, 0.3]", "light.problem.PAIR_REACHES"),
        ("evidence.level.num_factors=21", "evidence.level._NUM_FACTORS"),
        ("material.highlights.step=0.02", "material.highlights.STEP"),
        ("texture.texels.step=4", "texture.albedo._STEP"),
        ("texturing.albedo_views=48", "texturing._ALBEDO_VIEWS"),
        ("tone.code_error=0.1", "tone.shoulder.CODE_ERROR"),
        ("proof.every=5", "proof.EVERY"),
    ],
)
def test_a_setting_of_before_is_refused_by_its_constant(setting, constant):
    with pytest.raises(ConfigError, match=f"--constant appearance.{constant}=VALUE"):
        resolve(RunConfig(), None, [f"appearance.{setting}"])


def test_photometry():
    normals = fibonacci_sphere(400).numpy().astype(np.float32)
    rng = np.random.default_rng(0)
    gains = 0.3 * rng.standard_normal((1, 12, 1))
    log = rng.uniform(-2, -1, (400, 1, 3)) + gains + 0.01 * rng.standard_normal((400, 12, 3))
    assert real_share(log, normals) > 0.7
    with changed(["appearance.photometry.gains.LEAST_POINTS=500"]):
        assert real_share(log, normals) == 0


def test_light():
    irradiance = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    before = irradiance_doubt(irradiance)
    with changed(["appearance.light.shade.LIGHT_ERROR=0.1"]):
        torch.testing.assert_close(irradiance_doubt(irradiance), 2 * before)


def test_steps_in_no_room():
    position = np.random.default_rng(0).uniform(0.01, 0.99, (500, 3)).astype(np.float32)
    for side, count in ((0.5, 8), (1.0, 1)):
        with changed([f"appearance.blocks._SIDE={side}"]):
            assert block_numbers(position).max() + 1 == count
    with changed(["appearance.proof.EVERY=4"]):
        assert (~fitted_views(24)).sum() == 6
