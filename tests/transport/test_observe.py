# SPDX-License-Identifier: Apache-2.0
"""What the photographs say about points of a floor below a floating plate."""

from __future__ import annotations

import numpy as np
import pytest
from transport.shapes import looking_at, mesh_of, patch, photograph

from robir.geometry.mesh.tracer import EmbreeTracer
from robir.transport.observe import MIN_COSINE, observe, spread_views

PLATE_HEIGHT, PLATE_HALF = 0.4, 0.25


def painted(points: np.ndarray) -> np.ndarray:
    """Display colour of the floor: bilinear in its place, and white beyond x = 0.6."""
    x, y = points[:, 0], points[:, 1]
    paint = np.stack([0.45 + 0.35 * x, 0.5 + 0.3 * y, 0.5 - 0.2 * x], axis=1)
    paint[x > 0.6] = 1.0
    return paint


@pytest.fixture(scope="module")
def scene():
    """EmbreeTracer, three views, and points of the floor with their normals."""
    floor = patch((-1, -1, 0), (2, 0, 0), (0, 2, 0), 4)
    side = 2 * PLATE_HALF
    plate = patch((-PLATE_HALF, -PLATE_HALF, PLATE_HEIGHT), (side, 0, 0), (0, side, 0))
    mesh = mesh_of(floor, plate)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)

    def shade(points, face, view_dir):
        on_plate = points[:, 2] > PLATE_HEIGHT / 2
        return np.where(on_plate[:, None], [1.0, 0.0, 0.0], painted(points))

    cameras = [looking_at(place, size=128) for place in ((0.3, 0.2, 3), (2, 0, 2), (-1, 2, 1.8))]
    views = tuple(photograph(tracer, shade, camera, str(k)) for k, camera in enumerate(cameras))
    steps = np.linspace(-0.93, 0.93, 120)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    return tracer, views, position, normal


def distance_to_plate(position, camera) -> np.ndarray:
    """How far outside the plate the point's line of sight crosses its plane; negative within."""
    share = PLATE_HEIGHT / camera.position[2]
    crossing = position[:, :2] + share * (camera.position[:2] - position[:, :2])
    return np.abs(crossing).max(1) - PLATE_HALF


def test_visible_points_have_their_paint_and_hidden_ones_no_weight(scene):
    tracer, views, position, normal = scene
    seen = observe(tracer, position, normal, views, 1e-4)
    for index, view in enumerate(views):
        outside = distance_to_plate(position, view.camera)
        valid = seen.weight[:, index] > 0
        assert not valid[outside < 0].any()
        assert valid[outside > 0.08].mean() > 0.9
        smooth = valid & (np.abs(position[:, 0] - 0.6) > 0.08)
        error = seen.display[smooth, index] - 255 * painted(position[smooth])
        assert np.abs(error).max() < 2.5
        # Half a pixel off would be half a code and more.
        assert np.abs(error[position[smooth, 0] < 0.5].mean(0)).max() < 0.1
        towards = view.camera.position - position
        cosine = towards[:, 2] / np.linalg.norm(towards, axis=1)
        np.testing.assert_allclose(seen.weight[valid, index], cosine[valid], rtol=1e-4)
    np.testing.assert_allclose(seen.positions, [view.camera.position for view in views], rtol=1e-6)


def test_no_point_takes_its_colour_across_an_outline(scene):
    """Next to the plate's outline a pixel mixes plate and floor, so it is left out."""
    tracer, views, position, normal = scene
    seen = observe(tracer, position, normal, views, 1e-4)
    # Only the floor's bilinear paint is smooth: any bit of the red plate stands out.
    wrong = np.abs(seen.display / 255 - painted(position)[:, None]).max(2)
    beside = np.abs(position[:, 0] - 0.6) > 0.08
    for index, view in enumerate(views):
        pixel = np.linalg.norm(view.camera.position) / view.camera.fx
        outside = distance_to_plate(position, view.camera)
        near = beside & (outside > 0) & (outside < 1.5 * pixel)
        assert near.sum() > 20
        assert not (wrong[near, index][seen.weight[near, index] > 0] > 2.5 / 255).any()


def test_points_seen_too_flat_or_from_behind_are_not_read(scene):
    tracer, views, position, normal = scene
    below = observe(tracer, position, -normal, views, 1e-4)
    assert not below.weight.any()
    towards = views[0].camera.position - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    side = np.cross(towards, [0, 1, 0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    for cosine in (0.9 * MIN_COSINE, 1.3 * MIN_COSINE):
        tilted = (cosine * towards + np.sqrt(1 - cosine**2) * side).astype(np.float32)
        seen = observe(tracer, position, tilted, views[:1], 1e-3)
        assert seen.weight.any() == (cosine > MIN_COSINE)


def test_spread_views_lie_as_far_apart_as_they_can(scene):
    _, views, _, _ = scene
    crowd = tuple(
        photograph_at
        for angle in (0.0, 0.01, 0.02, 2.1, 2.11, 4.2, 4.21)
        for photograph_at in [_moved(views[0], angle)]
    )
    chosen = spread_views(crowd, 3)
    angles = sorted(float(view.name) for view in chosen)
    assert np.diff(angles).min() > 2
    assert spread_views(crowd, 10) == crowd


def _moved(view, angle):
    camera = looking_at((2 * np.cos(angle), 2 * np.sin(angle), 1))
    return type(view)(
        name=str(angle),
        image_display=view.image_display,
        mask=view.mask,
        camera=camera,
        split="train",
    )
