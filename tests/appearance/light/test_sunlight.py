# SPDX-License-Identifier: Apache-2.0
"""Where samples stand to a sun, on boxes on a floor."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.light.sunlight import _GRAZING_COSINE, Sunlight
from robir.maths.tone import curve_from_name


@pytest.fixture(scope="module")
def problem():
    scene = synthetic.scene_of(synthetic.boxes_on_a_floor(), 2.4, 0.12, curve_from_name("standard"))
    return SimpleNamespace(scene=scene)


def test_what_grazes_a_sun_or_lies_at_its_shadows_edge_is_not_sure(problem):
    axis = np.float32([[0.6, 0.08, 0.79]]) / np.linalg.norm([0.6, 0.08, 0.79])
    sure = Sunlight.of(problem, axis).is_certain().numpy()
    surfels, rows = problem.scene.transport.surfels, problem.scene.rows
    cosine = (surfels.normal[rows] @ axis.T)[:, 0]
    assert not sure[np.abs(cosine) < _GRAZING_COSINE].any()
    wide = problem.scene.sharp_transfer(axis, np.float32([250.0]), rows)[:, 0].numpy()
    floor = surfels.normal[rows][:, 2] > 0.9
    whole, none = wide > 0.99 * cosine, wide < 1e-6
    np.testing.assert_array_equal(sure[floor], (whole | none)[floor])
    assert 0.05 < 1 - sure[floor].mean() < 0.4
    # walls turned well away from it get nothing, whatever their normals' errors
    assert sure[cosine < -_GRAZING_COSINE].all()
    (pairs,) = Sunlight.of(problem, axis).across_shadows()
    share = wide / np.maximum(cosine, 1e-3)
    assert share[pairs.first].max() < 0.5 < share[pairs.second].min()


def test_where_hardly_anything_is_sure_all_counts(problem):
    axes = np.float32([[0.0, 0.1, 0.995], [0.995, 0.1, 0.0], [0.995, -0.1, 0.0]])
    sunlight = Sunlight.of(problem, axes)
    assert (np.abs(sunlight.cosine) < _GRAZING_COSINE).any(1).mean() > 0.5
    assert bool(sunlight.is_certain().all())
