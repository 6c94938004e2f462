# SPDX-License-Identifier: Apache-2.0
"""A floor of known paint, seen again through the photographs around a camera."""

from __future__ import annotations

import numpy as np
import pytest
from transport.shapes import looking_at, mesh_of, patch, photograph

from robir.evaluation.surfaces import NEAREST, nearness, warped_views
from robir.geometry.mesh.tracer import EmbreeTracer

OFFSET = 1e-3


def floor(height: float = 0.0):
    return mesh_of(patch((-1, -1, height), (2, 0, 0), (0, 2, 0), 4))


def photographs(mesh, shade, places):
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    return [
        photograph(tracer, shade, looking_at(place, size=96), str(k))
        for k, place in enumerate(places)
    ]


def ring(count: int, height: float = 2.5):
    angles = 2 * np.pi * np.arange(count) / count
    return [(0.9 * np.cos(a), 0.9 * np.sin(a), height) for a in angles]


def painted(points, _face, _view_dir):
    x, y = points[:, 0], points[:, 1]
    return np.stack([0.45 + 0.35 * x, 0.5 + 0.3 * y, 0.5 - 0.2 * x], axis=1)


def test_the_right_surface_shows_the_photograph_again():
    mesh = floor()
    views = photographs(mesh, painted, ring(7))
    (wanted,) = photographs(mesh, painted, [(0.2, -0.1, 2.4)])
    (shown,) = warped_views(mesh, views, [wanted.camera], OFFSET)
    for picture in (shown.nearest, shown.mean):
        known = picture[..., 3] > 0
        assert known[wanted.mask > 0].mean() > 0.9
        off = picture[known, :3].astype(int) - wanted.image_display[known]
        assert np.abs(off).max() <= 3
    assert not shown.nearest[wanted.mask == 0].any()


def test_a_surface_in_the_wrong_place_does_not():
    """A plane that lies h too low is seen shifted by up to h tan(angle): the stripes blur."""
    stripes = 24.0

    def shade(points, _face, _view_dir):
        return np.repeat(0.5 + 0.4 * np.sin(stripes * points[:, :1]), 3, axis=1)

    views = photographs(floor(), shade, ring(8))
    (wanted,) = photographs(floor(), shade, [(0.0, 0.0, 2.4)])
    errors = []
    for height in (0.0, -0.15):
        (shown,) = warped_views(floor(height), views, [wanted.camera], OFFSET)
        known = (shown.mean[..., 3] > 0) & (wanted.mask > 0)
        off = shown.mean[known, :3].astype(float) - wanted.image_display[known]
        errors.append(np.sqrt((off**2).mean()))
    assert errors[0] < 8 and errors[1] > 5 * errors[0]


def test_each_photograph_counts_once_in_the_mean_and_by_its_angle_in_the_blend():
    """Photographs of one grey each: what comes out tells how much each counted."""
    mesh, places = floor(), [(0.1 * k, 0.0, 3.0) for k in range(NEAREST + 2)]
    greys = np.linspace(0.2, 0.9, len(places))
    views = [
        photographs(mesh, lambda p, f, v, g=grey: np.full((len(p), 3), g), [place])[0]
        for grey, place in zip(greys, places, strict=True)
    ]
    camera = looking_at((0.0, 0.0, 3.0), size=33)
    (shown,) = warped_views(mesh, views, [camera], OFFSET)
    middle = shown.mean[16, 16, 0] / 255
    assert middle == pytest.approx(np.rint(255 * greys).mean() / 255, abs=0.003)
    # from where the first photograph was taken it alone is seen, towards the corners too
    inner = shown.nearest[4:-4, 4:-4]
    assert inner[..., 3].all()
    assert np.abs(inner[..., 0] / 255 - greys[0]).max() < 0.01


def test_weights_are_those_of_the_unstructured_lumigraph():
    angle = np.float32([[0.1, 0.2, 0.3, 0.4, 0.5, 0.9], [0.2, np.inf, np.inf, np.inf, np.inf, 0.4]])
    found = nearness(angle)
    raw = (1 - angle[0, :NEAREST] / 0.5) / angle[0, :NEAREST]
    assert found[0, :NEAREST] == pytest.approx(raw / raw.sum(), rel=1e-5)
    assert not found[0, NEAREST:].any()
    pair = (1 - np.array([0.2, 0.4]) / np.pi) / np.array([0.2, 0.4])
    assert found[1, [0, 5]] == pytest.approx(pair / pair.sum(), rel=1e-5)
    assert not found[1, 1:5].any()
    assert not nearness(np.full((2, 6), np.inf, np.float32)).any()
    assert nearness(np.float32([[0.3]])) == pytest.approx(1.0)
