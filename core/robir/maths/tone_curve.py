# SPDX-License-Identifier: Apache-2.0
"""What every tone curve offers, the sRGB transfer function, and planar helpers.

A tone curve takes linear Rec.709 scene radiance to sRGB display codes (0..1, 8-bit code / 255) and
back; tensors are (..., 3). A curve may mix channels. Exposure is no part of it: that is the scale
of the light.

The inverse of a code from `saturation_level` up is a lower bound ("at least this bright"), never
more than MAX_LINEAR. Codes that no non-negative colour reaches give a sensible colour nearby, never
a negative one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor

from robir.errors import ConfigError
from robir.maths.tetrahedral import Planes

DISPLAY_POWER = "display_power"  # name of p among the parameters in tone_curve.json
MAX_LINEAR = 16.0
# The half code below white: anything brighter is written as 255.
SATURATION_LEVEL = 254.5 / 255.0
# Few enough that all intermediate planes stay in the CPU's second-level cache.
_CHUNK = 1 << 15


def srgb_from_linear(linear: Tensor) -> Tensor:
    """Code (sRGB, IEC 61966-2-1) of linear light, 0..1; negative light gives 0."""
    low = 12.92 * linear.clamp_min(0.0)
    high = 1.055 * linear.clamp_min(0.0031308).pow(1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, low, high)


def linear_from_srgb(code: Tensor) -> Tensor:
    """Linear light of an sRGB code (IEC 61966-2-1), 0..1."""
    high = ((code.clamp_min(0.04045) + 0.055) / 1.055).pow(2.4)
    return torch.where(code <= 0.04045, code / 12.92, high)


class AbstractToneCurve(ABC):
    """One family of tone curves with its parameters fixed."""

    name: str  # identifier of the family, as in tone_curve.json
    # name of Blender's view transform that does the same, or None
    blender_view_transform: str | None
    blender_gamma: float = 1.0  # blender's view setting "Gamma" with which it does
    # display code from which a value means "at least this bright"
    saturation_level: ClassVar[float] = SATURATION_LEVEL
    # whether a display channel depends on more than its own linear one
    mixes_channels: bool = False

    @property
    def parameters(self) -> dict[str, float]:
        """Free numbers of the family by name, for tone_curve.json."""
        return {}

    @abstractmethod
    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """Display codes 0..1 of scene radiance, linear Rec.709, at least 0, (..., 3)."""

    @abstractmethod
    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """Scene radiance, linear Rec.709, 0..MAX_LINEAR, of display codes 0..1, (..., 3)."""

    def linear_from_codes(self, codes: Tensor, known: Tensor) -> Tensor:
        """Scene radiance float32, linear Rec.709, of 8-bit display codes (..., 3) uint8.

        Anything where they are not `known` (...) bool.
        """
        if not self.mixes_channels:
            levels = (torch.arange(256) / 255.0)[:, None].expand(-1, 3)
            return self.linear_from_display(levels).float()[codes.long(), torch.arange(3)]
        linear = torch.zeros(codes.shape)
        linear[known] = self.linear_from_display(codes[known].float() / 255.0).float()
        return linear

    def slope(self, rgb_linear: Tensor) -> Tensor:
        """Derivative of each display code by its linear value when exposure changes, (..., 3).

        A noise of s in the code is a noise of s / slope in the radiance. Zero where clipped.
        """
        base = rgb_linear.clamp_min(1e-5)
        up, down = 2.0**0.05, 2.0**-0.05
        rise = self.display_from_linear(base * up) - self.display_from_linear(base * down)
        return rise / (base * (up - down))


def chunked(function: Callable[[Planes], Planes], rows: Tensor) -> Tensor:
    """Apply a planar function to the last axis of a tensor, in pieces that fit the cache."""
    flat = rows.reshape(-1, rows.shape[-1])
    starts = range(0, max(flat.shape[0], 1), _CHUNK)
    pieces = [
        torch.stack(function(flat[start : start + _CHUNK].unbind(-1)), dim=-1) for start in starts
    ]
    return torch.cat(pieces).reshape(*rows.shape[:-1], -1) if rows.numel() else pieces[0]


def each(function: Callable[[Tensor], Tensor], planes: Planes) -> Planes:
    """Apply a function to each plane."""
    return tuple(function(plane) for plane in planes)


class PoweredToneCurve(AbstractToneCurve):
    """A tone curve F and a power p of its display code, F(linear)^p; below 1 it lifts the darks."""

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
