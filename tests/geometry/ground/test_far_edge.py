# SPDX-License-Identifier: Apache-2.0
"""The height of a ground, found from outlines of its far edge against closed form."""

from __future__ import annotations

import numpy as np
import pytest

from robir.geometry.ground.plane import OutlineRays, level

EDGE = 0.9
ROUNDING = 0.012
HEIGHT = 0.02
UP = np.array([0.0, 0.0, 1.0])


def tangents(
    count: int, rng: np.random.Generator, lowest: float = 8.0, highest: float = 65.0
) -> OutlineRays:
    """Rays that graze the far edge of a disc, rounded like a torus, seen from random heights."""
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    slope = np.radians(rng.uniform(lowest, highest, count))
    radial = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    aside = np.cross(UP, radial)
    # the normal of the tangent plane, and a direction within it that leads away from the camera
    outward = np.sin(slope)[:, None] * radial + np.cos(slope)[:, None] * UP
    ahead = np.cos(slope)[:, None] * radial - np.sin(slope)[:, None] * UP
    directions = ahead + rng.uniform(-0.3, 0.3, (count, 1)) * aside
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    touched = (EDGE - ROUNDING) * radial + (HEIGHT - ROUNDING) * UP + ROUNDING * outward
    return OutlineRays(touched - 3.0 * directions, directions, outward)


def with_strays(rays: OutlineRays, count: int, rng: np.random.Generator) -> OutlineRays:
    """The rays and others, through anything."""
    directions = rng.normal(size=(count, 3)) - 1.5 * UP
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    outward = np.cross(directions, rng.normal(size=(count, 3)))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    origins = rng.uniform(-0.8, 0.8, (count, 3)) - 3.0 * directions
    return OutlineRays(
        np.concatenate([rays.origins, origins]),
        np.concatenate([rays.directions, directions]),
        np.concatenate([rays.outward, outward]),
    )


@pytest.mark.parametrize("guess", [-0.006, 0.0, 0.006])
def test_a_guess_is_raised_to_the_height_of_a_rounded_edge(guess: float) -> None:
    rng = np.random.default_rng(1)
    rays = with_strays(tangents(1200, rng), 800, rng)
    middle = np.array([0.05, -0.03, HEIGHT + guess])
    rise = level(rays, np.arange(300), middle, UP, 0.009)
    assert rise == pytest.approx(-guess, abs=4e-4)


def test_a_plane_far_from_any_edge_stays() -> None:
    rays = tangents(1200, np.random.default_rng(3))
    assert level(rays, np.arange(300), np.array([0.0, 0.0, HEIGHT + 0.2]), UP, 0.009) == 0.0
