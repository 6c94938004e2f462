# SPDX-License-Identifier: Apache-2.0
"""Photographs of unlike exposure are told from gloss, and brought to one exposure."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.photometry.comparison import find_falloff
from robir.appearance.photometry.exposure import (
    NO_FALLOFF,
    ExposureModel,
    Falloff,
    Gains,
    comparable,
)
from robir.appearance.photometry.gains import _least_squares, real_share, solve_gains
from robir.appearance.photometry.statistics import diffuse_radiance, linear_observations
from robir.maths.tone import curve_from_name
from robir.maths.vectors import fibonacci_sphere
from robir.transport.observe import Observations

VIEWS, POINTS = 24, 900


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def photographed(
    linear: np.ndarray, family: str, weight: np.ndarray, off_axis: np.ndarray | None = None
) -> Observations:
    """Observations (P, V) of radiance (P, V, 3) as 8-bit photographs hold it."""
    shown = curve_from_name(family).display_from_linear(torch.from_numpy(linear.astype(np.float32)))
    display = np.rint(255 * shown.clamp(0, 1).numpy()).astype(np.uint8)
    return Observations(
        display=display,
        weight=weight.astype(np.float32),
        clipped=display == 255,
        off_axis=np.zeros(weight.shape, np.uint8) if off_axis is None else off_axis,
        positions=np.zeros((linear.shape[1], 3), np.float32),
        views=tuple(f"view{number}" for number in range(linear.shape[1])),
    )


@pytest.fixture
def glossy(rng):
    """A plain with a sheen under a dome of cameras, and matte things of all orientations on it.

    Three quarters of the points lie on the plain; its sheen is a function of the camera's height.
    """
    cameras = fibonacci_sphere(2 * VIEWS).numpy()
    cameras = cameras[cameras[:, 2] > 0]
    normals = fibonacci_sphere(2 * POINTS).numpy()
    normals = normals[normals[:, 2] > 0][rng.permutation(POINTS)]
    on_plain = rng.random(POINTS) < 0.75
    normals[on_plain] = [0, 0, 1]
    weight = (normals @ cameras.T).clip(0)
    albedo = rng.uniform(0.1, 0.5, (POINTS, 3))
    sheen = 1 + 0.6 * on_plain[:, None] * (1 - cameras[:, 2]) ** 2
    noise = np.exp(0.02 * rng.standard_normal((POINTS, VIEWS)))
    linear = albedo[:, None] * (sheen * noise)[..., None]
    return linear, weight, normals.astype(np.float32)


def gains_of(seen: Observations, family: str, normals: np.ndarray) -> np.ndarray:
    """Log gains (V, 3) under a curve."""
    log, kept = comparable(seen, curve_from_name(family))
    return solve_gains(log, normals[kept])


def falloff_of(seen: Observations, normals: np.ndarray) -> Falloff:
    """Falloff under a plain curve."""
    log, kept = comparable(seen, curve_from_name("standard"))
    return find_falloff(log, normals[kept], seen.off_axis[kept])


def share_of(seen: Observations, normals: np.ndarray, falloff: Falloff) -> float:
    """How much of the gains is exposure under a plain curve, their falloff undone."""
    log, kept = comparable(seen, curve_from_name("standard"))
    log = log - falloff.log(seen.off_axis[kept])[..., None]
    return real_share(log, normals[kept])


def jitter(rng, steps: float, hue: float) -> np.ndarray:
    """Log gains (V, 3) of mean 0."""
    gains = steps * rng.standard_normal((VIEWS, 1)) + hue * rng.standard_normal((VIEWS, 3))
    return np.log(2) * (gains - gains.mean(0))


@pytest.mark.parametrize("family", ["standard", "filmic", "agx"])
def test_gains_are_found_whatever_the_sheen_of_the_ground(glossy, rng, family):
    linear, weight, normals = glossy
    true = jitter(rng, 0.3, 0.08)
    seen = photographed(linear * np.exp(true), family, weight)
    assert share_of(seen, normals, NO_FALLOFF) > 0.8
    gains = gains_of(seen, family, normals)
    # of 0.3 steps, hundredths are left; the sheen alone amounts to 0.6
    assert np.abs(gains - true).max() / np.log(2) < 0.08


def test_gloss_alone_is_no_exposure(glossy):
    linear, weight, normals = glossy
    # sheen of 0.6 steps feigns gains; what is left of them is a few hundredths
    seen = photographed(linear, "filmic", weight)
    feigned = share_of(seen, normals, NO_FALLOFF) * gains_of(seen, "filmic", normals)
    assert np.sqrt((feigned**2).mean()) / np.log(2) < 0.05


def test_a_polished_thing_is_no_exposure(rng):
    """Mirrors differ between photographs by more than exposures ever do, each point its own way."""
    normals = fibonacci_sphere(POINTS).numpy().astype(np.float32)
    linear = np.exp(rng.standard_normal((POINTS, VIEWS, 1)) - 2) * np.ones(3)
    seen = photographed(linear, "standard", np.ones((POINTS, VIEWS)))
    assert share_of(seen, normals, NO_FALLOFF) < 0.2


def test_highlights_of_one_photograph_are_not_its_exposure(rng):
    """A third of the points of one photograph lie in a highlight that trebles them.

    Trusting all of them would leave a gain of .08.
    """
    normals = fibonacci_sphere(POINTS).numpy().astype(np.float32)
    linear = rng.uniform(0.05, 0.3, (POINTS, 1, 3)) * np.ones((1, VIEWS, 1))
    linear[:, 8] *= np.where(rng.random((POINTS, 1)) < 0.3, 3.0, 1.0)
    seen = photographed(linear, "standard", np.ones((POINTS, VIEWS)))
    gains = gains_of(seen, "standard", normals)
    assert abs(gains[8]).max() < 0.03


def test_two_photographs_of_few_points_have_a_closed_form():
    """Of n points d apart under a prior of weight q, each gain is n d / (2 (n + q)), opposite."""
    for count, prior in ((2, 3.0), (40, 3.0), (5, 0.1)):
        values = np.repeat(np.linspace(-1, 1, count)[:, None, None] + [[[0.8], [0.0]]], 3, 2)
        gains, points = _least_squares(values, np.ones((count, 2)), prior)
        expected = 0.8 * count / (2 * (count + prior))
        assert gains == pytest.approx(expected * np.array([[1.0] * 3, [-1.0] * 3]))
        assert points == pytest.approx(values.mean(1))


def test_what_one_exposure_clips_another_shows():
    """A wall at 0.8, photographed one step over and one step under: the bound gives way."""
    linear = np.full((1, 3, 3), 0.8) * np.array([2.0, 0.5, 0.5])[None, :, None]
    seen = photographed(linear, "standard", np.ones((1, 3)))
    assert seen.clipped[0, 0].all()
    gains = Gains({"view0": np.full(3, 2.0), "view1": np.full(3, 0.5), "view2": np.full(3, 0.5)})
    up = np.array([[0, 0, 1]], np.float32)
    evened = linear_observations(seen, curve_from_name("standard"), gains, up)
    assert evened.numpy() == pytest.approx(0.8, rel=0.01)
    assert diffuse_radiance(seen, evened).linear.numpy() == pytest.approx(0.8, rel=0.01)


def walk(rng) -> tuple[np.ndarray, np.ndarray]:
    """Codes (P, V) of where things appear when the camera does not aim at their middle, and s."""
    place = rng.uniform(-0.35, 0.35, (POINTS, 1, 2)) + rng.uniform(-0.2, 0.2, (1, VIEWS, 2))
    codes = np.rint(255 * (place**2).sum(2)).astype(np.uint8)
    return codes, codes / 255


@pytest.mark.parametrize(("family", "law"), [("standard", "exponential"), ("filmic", "cos4")])
def test_a_known_falloff_is_found_among_gloss_and_exposures(glossy, rng, family, law):
    linear, weight, normals = glossy
    codes, square = walk(rng)
    dimmed = np.exp(-0.7 * square) if law == "exponential" else (1 + 0.35 * square) ** -2.0
    true = jitter(rng, 0.3, 0.05)
    seen = photographed(linear * dimmed[..., None] * np.exp(true), family, weight, codes)
    falloff = falloff_of(seen, normals)
    assert falloff.strength > 0
    assert share_of(seen, normals, falloff) > 0.6
    exposures = ExposureModel(observations=seen, normals=normals, gain_share=1.0, has_falloff=True)
    gains = exposures.gains(curve_from_name(family))
    # steps of what is seen: s reaches 0.4
    reach = np.quantile(square[weight > 0.5], 0.98)
    wrong = -gains.falloff.strength * reach - np.log(dimmed[square <= reach].min())
    assert abs(wrong) / np.log(2) < 0.03
    found = np.array([gains.plain()["steps"][name] for name in seen.views]) * np.log(2)
    assert np.abs(found - true).max() / np.log(2) < 0.08
    evened = linear_observations(seen, curve_from_name(family), gains, normals).numpy()
    clear = (weight > 0.5) & (seen.display.min(2) > 10) & ~seen.clipped.any(2)
    assert np.median(np.abs(np.log(evened / linear))[clear]) < 0.03


def test_no_falloff_is_taken_where_there_is_none(glossy, rng):
    """Nor with unlike exposures, nor of corners that are brighter."""
    linear, weight, normals = glossy
    codes, square = walk(rng)
    assert not falloff_of(photographed(linear, "filmic", weight, codes), normals).strength
    unlike = photographed(linear * np.exp(jitter(rng, 0.3, 0.05)), "standard", weight, codes)
    assert not falloff_of(unlike, normals).strength
    bright = photographed(linear * np.exp(0.5 * square)[..., None], "standard", weight, codes)
    assert not falloff_of(bright, normals).strength
