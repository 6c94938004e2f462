# SPDX-License-Identifier: Apache-2.0
"""Prior of the light as a whole: its hue and its level, each with its error."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class LightPrior:
    """Of the mean irradiance that sky and suns send to the samples that take part."""

    # (3,) of its logarithm, less the mean over the channels; None if not known
    hue: Tensor | None = None
    hue_error: float = 1.0  # one standard deviation of each channel of that
    level: float | None = None  # mean over the channels of its logarithm; None if not known
    level_error: float = 1.0  # one standard deviation of that

    def missing(self, sent: Tensor) -> Tensor:
        """Log factors (3,) that a light is short of this, which sends `sent` (3,), a logarithm."""
        return self._hue_missing(sent) + self._level_missing(sent)

    def squared(self, sent: Tensor) -> Tensor:
        """Squared deviations of such a light from this, added up."""
        hue = (self._hue_missing(sent) ** 2).sum() / self.hue_error**2
        return hue + (self._level_missing(sent) / self.level_error) ** 2

    def _hue_missing(self, sent: Tensor) -> Tensor:
        if self.hue is None:
            return torch.zeros_like(sent)
        return self.hue - (sent - sent.mean())

    def _level_missing(self, sent: Tensor) -> Tensor:
        if self.level is None:
            return torch.zeros(())
        return self.level - sent.mean()


NO_PRIOR = LightPrior()
