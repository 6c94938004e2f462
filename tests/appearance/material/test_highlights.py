# SPDX-License-Identifier: Apache-2.0
"""Roughness read from highlights in their place or beside it, and pooled over like patches."""

from __future__ import annotations

import numpy as np
import pytest

from robir.appearance.material.highlights import (
    _READING_ERROR,
    LEVELS,
    UNKNOWN,
    Highlights,
    Readings,
    pooled,
    read,
)

# brightest view under a highlight of each level, display
HEIGHT = np.array([0.55, 0.5, 0.45, 0.36, 0.2, 0.1, 0.04])


def patch_of(errors, plain, brightest, noise=0.0, count=40, views=50):
    """One patch of alike samples.

    Args:
        errors: (L,) display error a view.
        plain: The same without any highlight.
        brightest: What the brightest view shows, display.
        noise: What the brightest of the other views shows.
        count: Samples.
        views: Near views of each.
    """
    sample = np.repeat(np.arange(count), views)
    # one view in ten is at the middle of a highlight
    at = (np.arange(len(sample)) % 10 == 0).astype(float)
    seen = np.repeat((brightest * at)[:, None], len(LEVELS), axis=1)
    total = views * np.ones((count, 1))
    return Highlights(
        error=(total * errors).astype(np.float32),
        plain=(total[:, 0] * plain).astype(np.float32),
        count=np.full(count, views, np.float32),
        sample=sample,
        seen=seen.astype(np.float32),
        predicted=(HEIGHT * at[:, None]).astype(np.float32),
        other=sample,
        noise=np.repeat((noise * at)[:, None], len(LEVELS), axis=1).astype(np.float32),
    )


def patches(highlights):
    """Patches of 40 samples each, one after the other."""
    names = ("error", "plain", "count", "seen", "predicted", "noise")
    joined = {name: np.concatenate([getattr(one, name) for one in highlights]) for name in names}
    numbers = {
        name: np.concatenate(
            [40 * index + getattr(one, name) for index, one in enumerate(highlights)]
        )
        for name in ("sample", "other")
    }
    return Highlights(**joined, **numbers)


def roughness_of(highlights):
    readings = read(highlights, np.zeros(len(highlights.count), np.int64), 1)
    np.testing.assert_array_equal(readings.patch, [0])
    return readings.roughness[0], np.sqrt(readings.variance[0])


IN_PLACE = 0.01 + 0.05 * np.abs(np.log(np.array(LEVELS) / 0.56))


def test_a_highlight_in_its_place_is_read_where_it_fits():
    found, error = roughness_of(patch_of(IN_PLACE, 0.03, 0.2))
    assert found == pytest.approx(0.56, abs=0.03)
    assert _READING_ERROR < error < 0.12


# errors of a polished part whose highlights are predicted beside the true ones
BESIDE = np.array([0.043, 0.05, 0.065, 0.075, 0.07, 0.045, 0.035])


def test_a_bright_highlight_beside_its_place_is_no_rough_one():
    found, error = roughness_of(patch_of(BESIDE, 0.035, 0.45))
    assert found < 0.42
    # it is less sure than one in its place
    assert error > 2 * roughness_of(patch_of(IN_PLACE, 0.03, 0.2))[1]
    # the same errors where nothing bright is seen at all
    assert roughness_of(patch_of(BESIDE, 0.035, 0.02))[0] > 0.8


def test_what_is_not_read_goes_by_what_is_like_it():
    features = np.array([[0.0, 0.0], [6.0, 0.0], [0.2, 0.1], [6.0, 0.3], [0.0, 9.0]])
    readings = Readings(np.array([0, 1]), np.array([0.3, 0.8]), np.full(2, _READING_ERROR**2))
    found = pooled(readings, features)
    np.testing.assert_allclose(found[:4], [0.3, 0.8, 0.3, 0.8], atol=0.03)
    assert found[4] == pytest.approx(0.54, abs=0.03)
    nothing = Readings(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    np.testing.assert_array_equal(pooled(nothing, features), UNKNOWN)
    assert nothing.weighted_mean(UNKNOWN) == UNKNOWN


def test_an_unsure_reading_gives_way_to_sure_ones_beside_it():
    features = np.array([[0.0], [0.1], [0.1]])
    readings = Readings(np.arange(3), np.array([0.4, 0.4, 0.9]), np.array([0.05, 0.05, 0.3]) ** 2)
    assert pooled(readings, features)[2] < 0.45
    assert readings.weighted_mean(UNKNOWN) == pytest.approx(0.4, abs=0.02)
