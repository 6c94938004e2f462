# SPDX-License-Identifier: Apache-2.0
"""Texels of a checkered floor whose squares are two pixels wide."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from transport.shapes import looking_at, mesh_of, patch

from robir.appearance.photometry.exposure import Gains
from robir.appearance.photometry.statistics import linear_observations
from robir.appearance.texture.sharpen import sharpened
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.tone import curve_from_name
from robir.transport.observe import observe

SQUARE = 0.12
FINE = 8
"""Rays along either side of a photograph's pixel."""


def radiance_at(points: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) of the floor."""
    odd = np.floor(points[:, :2] / SQUARE).sum(1) % 2 == 1
    return np.where(odd[:, None], [0.1, 0.2, 0.4], [0.6, 0.5, 0.3])


def photograph(camera, curve, name: str) -> View:
    """What a sensor records: the mean over each pixel's square, encoded."""
    fine = camera.resized(FINE * camera.width, FINE * camera.height)
    origins, directions = fine.rays(fine.pixel_centres())
    points = origins - directions * (origins[:, 2:] / directions[:, 2:])
    shape = (camera.height, FINE, camera.width, FINE, 3)
    mean = radiance_at(points).reshape(shape).mean(axis=(1, 3))
    shown = curve.display_from_linear(torch.from_numpy(mean.astype(np.float32))).numpy()
    full = np.full(mean.shape[:2], 255, np.uint8)
    return View(
        name=name,
        image_display=np.rint(255 * shown).astype(np.uint8),
        mask=full,
        camera=camera,
        split="train",
    )


@pytest.fixture(scope="module")
def floor():
    """Texels, what sixteen photographs show of them, and the photographs."""
    mesh = mesh_of(patch((-3, -3, 0), (6, 0, 0), (0, 6, 0)))
    rng = np.random.default_rng(5)
    places = np.stack([*rng.uniform(-0.8, 0.8, (2, 16)), rng.uniform(2.0, 2.4, 16)], axis=1)
    curve = curve_from_name("standard")
    views = tuple(
        photograph(looking_at(place, size=48), curve, str(k)) for k, place in enumerate(places)
    )
    steps = np.linspace(-0.5, 0.5, 120)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    seen = observe(EmbreeTracer(mesh.vertices, mesh.faces), position, normal, views, 1e-4)
    linear = linear_observations(seen, curve, Gains({}), normal).numpy()
    share = (seen.weight > 0) / (seen.weight > 0).sum(1, keepdims=True)
    return position, linear, share.astype(np.float32), seen.weight, views


def test_blur_of_the_pixels_is_undone(floor):
    position, linear, share, cosine, views = floor
    truth = radiance_at(position)
    read = (linear * share[..., None]).sum(1)
    sharp = sharpened(read, (linear, share, cosine), position, views)
    before, after = (np.sqrt(((value - truth) ** 2).mean()) for value in (read, sharp))
    assert after < 0.86 * before


def test_even_radiance_stays_as_it_is(floor):
    position, linear, share, cosine, views = floor
    even = np.full_like(linear, 0.3)
    sharp = sharpened(even[:, 0], (even, share, cosine), position, views)
    assert np.abs(sharp - 0.3).max() < 1e-5


def test_what_no_reading_counts_for_is_left_alone(floor):
    position, linear, share, cosine, views = floor
    unread = np.arange(len(position)) % 7 == 0
    share = np.where(unread[:, None], 0, share)
    read = (linear * share[..., None]).sum(1).clip(1e-3)
    sharp = sharpened(read, (linear, share, cosine), position, views)
    assert np.allclose(sharp[unread], 1e-3)
    assert not np.allclose(sharp[~unread], read[~unread], rtol=0.05)
