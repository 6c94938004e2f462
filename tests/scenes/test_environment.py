# SPDX-License-Identifier: Apache-2.0
"""Lat-long maps: frame, solid angles, irradiance and the sun's spot, against closed forms."""

import numpy as np
import pytest

from blender_scenes import environment as maps


@pytest.mark.parametrize(
    ("row", "column", "axis"),
    [
        (32, 64, [1, 0, 0]),
        (32, 32, [0, 1, 0]),
        (32, 96, [0, -1, 0]),
        (0, 10, [0, 0, 1]),
        (63, 10, [0, 0, -1]),
    ],
)
def test_frame_has_plus_x_in_the_middle_and_plus_y_left_of_it(
    row: int, column: int, axis: list[int]
) -> None:
    assert maps.map_directions(64)[row, column] @ axis > np.cos(np.radians(3.0))


def test_constant_map_gives_pi() -> None:
    for normal in ([0.0, 0.0, 1.0], [0.6, 0.0, 0.8]):
        np.testing.assert_allclose(
            maps.irradiance(np.ones((128, 256, 3)), np.array(normal)), np.pi, rtol=1e-3
        )


def test_sun_spot_finds_a_planted_sun_and_its_irradiance() -> None:
    sun = np.array([-0.5, 0.6, 0.0])
    sun[2] = np.sqrt(1.0 - sun @ sun)
    sky = np.full((256, 512, 3), 0.2)
    disc = maps.map_directions(256) @ sun > np.cos(np.radians(2.0))
    sky[disc] = [800.0, 700.0, 500.0]
    direction, energy = maps.sun_spot(sky)
    assert np.degrees(np.arccos(direction @ sun)) < 0.2
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(np.radians(2.0)))
    np.testing.assert_allclose(energy, solid_angle * np.array([800.0, 700.0, 500.0]), rtol=0.05)


def test_clipped_sun_is_raised_to_its_share_and_the_sky_left_alone() -> None:
    sun = np.array([0.6, 0.0, 0.8])
    sky = np.full((256, 512, 3), 0.2)
    disc = maps.map_directions(256) @ sun > np.cos(np.radians(1.0))
    sky[disc] = 100.0
    raised = maps.with_sun_share(sky, 0.75)
    total = maps.irradiance(raised, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(
        0.25 * total, maps.irradiance(np.where(disc[..., None], 0.0, sky), maps.UP), rtol=1e-6
    )
    assert (raised[~disc] == 0.2).all()
    np.testing.assert_array_equal(maps.with_sun_share(raised, 0.5), raised)
