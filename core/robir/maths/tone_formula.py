# SPDX-License-Identifier: Apache-2.0
"""Tone curves given by formulas: Standard, a camera's, RobIR's ACES, Khronos Neutral.

The two of Blender repeat Blender 4.5, its table interpolation included, so that a curve found here
is the view transform to select there.
"""

from __future__ import annotations

import torch
from torch import Tensor

from robir.errors import ConfigError
from robir.maths import tetrahedral as lattice
from robir.maths.tetrahedral import ColourLattice, Planes
from robir.maths.tone_curve import (
    MAX_LINEAR,
    AbstractToneCurve,
    chunked,
    each,
    linear_from_srgb,
    srgb_from_linear,
)

LOG2_RANGE_KHRONOS = (-9.0, 10.0)


class StandardToneCurve(AbstractToneCurve):
    """Blender's Standard: the sRGB transfer function, clipped at 1."""

    name = "standard"
    blender_view_transform = "Standard"

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        return srgb_from_linear(rgb_linear).clamp(max=1.0)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        return linear_from_srgb(rgb_display.clamp(0.0, 1.0))


class CameraToneCurve(AbstractToneCurve):
    """What a camera does: the mean of 201 measured responses, per channel, clipped at 1.

    display = x^q(x), q(x) = 0.665 - 1.123 x + 1.632 x^2 - 0.896 x^3: our fit, within 0.002, to the
    mean of Grossberg and Nayar, "Modeling the Space of Camera Response Functions", PAMI 2004, in
    the form of Ng, Chang and Lin (CVPR 2007).
    """

    name = "camera"
    blender_view_transform = None
    _exponent = (0.665, -1.123, 1.632, -0.896)
    _num_corrections = 4

    def __init__(self) -> None:
        """Tabulate the response, from which the inverse starts."""
        self._linear = torch.linspace(0.0, 1.0, 4097, dtype=torch.float64) ** 2
        self._display = self._response(self._linear)

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        return self._response(rgb_linear.clamp(0.0, 1.0))

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        code = rgb_display.clamp(0.0, 1.0)
        table, codes = self._linear.to(code), self._display.to(code)
        above = torch.searchsorted(codes, code.contiguous()).clamp(1, len(codes) - 1)
        low, high = codes[above - 1], codes[above]
        share = (code - low) / (high - low).clamp_min(1e-12)
        found = table[above - 1] + share * (table[above] - table[above - 1])
        for _ in range(self._num_corrections):
            # relative to the logarithm, in which the response is nearly straight
            light = found.clamp_min(1e-9)
            off = (code.clamp_min(1e-9) / self._response(light).clamp_min(1e-9)).log()
            found = (light * (off / self._log_slope(light)).clamp(-1.0, 1.0).exp()).clamp(max=1.0)
        return torch.where(code > 0.0, found, torch.zeros_like(found))

    def _response(self, light: Tensor) -> Tensor:
        # the floor keeps the gradient finite at black; it is 0.0003 of an 8-bit code
        light = light.clamp_min(1e-9)
        return light.pow(self._power(light))

    def _power(self, light: Tensor) -> Tensor:
        a, b, c, d = self._exponent
        return a + light * (b + light * (c + light * d))

    def _log_slope(self, light: Tensor) -> Tensor:
        """Derivative of the response's logarithm by that of the light."""
        _, b, c, d = self._exponent
        bent = light * (b + light * (2.0 * c + light * 3.0 * d))
        return (self._power(light) + light.log() * bent).clamp_min(0.05)


def aces(light: Tensor) -> Tensor:
    """The rational fit F(e) of ACES that RobIR takes (Narkowicz), light e >= 0."""
    return light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)


class AcesToneCurve(AbstractToneCurve):
    """RobIR's scene-specific ACES fit, per channel, followed by the power 1 / 2.2.

    display = min(g^-0.2 F(e), 1)^(1/2.2) with F(e) = e (2.51 e + 0.03) / (e (2.43 e + 0.59) + 0.14)
    (Narkowicz 2015) and one scalar g, `tone_gamma`, in (0, 1]: RobIR (NeurIPS 2024) Eq. 6-8. The
    inverse is the positive root. g may require gradients.
    """

    name = "robir_aces"
    blender_view_transform = None

    def __init__(self, tone_gamma: float | Tensor = 0.5) -> None:
        """Fix g; raises ConfigError outside (0, 1]."""
        self.tone_gamma = torch.as_tensor(tone_gamma)
        value = self.parameters["tone_gamma"]
        if not 0.0 < value <= 1.0:
            raise ConfigError(
                f"tone curve robir_aces: tone_gamma is {value:g}; "
                "give a number above 0 and at most 1"
            )

    @classmethod
    def from_parameter(cls, parameter: Tensor) -> AcesToneCurve:
        """Curve of a free real number, g = 1e-4 + (1 - 1e-4) sigmoid(parameter).

        Unlike RobIR's clamp, this keeps a gradient everywhere; 0 gives RobIR's start, g = 0.5.
        """
        return cls(1e-4 + (1.0 - 1e-4) * torch.sigmoid(parameter))

    @property
    def parameters(self) -> dict[str, float]:
        """The scalar g."""
        return {"tone_gamma": float(self.tone_gamma.detach())}

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        mapped = aces(rgb_linear.clamp_min(0.0))
        light = mapped * self._stretch(rgb_linear) ** -1.0
        # The floor keeps the gradient of the power finite at black; it is 0.003 of an 8-bit code.
        return light.clamp(1e-11, 1.0).pow(1.0 / 2.2)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        c = rgb_display.clamp(0.0, 1.0).pow(2.2) * self._stretch(rgb_display)
        half = 0.59 * c - 0.03
        denominator = 2.51 - 2.43 * c
        root = torch.sqrt(half * half + 0.56 * c * denominator)
        # For half < 0 the textbook root cancels; its conjugate form does not.
        plain = (half + root) / (2.0 * denominator)
        conjugate = 0.28 * c / (root - half).clamp_min(1e-12)
        return torch.where(half > 0.0, plain, conjugate).clamp(max=MAX_LINEAR)

    def _stretch(self, like: Tensor) -> Tensor:
        return self.tone_gamma.to(like) ** 0.2


