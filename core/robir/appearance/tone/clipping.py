# SPDX-License-Identifier: Apache-2.0
"""What white tells of the tone curve, before any fit.

A curve that clips piles pixels up at code 255; one that rolls off does not.
"""

from __future__ import annotations

from dataclasses import dataclass

from robir.appearance.tone.config import ClippingConfig
from robir.transport.observe import Observations


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingEvidence:
    """What the histogram says about white.

    Attributes:
        clipped_share: Observations with a channel at code 255.
        bright_share: Observations with their brightest channel nearly white.
        config: From when on these tell something.
    """

    clipped_share: float
    bright_share: float
    config: ClippingConfig

    @property
    def verdict(self) -> bool | None:
        """True for a clipping curve, False for one that rolls off, None if white does not tell."""
        config, clipped, bright = self.config, self.clipped_share, self.bright_share
        if clipped > max(config.clipped_share, config.spike_ratio * bright):
            return True
        if bright > max(config.bright_share, clipped / config.rolled_ratio):
            return False
        if clipped > max(config.few_clipped, config.lone_ratio * bright):
            return True
        return None


def clipping_evidence(observations: Observations, config: ClippingConfig) -> ClippingEvidence:
    """Shares of clipped and of nearly white observations."""
    valid = observations.weight > 0
    brightest = observations.display.max(2)
    clipped = observations.clipped.any(2)
    total = max(1, int(valid.sum()))
    return ClippingEvidence(
        clipped_share=float((clipped & valid).sum() / total),
        bright_share=float(((brightest >= config.bright_code) & ~clipped & valid).sum() / total),
        config=config,
    )
