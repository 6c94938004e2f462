# SPDX-License-Identifier: Apache-2.0
"""Photographs each in a light of its own are told from gloss, and brought to the common light."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.photometry.exposure import ExposureModel, Gains
from robir.appearance.photometry.own_light import _least_squares, have_own_lights, solve_slopes
from robir.maths.tone import curve_from_name
from robir.maths.vectors import fibonacci_sphere
from robir.transport.observe import Observations

VIEWS, POINTS = 24, 900

# so far away that all points of a ball are seen along about one direction
CAMERAS = 50.0 * fibonacci_sphere(VIEWS).numpy().astype(np.float32)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def rotations(rng, count: int, degrees: float) -> np.ndarray:
    """(count, 3, 3) turns about random axes by up to some degrees (Rodrigues)."""
    axis = rng.standard_normal((count, 3))
    x, y, z = (axis / np.linalg.norm(axis, axis=1, keepdims=True)).T
    cross = np.zeros((count, 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross -= cross.transpose(0, 2, 1)
    angle = np.radians(degrees) * rng.random(count)[:, None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def irradiance(normals: np.ndarray, lamp: np.ndarray, share: float) -> np.ndarray:
    """(N,) under a broad lamp and a dim sky, by quadrature over the sphere."""
    directions = fibonacci_sphere(4000).numpy()
    radiance = (1 - share) + share * 6.0 * np.exp(3.0 * (directions @ lamp - 1))
    return ((normals @ directions.T).clip(0) @ radiance) * 4 / 4000


@pytest.fixture
def turned(rng):
    """A matt ball turned by hand under a lamp: radiance (P, V, 3), what each sees, normals."""
    normals = fibonacci_sphere(POINTS).numpy()
    cameras = fibonacci_sphere(VIEWS).numpy()
    weight = (normals @ cameras.T).clip(0)
    lamp = np.array([0.48, 0.6, 0.64])
    light = np.stack(
        [irradiance(normals, turn @ lamp, 0.7) for turn in rotations(rng, VIEWS, 150.0)], axis=1
    )
    albedo = rng.uniform(0.1, 0.5, (POINTS, 1, 3))
    noise = np.exp(0.02 * rng.standard_normal((POINTS, VIEWS, 1)))
    return albedo * (light[..., None] * noise), weight, normals.astype(np.float32), light


def observed(linear: np.ndarray, weight: np.ndarray) -> Observations:
    """8-bit observations (P, V) under the sRGB curve, half as bright."""
    curve = curve_from_name("standard")
    shown = curve.display_from_linear(torch.from_numpy(0.5 * linear.astype(np.float32)))
    display = np.rint(255 * shown.clamp(0, 1).numpy()).astype(np.uint8)
    return Observations(
        display=display,
        weight=weight.astype(np.float32),
        clipped=display == 255,
        off_axis=np.zeros(weight.shape, np.uint8),
        positions=np.zeros((linear.shape[1], 3), np.float32),
        views=tuple(f"view{number}" for number in range(linear.shape[1])),
    )


def logs(linear: np.ndarray, weight: np.ndarray) -> np.ndarray:
    log = np.log(linear)
    log[weight < 0.5] = np.nan
    return log


def test_an_object_turned_by_hand_has_its_own_light_in_each_photograph(turned):
    linear, weight, normals, _ = turned
    assert have_own_lights(logs(linear, weight), normals, (normals, CAMERAS))


def test_exposures_alone_are_no_light(turned, rng):
    linear, weight, normals, light = turned
    still = linear / light[..., None] * np.exp(0.4 * rng.standard_normal((1, VIEWS, 1)))
    assert not have_own_lights(logs(still, weight), normals, (normals, CAMERAS))


@pytest.mark.parametrize(("strength", "exponent"), [(0.3, 30), (3.0, 3), (3.0, 8)])
def test_gloss_under_one_light_is_none(rng, strength, exponent):
    """A shiny ball under a lamp: highlights (Phong) move with the camera, the light does not."""
    normals = fibonacci_sphere(POINTS).numpy()
    cameras = fibonacci_sphere(VIEWS).numpy()
    weight = (normals @ cameras.T).clip(0)
    lamp = np.array([0.48, 0.6, 0.64])
    mirrored = 2 * weight[..., None] * normals[:, None] - cameras
    highlight = strength * (mirrored @ lamp).clip(0) ** exponent
    albedo = rng.uniform(0.1, 0.5, (POINTS, 1, 3))
    linear = albedo * irradiance(normals, lamp, 0.7)[:, None, None] + highlight[..., None]
    linear *= np.exp(0.02 * rng.standard_normal((POINTS, VIEWS, 1)))
    normals = normals.astype(np.float32)
    assert not have_own_lights(logs(linear, weight), normals, (normals, CAMERAS))


def test_the_common_light_is_left(turned):
    """Undone, photographs of a point agree; the light that all share stays in the points."""
    linear, weight, normals, _ = turned
    seen = observed(linear, weight)
    exposures = ExposureModel(
        observations=seen, normals=normals, gain_share=1.0, has_falloff=False, has_own_lights=True
    )
    gains = exposures.gains(curve_from_name("standard"))
    evened = gains.undone(torch.from_numpy(linear), seen, normals).numpy()
    shown = weight > 0.5
    before, after = (
        np.nanmedian(np.nanstd(np.where(shown, np.log(x.mean(2)), np.nan), axis=1))
        for x in (linear, evened)
    )
    assert after < 0.45 * before
    slopes = np.array([gains.slopes[name] for name in seen.views])
    assert np.abs(slopes.mean(0)).max() < 1e-9


def test_slopes_are_those_that_photographs_were_given(rng):
    normals = fibonacci_sphere(POINTS).numpy().astype(np.float32)
    true = 0.4 * rng.standard_normal((VIEWS, 3))
    true -= true.mean(0)
    log = rng.uniform(-2, 0, (POINTS, 1, 3)) + (normals @ true.T)[..., None]
    log = log + 0.2 * rng.standard_normal((1, VIEWS, 3))
    log[rng.random((POINTS, VIEWS)) < 0.5] = np.nan
    log[rng.random((POINTS, VIEWS)) < 0.1] += 1.0  # highlights
    assert np.abs(solve_slopes(log, normals) - true).max() < 0.01


def test_the_points_are_eliminated_rightly(rng):
    """Against a dense system of points and views solved as a whole."""
    points, views = 14, 5
    basis = np.column_stack([np.ones(points), rng.standard_normal((points, 3))])
    values, weight = rng.standard_normal((points, views)), rng.uniform(0.1, 1, (points, views))
    prior = 0.3
    rows, right = [], []
    for p in range(points):
        for v in range(views):
            row = np.zeros(points + 4 * views)
            row[p] = 1.0
            row[points + 4 * v : points + 4 * v + 4] = basis[p]
            rows.append(np.sqrt(weight[p, v]) * row)
            right.append(np.sqrt(weight[p, v]) * values[p, v])
    for k in range(4 * views):
        row = np.zeros(points + 4 * views)
        row[points + k] = np.sqrt(prior)
        rows.append(row)
        right.append(0.0)
    dense = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    own, left = _least_squares(values, basis, weight, prior)
    whole = dense[points:].reshape(views, 4)
    assert own == pytest.approx(whole - whole.mean(0), abs=1e-6)
    error = (weight * (values - basis @ own.T - left[:, None])).sum(1)
    assert error == pytest.approx(0, abs=1e-9)


def test_factors_follow_the_normal():
    gains = Gains({"a": np.array([2.0, 1.0, 1.0])}, slopes={"a": np.array([0.0, 0.0, np.log(4)])})
    normals = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0]], np.float32)
    code = np.zeros(3, np.uint8)
    seen = gains.at(("b", "a"), code, normals, torch.tensor([1, 1, 1]))
    assert seen.numpy() == pytest.approx(np.array([[8, 4, 4], [0.5, 0.25, 0.25], [2, 1, 1]]))
    grid = gains.at(("b", "a"), np.zeros((3, 2), np.uint8), normals[:, None])
    assert grid[:, 1].numpy() == pytest.approx(seen.numpy())
    assert (grid[:, 0] == 1).all()
    assert gains.plain()["slope_steps"]["a"] == pytest.approx([0, 0, 2])