class KhronosNeutralToneCurve(AbstractToneCurve):
    """Blender's Khronos PBR Neutral: the formula at 57^3 nodes, interpolated as Blender does.

    With x = min(rgb), o = x - 6.25 x^2 for x < 0.08 else 0.04, and p = max(rgb) - o, a peak p from
    0.76 on is compressed to q = 1 - 0.24^2 / (p - 0.52), and the colour is mixed towards q by 1 - 1
    / (0.15 (p - q) + 1) (Khronos PBR Neutral Tone Mapper specification, 2024). The inverse corrects
    the closed form by evaluating it; its darkest value 2^-9 stands for black.
    """

    name = "khronos_pbr_neutral"
    blender_view_transform = "Khronos PBR Neutral"
    mixes_channels = True
    _num_corrections = 3
    _nodes = 57

    def __init__(self) -> None:
        """Evaluate the formula at the nodes."""
        low, high = LOG2_RANGE_KHRONOS
        grid = torch.exp2(torch.linspace(low, high, self._nodes, dtype=torch.float64))
        red, green, blue = torch.meshgrid(grid, grid, grid, indexing="ij")
        light = self._formula((red, green, blue))
        self._lattice = ColourLattice.from_nodes(torch.stack(light, dim=-1).float())

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        table = self._lattice.like(rgb_linear)
        light = chunked(lambda rgb: self._interpolated(table, rgb), rgb_linear)
        return srgb_from_linear(light).clamp(max=1.0)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        table = self._lattice.like(rgb_display)

        def invert(display: Planes) -> Planes:
            wanted = self._formula_inverse(each(linear_from_srgb, display))
            found = wanted
            for _ in range(self._num_corrections):
                reached = self._formula_inverse(self._interpolated(table, found))
                moved = tuple(x + w - r for x, w, r in zip(found, wanted, reached, strict=True))
                found = each(lambda x: x.clamp(2.0 ** LOG2_RANGE_KHRONOS[0], MAX_LINEAR), moved)
            return found

        return chunked(invert, rgb_display.clamp(0.0, 1.0))

    def _interpolated(self, table: ColourLattice, rgb: Planes) -> Planes:
        low, high = LOG2_RANGE_KHRONOS
        scale = (self._nodes - 1) / (high - low)
        return lattice.interpolate(
            table, each(lambda x: (torch.log2(x.clamp_min(2.0**low)) - low) * scale, rgb)
        )

    @staticmethod
    def _formula(rgb: Planes) -> Planes:
        red, green, blue = rgb
        least = torch.minimum(torch.minimum(red, green), blue)
        offset = torch.where(least < 0.08, least - 6.25 * least * least, 0.04)
        peak = torch.maximum(torch.maximum(red, green), blue) - offset
        over = peak.clamp_min(0.76)
        compressed = 1.0 - 0.24 * 0.24 / (over - 0.52)
        scale = torch.where(peak > 0.76, compressed / over, 1.0)
        white = 1.0 - 1.0 / (0.15 * (over - compressed) + 1.0)
        return each(lambda x: (x - offset) * scale * (1.0 - white) + white * compressed, rgb)

    @staticmethod
    def _formula_inverse(light: Planes) -> Planes:
        red, green, blue = light
        peak = torch.maximum(torch.maximum(red, green), blue)
        # MAX_LINEAR gives 1 - 0.0576 / 15.44 at most; beyond, the formula has a pole.
        compressed = peak.clamp(0.76, 1.0 - 0.24 * 0.24 / (MAX_LINEAR + 1.0))
        over = 0.24 * 0.24 / (1.0 - compressed) + 0.52
        # The mixture with white cannot exceed the least channel: near white, where the peak hangs
        # on a fraction of a code, saturation tells it better.
        least = torch.minimum(torch.minimum(red, green), blue).clamp_min(0.0)
        share = (least / compressed).clamp(max=0.99)
        over = torch.minimum(over, (compressed + share / (0.15 * (1.0 - share))).clamp_min(0.76))
        compressed = 1.0 - 0.24 * 0.24 / (over - 0.52)
        white = 1.0 - 1.0 / (0.15 * (over - compressed) + 1.0)
        light = each(lambda x: torch.minimum(x, torch.where(peak > 0.76, compressed, peak)), light)
        scale = over / (compressed * (1.0 - white))
        # Blender's table starts at 2^-9: anything darker is seen, and subtracted, as that.
        floor = 6.25 * 2.0 ** (2.0 * LOG2_RANGE_KHRONOS[0])
        rest = each(lambda x: ((x - white * compressed) * scale).clamp_min(floor), light)
        least = torch.minimum(torch.minimum(rest[0], rest[1]), rest[2])
        dark = torch.sqrt(least / 6.25) - least
        offset = torch.where(least < 0.04, dark, 0.04)
        return each(lambda x: x + offset, rest)
