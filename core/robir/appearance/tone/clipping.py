# SPDX-License-Identifier: Apache-2.0
"""What white tells of the tone curve, before any fit.

A curve that clips piles pixels up at code 255; one that rolls off does not.
"""

from __future__ import annotations

from dataclasses import dataclass

from robir.transport.observe import Observations

CLIPPED_SHARE = 0.004
"""Share of observations at code 255 from which clipping is plain."""

SPIKE_RATIO = 0.75
"""Pixels at 255 for each at 245 to 254 from which they are a spike."""

BRIGHT_SHARE, ROLLED_RATIO = 0.016, 0.5
"""Share of observations at 245 to 254 that rolls off if no more than so many for each lie at 255.
In photographs of three cameras it is .06 to .37; a white plate that just clips comes to .72."""

FEW_CLIPPED = 3e-4
"""Share of observations at code 255 that is no glint any more, if next to none lie just below."""

LONE_RATIO = 10.0
"""How many times those must outnumber the pixels just below."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingEvidence:
    """What the histogram says about white.

    Attributes:
        clipped_share: Observations with a channel at code 255.
        bright_share: Observations with their brightest channel at 245 to 254.
        by_camera: Whether cameras took the photographs: these roll off a little whatever their
            curve, so that this tells nothing.
    """

    clipped_share: float
    bright_share: float
    by_camera: bool = False

    @property
    def verdict(self) -> bool | None:
        """True for a clipping curve, False for one that rolls off, None if white does not tell."""
        if self.clipped_share > max(CLIPPED_SHARE, SPIKE_RATIO * self.bright_share):
            return True
        if not self.by_camera and self.bright_share > max(
            BRIGHT_SHARE, self.clipped_share / ROLLED_RATIO
        ):
            return False
        if self.clipped_share > max(FEW_CLIPPED, LONE_RATIO * self.bright_share):
            return True
        return None


def clipping_evidence(observations: Observations, *, by_camera: bool = False) -> ClippingEvidence:
    """Shares of clipped and of nearly white observations."""
    valid = observations.weight > 0
    brightest = observations.display.max(2)
    clipped = observations.clipped.any(2)
    total = max(1, int(valid.sum()))
    return ClippingEvidence(
        clipped_share=float((clipped & valid).sum() / total),
        bright_share=float(((brightest >= 245) & ~clipped & valid).sum() / total),
        by_camera=by_camera,
    )
