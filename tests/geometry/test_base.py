# SPDX-License-Identifier: Apache-2.0
"""The plane that an object stands on, against objects whose foot is known."""

from __future__ import annotations

import numpy as np
import pytest
from geometry.scenes import capture_of, drum

from robir.geometry.base import base_plane, without_cone
from robir.geometry.hull import carve, hull_of
from robir.geometry.rays import reduce_view

FOOT = -0.45


def hull_and_photos(low):
    """Visual hull of an upright drum, and its photographs from an elevation upwards (radians)."""
    capture = capture_of(drum(0.3, FOOT, 0.35), views=20, side=96, low=low)
    photos = [reduce_view(view, 96) for view in capture.train]
    return carve(hull_of(photos), 64), photos


@pytest.fixture(scope="module")
def from_above():
    return hull_and_photos(0.3)


def test_the_plane_is_where_the_object_stands(from_above):
    hull, photos = from_above
    base = base_plane(hull, photos)
    assert np.degrees(np.arccos(base.normal[2])) < 1.5
    assert base.offset == pytest.approx(FOOT, abs=0.02)
    # without its cone the drum is about as large as it is
    drum_share = (0.35 - FOOT) * np.pi * 0.3**2
    whole = float((hull.values < 0).float().mean()) * np.prod(
        np.array(hull.lattice.shape) * hull.lattice.cell
    )
    assert 1 - base.share == pytest.approx(drum_share / whole, abs=0.12)


def test_the_cone_below_goes_and_nothing_else(from_above):
    hull, photos = from_above
    cut = without_cone(hull, photos)
    height = hull.lattice.nodes()[:, 2].numpy()
    before, after = hull.values.numpy() < 0, cut.values.numpy() < 0
    assert before[height < FOOT - 0.08].any()
    assert not after[height < FOOT - 0.06].any()
    assert (before == after)[height > FOOT + 0.03].all()


def test_a_camera_below_leaves_the_hull_alone():
    hull, photos = hull_and_photos(-1.1)
    assert without_cone(hull, photos) is hull
