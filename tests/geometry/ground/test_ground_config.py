# SPDX-License-Identifier: Apache-2.0
"""Settings of the ground, from the command line to what its steps find."""

from __future__ import annotations

import numpy as np
import pytest

from robir.config import RunConfig, resolve
from robir.errors import ConfigError
from robir.geometry.ground.backdrop import hues_held
from robir.geometry.ground.config import GroundConfig
from robir.geometry.ground.far_edge import level
from robir.settings import toml_from_settings
from tests.geometry.ground.test_far_edge import HEIGHT, UP, tangents


def ground_set(*assignments: str) -> GroundConfig:
    """Settings of the ground as the command line changes them."""
    given = [f"geometry.ground.{assignment}" for assignment in assignments]
    return resolve(RunConfig(), None, given).geometry.ground


def test_a_setting_of_the_far_edge_changes_the_height_found() -> None:
    rays = tangents(1200, np.random.default_rng(1))
    middle = np.array([0.05, -0.03, HEIGHT + 0.006])
    configs = [
        ground_set(*assignments).far_edge for assignments in ((), ("far_edge.stiffness=100",))
    ]
    as_it_is, stiff = (level(rays, np.arange(300), middle, UP, 0.009, one) for one in configs)
    assert as_it_is == pytest.approx(-0.006, abs=4e-4)
    assert stiff != as_it_is


def test_a_setting_of_the_backdrop_changes_what_is_shaded_ground() -> None:
    ground = np.tile([0.73, 0.67, 0.65], (100, 1))
    brown = np.array([[0.73, 0.6, 0.58]])
    held = [
        bool(hues_held(brown, ground, ground_set(f"backdrop.hue={hue}")))
        for hue in (0.01, 0.08, 0.5)
    ]
    assert held == [False, True, True]


def test_settings_of_the_ground_are_written_with_their_ranges() -> None:
    text = toml_from_settings(RunConfig())
    assert "[geometry.ground.far_edge]\nknots = 36  # 4 .. 400\n" in text
    assert "widest_gap = 60.0  # 0 .. 360 degrees" in text
    with pytest.raises(ConfigError, match="knots is 3"):
        ground_set("far_edge.knots=3")
