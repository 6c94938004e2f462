# SPDX-License-Identifier: Apache-2.0
"""Settings of single steps: `--set` reaches them, and what the steps find follows them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.blocks import block_numbers
from robir.appearance.config import AppearanceConfig
from robir.appearance.light.shade import irradiance_doubt
from robir.appearance.photometry.gains import real_share
from robir.appearance.proof import fitted_views
from robir.config import RunConfig, resolve
from robir.errors import ConfigError
from robir.maths.vectors import fibonacci_sphere
from robir.settings import toml_from_settings


def changed(*assignments: str) -> AppearanceConfig:
    """The stage's settings with some of `--set`."""
    given = [f"appearance.{assignment}" for assignment in assignments]
    return resolve(RunConfig(), None, given).appearance


def test_settings_of_steps_are_written_with_their_ranges():
    text = toml_from_settings(changed("light.sun.smoothing=0.1"))
    assert "[light.sun]" in text and "smoothing = 0.1  # 0.001 .. 0.3 radians" in text
    assert "side = 0.2  # 0.01 .. 2 unit frame" in text


@pytest.mark.parametrize(
    "wrong",
    [
        "photometry.own_light.sheen_degree=0",
        "light.problem.pair_reaches=[0.1]",
        "evidence.level.num_factors=2",
        "proof.every=1",
    ],
)
def test_what_a_step_cannot_work_with_is_refused(wrong):
    with pytest.raises(ConfigError, match="appearance." + wrong.partition("=")[0]):
        changed(wrong)


def test_photometry():
    normals = fibonacci_sphere(400).numpy().astype(np.float32)
    rng = np.random.default_rng(0)
    gains = 0.3 * rng.standard_normal((1, 12, 1))
    log = rng.uniform(-2, -1, (400, 1, 3)) + gains + 0.01 * rng.standard_normal((400, 12, 3))
    assert real_share(log, normals, changed().photometry) > 0.7
    assert real_share(log, normals, changed("photometry.gains.least_points=500").photometry) == 0


def test_light():
    irradiance = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    before, after = (
        irradiance_doubt(irradiance, config.light.shade)
        for config in (changed(), changed("light.shade.light_error=0.1"))
    )
    torch.testing.assert_close(after, 2 * before)


def test_steps_in_no_room():
    position = np.random.default_rng(0).uniform(0.01, 0.99, (500, 3)).astype(np.float32)
    counts = [
        block_numbers(position, changed(f"blocks.side={side}").blocks).max() + 1
        for side in (0.5, 1.0)
    ]
    assert counts == [8, 1]
    assert (~fitted_views(24, changed("proof.every=4").proof)).sum() == 6
