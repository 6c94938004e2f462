# SPDX-License-Identifier: Apache-2.0
"""Visibility bits, view factors and lobe ratios against closed forms and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from transport.shapes import mesh_of, patch

from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.vectors import fibonacci_sphere
from robir.transport.surfels import Surfels
from robir.transport.visibility import lobe_directions, lobe_transfer, trace_visibility

OFFSET = 1e-4
FLOOR = patch((-4, -4, 0), (8, 0, 0), (0, 8, 0))
UP = np.float32([[0, 0, 1]])


def directions(count: int) -> np.ndarray:
    return fibonacci_sphere(count).numpy().astype(np.float32)


def traced(parts, position, normal, count):
    """Visibility of samples on a mesh made of parts."""
    mesh = mesh_of(*parts)
    surfels = Surfels(position=np.float32(position), normal=np.float32(normal), spacing=0.1)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    return trace_visibility(mesh, tracer, surfels, directions(count), OFFSET)


def test_an_open_plane_under_a_uniform_sky_receives_pi():
    visibility = traced([FLOOR], [[0, 0, 0]], UP, 512)
    cosine = np.clip(visibility.directions[:, 2], 0, None)
    irradiance = (visibility.unpacked() * cosine).sum(1) * 4 * np.pi / 512
    np.testing.assert_allclose(irradiance, np.pi, rtol=0.01)
    # Nothing is blocked: the visibility ratio of every lobe is 1.
    np.testing.assert_array_equal(visibility.unpacked()[0], visibility.directions[:, 2] > 0)
    assert visibility.bounce.nnz == 0


def test_bits_beside_a_wall_are_those_of_its_outline():
    distance, height, half_width = 0.5, 0.7, 3.0
    wall = patch((distance, -half_width, 0), (0, 0, height), (0, 2 * half_width, 0))
    visibility = traced([FLOOR, wall], [[0, 0, 0]], UP, 1024)
    x, y, z = visibility.directions.astype(float).T
    with np.errstate(divide="ignore", invalid="ignore"):
        rise, aside = OFFSET + distance * z / x, np.abs(distance * y / x)
    blocked = (x > 0) & (rise < height) & (aside < half_width)
    near = (np.abs(rise - height) < 1e-3) | (np.abs(aside - half_width) < 1e-3)
    expected = (z > 0) & ~blocked
    assert blocked[z > 0].mean() > 0.1
    np.testing.assert_array_equal(visibility.unpacked()[0][~near], expected[~near])


@pytest.mark.parametrize("distance", [0.2, 0.5, 1.0])
def test_form_factor_of_a_wall_at_a_right_angle(distance):
    """A facing rectangle a high and b wide on either side, from the foot at distance c.

    F = 2 / (2 pi) (atan(b / c) - c / sqrt(a^2 + c^2) atan(b / sqrt(a^2 + c^2))).
    """
    height, width = 0.8, 1.5
    wall = patch((distance, -width, 0), (0, 0, height), (0, 2 * width, 0))
    slant = np.hypot(height, distance)
    factor = (np.arctan(width / distance) - distance / slant * np.arctan(width / slant)) / np.pi
    # A third sample behind the wall: the bounce must come from the one on the wall.
    position = [[0, 0, 0], [distance, 0, 0.3], [distance + 0.5, 0, 0]]
    visibility = traced([FLOOR, wall], position, [[0, 0, 1], [-1, 0, 0], [0, 0, 1]], 4096)
    row = visibility.bounce[0].toarray()[0]
    np.testing.assert_allclose(row / np.pi, [0, factor, 0], rtol=0.03, atol=1e-9)


def test_form_factor_of_a_disc_overhead():
    """F = r^2 / (r^2 + h^2) from the axis of a disc of radius r at height h."""
    radius, height = 0.6, 0.5
    angle = np.arange(96) * 2 * np.pi / 96
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle + height], axis=1)
    vertices = np.concatenate([[[0, 0, height]], rim])
    faces = np.stack([np.zeros(96), 1 + (np.arange(96) + 1) % 96, 1 + np.arange(96)], 1).astype(int)
    disc = (vertices, faces, np.broadcast_to([0, 0, -1.0], vertices.shape))
    visibility = traced([FLOOR, disc], [[0, 0, 0], [0, 0, height]], [UP[0], -UP[0]], 4096)
    factor = radius**2 / (radius**2 + height**2)
    # The floor fills the whole view of the disc's centre.
    expected = [[0, factor], [1, 0]]
    np.testing.assert_allclose(visibility.bounce.toarray() / np.pi, expected, rtol=0.02, atol=2e-3)


@pytest.mark.parametrize("sharpness", [0.5, 3.0, 30.0, 2000.0])
def test_lobe_directions_have_the_mean_of_the_lobe(sharpness):
    axis = np.float32([2, -1, 2]) / 3
    spread = lobe_directions(axis, sharpness, 4096)
    np.testing.assert_allclose(np.linalg.norm(spread, axis=1), 1, atol=1e-6)
    mean = 1 / np.tanh(sharpness) - 1 / sharpness
    np.testing.assert_allclose(spread.mean(0), mean * axis, atol=1.5e-3)
    # Second moment of the cosine: 1 - 2 mean / s.
    np.testing.assert_allclose(((spread @ axis) ** 2).mean(), 1 - 2 * mean / sharpness, atol=1e-3)


def half_plane(degrees: float) -> EmbreeTracer:
    """Plate above the origin whose edge lies that far past the zenith, towards +x."""
    height, far = 0.1, 200.0
    edge = height * np.tan(np.radians(degrees))
    mesh = mesh_of(patch((-far, -far, height), (far + edge, 0, 0), (0, 2 * far, 0)))
    return EmbreeTracer(mesh.vertices, mesh.faces)


# share of a lobe's energy that passes an edge so many degrees past its axis
RATIOS = {
    (10, 5): 0.395, (10, 10): 0.298, (10, 20): 0.146,
    (30, 5): 0.318, (30, 10): 0.173,
    (100, 5): 0.192,
}  # fmt: skip


@pytest.mark.parametrize(("sharpness", "degrees"), list(RATIOS))
def test_share_of_a_lobe_past_an_edge(sharpness, degrees):
    rays = lobe_directions(UP[0], sharpness, 4000)
    rays = rays[rays[:, 2] > 0]
    origins = np.zeros_like(rays)
    share = 1 - half_plane(degrees).is_blocked(origins, rays).mean()
    assert share == pytest.approx(RATIOS[sharpness, degrees], abs=0.004)


@pytest.mark.parametrize(("sharpness", "degrees"), [(10, 10), (30, 5), (100, 5)])
def test_lobe_transfer_is_the_integral_of_lobe_visibility_and_cosine(sharpness, degrees):
    axis = np.array([0, 0, 1.0])
    normal = np.array([[np.sin(0.5), 0, np.cos(0.5)]])
    polar, azimuth = np.meshgrid(
        (np.arange(1500) + 0.5) * np.pi / 3000, (np.arange(1500) + 0.5) * 2 * np.pi / 1500
    )
    x, z = np.sin(polar) * np.cos(azimuth), np.cos(polar)
    cosine = np.clip(normal[0, 0] * x + normal[0, 2] * z, 0, None)
    free = x > np.tan(np.radians(degrees)) * z
    lobe = np.exp(sharpness * (z - 1)) * np.sin(polar)
    expected = (lobe * free * cosine).sum() / lobe.sum()
    rays = lobe_directions(axis, sharpness, 3000)
    position = np.zeros((1, 3), np.float32)
    result = lobe_transfer(half_plane(degrees), position, np.float32(normal), rays, 0.0)
    assert result[0] == pytest.approx(expected, abs=0.004)
    open_sky = lobe_transfer(None, position, np.float32(normal), rays, 0.0)
    assert open_sky[0] == pytest.approx((lobe * cosine).sum() / lobe.sum(), abs=0.002)


@pytest.mark.parametrize("elevation", [15.0, 40.0, 75.0])
def test_shadows_lie_where_they_do_however_high_rays_start(elevation):
    height, width = 0.3, 0.4
    tangent = np.tan(np.radians(elevation))
    plate = mesh_of(FLOOR, patch((-width, -1, height), (width, 0, 0), (0, 2, 0)))
    tracer = EmbreeTracer(plate.vertices, plate.faces)
    x = np.linspace(-3, 2, 5001)
    position = np.stack([x, 0 * x, 0 * x], axis=1).astype(np.float32)
    sun = np.float32([[1 / np.hypot(1, tangent), 0, tangent / np.hypot(1, tangent)]])
    received = lobe_transfer(tracer, position, np.repeat(UP, len(x), 0), sun, 0.05)
    # the plate's edges, moved away from the sun
    shadow = (x > -width - height / tangent) & (x < -height / tangent)
    assert shadow.sum() > 390
    assert ((received == 0) != shadow).sum() <= 2


def test_a_wall_beside_a_point_blocks_a_sun_however_high_rays_start():
    wall = patch((0.01, -1, 0), (0, 0, 0.5), (0, 2, 0))
    mesh = mesh_of(FLOOR, wall)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    position = np.float32([[0, 0, 0], [0.005, 0, 0], [0.015, 0, 0]])
    sun = np.float32([[0.8, 0, 0.6]])
    received = lobe_transfer(tracer, position, np.repeat(UP, 3, 0), sun, 0.05)
    np.testing.assert_allclose(received, [0, 0, 0.6], atol=1e-6)
