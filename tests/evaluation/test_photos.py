# SPDX-License-Identifier: Apache-2.0
"""A re-render at the exposure of the photograph it is compared with."""

import numpy as np
import pytest

from robir.evaluation.photos import exposed
from robir.maths.tone import curve_from_name


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_steps_are_factors_of_two_on_linear_light():
    linear = np.array([[[0.1, 0.2, 0.05]], [[0.3, 0.4, 0.4]]])
    alpha = np.full((2, 1, 1), 77)
    picture = np.dstack([np.rint(255 * srgb(linear)), alpha]).astype(np.uint8)
    again = exposed(picture, [1.0, 0.0, -1.0], curve_from_name("standard"))
    assert again.dtype == np.uint8 and (again[..., 3] == 77).all()
    expected = 255 * srgb(linear * [2.0, 1.0, 0.5])
    assert again[..., :3] == pytest.approx(expected, abs=1.6)
    white = exposed(picture, [3.0, 3.0, 3.0], curve_from_name("standard"))
    assert white[1, 0].tolist() == [255, 255, 255, 77]
