# SPDX-License-Identifier: Apache-2.0
"""Texels at shadow edges take their surroundings' albedo; all others keep their own."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.light import Amplitudes
from robir.appearance.solver import Light
from robir.appearance.texture import Texels, _Reference, _settle_clipped, _settle_edges

SOFT, SUN = 0.5, 2.0
PAINTS = np.float32([[0.6, 0.5, 0.4], [0.1, 0.25, 0.3]])


@pytest.fixture
def shadow():
    """A floor of two paints across whose middle a shadow's edge runs, traced a little off."""
    steps = np.linspace(-0.6, 0.6, 48)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    light = Light(
        axes=np.float32([[0.6, 0, 0.8]]),
        sharpness=np.float32([2000]),
        amplitudes=Amplitudes(soft=torch.zeros(1, 3), sharp=torch.full((1, 3), SUN)),
        loss=0.0,
        history=(),
    )
    facing = 0.8
    true_share = np.clip(0.5 + x / 0.1, 0, 1)
    traced = np.clip(0.5 + (x - 0.03) / 0.1, 0, 1)
    paint = PAINTS[(y > 0).astype(int)]
    exitant = paint * (SOFT + true_share * facing * SUN)[:, None]
    irradiance = SOFT + traced * facing * SUN
    parts = (
        np.full((len(x), 3), SOFT),
        (traced * facing)[:, None],
        light.amplitudes.sharp.numpy(),
    )
    edge = np.abs(x) < 0.12
    return Texels(position=position, normal=normal), light, paint, exitant, irradiance, parts, edge


def test_edges_take_the_paint_around_them_and_certain_texels_are_left_alone(shadow):
    texels, light, paint, exitant, irradiance, parts, edge = shadow
    albedo = exitant / irradiance[:, None]
    reference = _Reference(texels, albedo, ~edge)
    settled = _settle_edges(albedo, exitant, parts, light, texels, edge, reference)
    np.testing.assert_array_equal(settled[~edge], albedo[~edge])
    before = np.abs(np.log(albedo / paint))[edge].mean()
    after = np.abs(np.log(settled / paint))[edge]
    assert before > 0.15
    assert after.mean() < before / 3
    # The shares tried are a tenth apart.
    assert np.quantile(after, 0.95) < 0.16


def test_without_edges_nothing_changes(shadow):
    texels, light, _, exitant, irradiance, parts, edge = shadow
    albedo = exitant / irradiance[:, None]
    reference = _Reference(texels, albedo, ~edge)
    none = np.zeros_like(edge)
    same = _settle_edges(albedo, exitant, parts, light, texels, none, reference)
    np.testing.assert_array_equal(same, albedo)


def test_clipped_channels_rise_to_their_surroundings_and_never_fall(shadow):
    texels, _, paint, _, _, _, _ = shadow
    clipped = np.zeros(paint.shape, bool)
    middle = (np.abs(texels.position[:, 0]) < 0.1) & (texels.position[:, 1] < -0.15)
    clipped[middle, 0] = True
    measured = paint.copy()
    measured[middle] *= 0.7
    brighter = middle & (texels.position[:, 1] < -0.4)
    measured[brighter, 0] = 0.9
    reference = _Reference(texels, paint, ~clipped.any(1))
    settled = _settle_clipped(measured, clipped, reference, texels)
    np.testing.assert_array_equal(settled[~clipped], measured[~clipped])
    np.testing.assert_allclose(settled[middle & ~brighter, 0], PAINTS[0, 0], rtol=1e-6)
    np.testing.assert_array_equal(settled[brighter, 0], measured[brighter, 0])
