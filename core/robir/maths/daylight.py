# SPDX-License-Identifier: Apache-2.0
"""Which hues lights have: along the line of daylight, hardly across it.

Sky, sun, lamps and fire differ by how blue or orange they are; green or magenta light is rare
(Judd, MacAdam and Wyszecki 1964, "Spectral distribution of typical daylight as a function of
correlated color temperature"). Figures are of twelve measured environments; suns are what is over
ten times as bright as the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# Greenness of light per blueness: orange light is a little greener, as the line of daylight and of
# black bodies is bent in these logarithms. Of suns against the rest -.22, of parts of skies -.20.
GREEN_OF_BLUE = -0.2


@dataclass(frozen=True, slots=True)
class HueSpread:
    """Standard deviations of a light's hue, log units."""

    blue: float  # of the blueness, log of blue over red
    green: float  # of the greenness beyond daylight's, log of green over the geometric mean of both

    def squared(self, log_colour: Tensor) -> Tensor:
        """Squares of a hue's coordinates in deviations, added up: (...) of colours (..., 3)."""
        blue, green = hue(log_colour)
        return (blue / self.blue) ** 2 + (green / self.green) ** 2

    def precision(self) -> Tensor:
        """Matrix (3, 3) whose quadratic form of a log colour `squared` is."""
        blue, green = hue(torch.eye(3))
        return torch.outer(blue, blue) / self.blue**2 + torch.outer(green, green) / self.green**2

    def absolute(self, log_colour: Tensor) -> Tensor:
        """Their absolute values added up: of many parts of a sky a few are of any hue."""
        blue, green = hue(log_colour)
        return blue.abs() / self.blue + green.abs() / self.green


# Of all that lights a thing. Blueness as cameras balance it: unbalanced it is .27.
WHOLE = HueSpread(blue=0.13, green=0.07)

SUN = HueSpread(blue=0.65, green=0.08)  # of a sun against the sky

PART = HueSpread(blue=0.5, green=0.1)  # of parts of a sky against its mean


def hue(log_colour: Tensor) -> tuple[Tensor, Tensor]:
    """Blueness and greenness (...) of log colours (..., 3), linear Rec.709."""
    red, green, blue = log_colour.unbind(-1)
    blueness = blue - red
    return blueness, green - 0.5 * (red + blue) - GREEN_OF_BLUE * blueness
