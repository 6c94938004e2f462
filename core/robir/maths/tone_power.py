# SPDX-License-Identifier: Apache-2.0
"""A tone curve followed by a power of the display code, display = F(linear)^p.

p below 1 lifts the darks. Blender shows it by the curve's own view transform and "Gamma" 1 / p.
"""

from __future__ import annotations

from torch import Tensor

from robir.errors import ConfigError
from robir.maths.tone_curve import AbstractToneCurve

DISPLAY_POWER = "display_power"  # name of p among the parameters in tone_curve.json


class PoweredToneCurve(AbstractToneCurve):
    """A tone curve `base` and a `power`, above 0, of its display code."""

    def __init__(self, base: AbstractToneCurve, power: float) -> None:
        """Fix both; raises ConfigError for a power that is not positive."""
        if not power > 0.0:
            raise ConfigError(
                f"tone curve {base.name}: {DISPLAY_POWER} is {power:g}; give a number above 0"
            )
        self.base, self.power = base, float(power)
        self.name, self.mixes_channels = base.name, base.mixes_channels
        self.blender_view_transform = base.blender_view_transform
        self.blender_gamma = 1.0 / self.power

    @property
    def parameters(self) -> dict[str, float]:
        """Those of the base, and the power."""
        return self.base.parameters | {DISPLAY_POWER: self.power}

    @property
    def is_clipping(self) -> bool:
        """As the base: a power keeps white where it is."""
        return self.base.is_clipping

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        # The floor keeps the gradient of the power finite at black.
        return self.base.display_from_linear(rgb_linear).clamp_min(1e-9).pow(self.power)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        return self.base.linear_from_display(rgb_display.clamp(0.0, 1.0).pow(1.0 / self.power))


def powered(curve: AbstractToneCurve, power: float) -> AbstractToneCurve:
    """The curve followed by a power; the curve itself where that is 1."""
    return curve if power == 1.0 else PoweredToneCurve(curve, power)
