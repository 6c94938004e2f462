# SPDX-License-Identifier: Apache-2.0
"""Tone curves as the published methods use them: linear targets, and light fitted under the curve.

Both compare light, not codes: the photograph's codes are decoded, and the prediction passes the
curve without a cut at white.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from robir.maths.tone import AbstractToneCurve, AcesToneCurve, StandardToneCurve, linear_from_srgb
from robir.maths.tone_formula import aces

# Adam's rate is that of the other parameters; the programs widen this one's steps tenfold.
_STRIDE = 10.0


class AbstractTone(nn.Module, ABC):
    """The tone curve during the fit."""

    @abstractmethod
    def curve(self) -> AbstractToneCurve:
        """The curve as it stands, for radiance from codes and for what is stored."""

    @abstractmethod
    def random_curve(self, generator: torch.Generator) -> AbstractToneCurve:
        """A curve of the family, as indirect light must know them all."""

    @abstractmethod
    def decoded(self, display: Tensor) -> Tensor:
        """Light (..., 3) that the display gives for codes in [0, 1]."""

    @abstractmethod
    def shown(self, radiance: Tensor) -> Tensor:
        """The same light for scene radiance (..., 3), linear; may exceed 1."""

    @property
    @abstractmethod
    def gamma(self) -> Tensor:
        """Scalar of the present curve, ()."""


class AcesTone(AbstractTone):
    """RobIR's: light = g^-0.2 F(e), codes = light^(1 / 2.2), one learnt scalar g (Eq. 6-8)."""

    def __init__(self) -> None:
        """Start at g = 0.5, as the programs."""
        super().__init__()
        self._parameter = nn.Parameter(torch.zeros(()))

    def curve(self) -> AcesToneCurve:
        """See AbstractTone."""
        return AcesToneCurve.from_parameter(_STRIDE * self._parameter)

    def random_curve(self, generator: torch.Generator) -> AcesToneCurve:
        """A curve with g uniform in (0, 1]."""
        return AcesToneCurve(1.0 - 0.999 * torch.rand((), generator=generator))

    def decoded(self, display: Tensor) -> Tensor:
        """See AbstractTone."""
        return display**2.2

    def shown(self, radiance: Tensor) -> Tensor:
        """See AbstractTone; AcesToneCurve is this, cut at white and encoded."""
        return aces(radiance) * self.gamma**-0.2

    @property
    def gamma(self) -> Tensor:
        """See AbstractTone."""
        return self.curve().tone_gamma


class SrgbTone(AbstractTone):
    """InvRender's: light is radiance, codes are sRGB."""

    def curve(self) -> StandardToneCurve:
        """See AbstractTone."""
        return StandardToneCurve()

    def random_curve(self, generator: torch.Generator) -> StandardToneCurve:
        """The only one."""
        del generator
        return StandardToneCurve()

    def decoded(self, display: Tensor) -> Tensor:
        """See AbstractTone."""
        return linear_from_srgb(display)

    def shown(self, radiance: Tensor) -> Tensor:
        """See AbstractTone."""
        return radiance

    @property
    def gamma(self) -> Tensor:
        """One: there is nothing to choose."""
        return torch.ones(())


def make_tone(has_aces: bool) -> AbstractTone:
    """RobIR's curve, or InvRender's."""
    return AcesTone() if has_aces else SrgbTone()


def gamma_of(curve: AbstractToneCurve) -> Tensor:
    """Scalar (), of a curve that `random_curve` made, for the network of indirect light."""
    return curve.tone_gamma if isinstance(curve, AcesToneCurve) else torch.ones(())
