# SPDX-License-Identifier: Apache-2.0
"""What is told of a light weighs by its error."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from robir.appearance.light.told import NOTHING_TOLD, Told

SENT = torch.tensor([0.4, 0.1, -0.2])


def test_what_is_missing_brings_the_light_to_what_is_told():
    hue = torch.tensor([0.1, 0.0, -0.1])
    whole = Told(hue=hue, level=1.5, level_error=0.3)
    torch.testing.assert_close(SENT + whole.missing(SENT), hue + 1.5)
    # the level alone keeps the hue, the hue alone the level
    torch.testing.assert_close(SENT + Told(level=1.5).missing(SENT), SENT - SENT.mean() + 1.5)
    torch.testing.assert_close((SENT + Told(hue=hue).missing(SENT)).mean(), SENT.mean())
    torch.testing.assert_close(SENT + NOTHING_TOLD.missing(SENT), SENT)


def test_squares_are_those_of_normal_distributions():
    hue, level = torch.tensor([0.1, 0.0, -0.1]), 0.5
    told = Told(hue=hue, hue_error=0.04, level=level, level_error=0.3)
    apart = (SENT - SENT.mean() - hue).numpy()
    likelihood = norm.logpdf(apart, scale=0.04).sum() + norm.logpdf(0.1, level, 0.3)
    greatest = 3 * norm.logpdf(0, scale=0.04) + norm.logpdf(0, scale=0.3)
    assert float(told.squared(SENT)) == pytest.approx(-2 * (likelihood - greatest), rel=1e-5)
    assert float(NOTHING_TOLD.squared(SENT)) == 0
    assert np.isfinite(float(Told(level=0.5).squared(SENT)))
