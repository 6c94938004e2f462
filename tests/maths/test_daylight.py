# SPDX-License-Identifier: Apache-2.0
"""Hues of light against daylight of the CIE."""

import numpy as np
import pytest
import torch

from robir.maths.daylight import PART, SUN, WHOLE, HueSpread, hue

# IEC 61966-2-1
REC709_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)


def daylight(kelvin: float) -> torch.Tensor:
    """Log Rec.709 of CIE illuminant D: chromaticities by Judd's equations."""
    t = 1e3 / kelvin
    if kelvin <= 7000:
        x = -4.6070 * t**3 + 2.9678 * t**2 + 0.09911 * t + 0.244063
    else:
        x = -2.0064 * t**3 + 1.9018 * t**2 + 0.24748 * t + 0.237040
    y = -3.0 * x * x + 2.87 * x - 0.275
    return torch.from_numpy(np.log(REC709_FROM_XYZ @ [x / y, 1.0, (1 - x - y) / y]))


@pytest.mark.parametrize("kelvin", [4500, 5000, 6500, 8000, 12000])
def test_daylight_is_hardly_off_its_line(kelvin):
    blueness, greenness = hue(daylight(kelvin))
    assert abs(float(greenness)) < SUN.green
    assert float(blueness) * (kelvin - 6500) >= 0
    assert float(SUN.squared(daylight(kelvin))) < 3


def test_green_and_magenta_light_is_far_off_it():
    for colour in ([1.0, 1.35, 1.0], [1.0, 0.75, 1.0]):
        assert float(SUN.squared(torch.log(torch.tensor(colour)))) > 9


def test_how_bright_a_light_is_says_nothing_of_its_hue():
    colours = torch.log(torch.tensor([[0.2, 0.5, 0.9], [0.7, 0.6, 0.1]]))
    for spread in (WHOLE, SUN, PART):
        torch.testing.assert_close(spread.squared(colours + 1.7), spread.squared(colours))
        torch.testing.assert_close(spread.absolute(colours - 2.1), spread.absolute(colours))
        form = torch.einsum("nc,cd,nd->n", colours, spread.precision(), colours)
        torch.testing.assert_close(form, spread.squared(colours), rtol=1e-4, atol=1e-5)


def test_a_spread_is_that_of_hues_drawn_with_it():
    """Colours whose blueness and greenness are drawn have squares of mean two."""
    rng = np.random.default_rng(0)
    spread = HueSpread(blue=0.4, green=0.1)
    blue, green = rng.normal(size=(2, 20000)) * [[0.4], [0.1]]
    middle = green - 0.2 * blue
    log_colour = torch.from_numpy(np.stack([-blue / 2, middle, blue / 2], axis=1))
    squared = spread.squared(log_colour)
    assert abs(float(squared.mean()) - 2) < 4 * float(squared.std()) / np.sqrt(20000)
    expected = 2 * np.sqrt(2 / np.pi)
    assert float(spread.absolute(log_colour).mean()) == pytest.approx(expected, rel=0.02)
