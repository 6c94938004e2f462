# SPDX-License-Identifier: Apache-2.0
"""The stated error of albedo: variances add, each piece of evidence counts, nothing is certain."""

import numpy as np

from robir.appearance.texture.albedo import LARGEST, distance_to_seen, standard_error


def error(spread=0.0, changed=0.0, count=1e9, distance=0.0):
    causes = (np.float32([v]) for v in (spread, changed, count, distance))
    return float(standard_error(*causes)[0])


def test_what_no_view_is_near_is_unknown():
    assert error(count=0, distance=0.5) == LARGEST
    assert error(count=0, distance=np.inf) == LARGEST
    assert error(count=0) == error(count=1) < LARGEST


def test_distance_is_to_the_nearest_seen_point():
    position = np.float32([[0, 0, 0], [1, 0, 0], [0.03, 0, 0], [1.2, 0, 0]])
    seen = np.array([True, True, False, False])
    np.testing.assert_allclose(distance_to_seen(position, seen), [0, 0, 0.03, np.inf], rtol=1e-6)
    assert error(distance=0.2) == LARGEST
    assert np.isinf(distance_to_seen(position, np.zeros(4, bool))).all()
    assert not distance_to_seen(position, np.ones(4, bool)).any()
