# SPDX-License-Identifier: Apache-2.0
"""Settings of the mesh that is handed in, from the command line to what its steps find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from geometry.given.test_layout import squares
from geometry.given.test_noise import NOISE, arrays, noisy, sphere

from robir.config import RunConfig, resolve
from robir.geometry.given.config import GivenConfig
from robir.geometry.given.layout import Layout, own_layout
from robir.geometry.given.noise import without_noise


def given_set(*assignments: str) -> GivenConfig:
    """Settings of the mesh as the command line changes them."""
    given = [f"geometry.given.{assignment}" for assignment in assignments]
    return resolve(RunConfig(), None, given).geometry.given


def test_a_setting_of_the_layout_changes_what_is_kept() -> None:
    one = squares((0, 0), (1, 0))
    astray = replace(one, uvs=one.uvs + np.array([0.0015, 0]))
    assert isinstance(own_layout(astray, given_set().layout), str)
    assert isinstance(own_layout(astray, given_set("layout.outside=0.002").layout), Layout)


def test_a_setting_of_the_noise_changes_how_far_vertices_move() -> None:
    solid = sphere(4)
    before, faces = noisy(solid), arrays(solid)[1]
    farthest = []
    for assignments in ((), ("noise.farthest=0.5",)):
        after, _ = without_noise(before, faces, given_set(*assignments).noise)
        farthest.append(np.linalg.norm(after - before, axis=1).max())
    assert farthest[1] < 0.65 * NOISE < farthest[0]
