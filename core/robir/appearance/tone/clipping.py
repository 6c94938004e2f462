# SPDX-License-Identifier: Apache-2.0
"""What white tells of the tone curve, before any fit.

A curve that clips piles pixels up at code 255; one that rolls off does not.
"""

from __future__ import annotations

from dataclasses import dataclass

from robir.transport.observe import Observations

_BRIGHT_CODE = 245  # codes from here to 254 are nearly white
_CLIPPED_SHARE = 0.004  # share of observations at code 255 from which clipping is plain
_SPIKE_RATIO = 0.75  # pixels at 255 for each that is nearly white from which they are a spike
_BRIGHT_SHARE = 0.016  # share of observations nearly white that rolls off if few lie at 255
# so many at 255 for each that is nearly white are few. In photographs of three cameras it is 0.06
# to 0.37; a white plate that just clips comes to 0.72.
_ROLLED_RATIO = 0.5
# share of observations at code 255 that is no glint any more, if next to none are nearly white
_FEW_CLIPPED = 3e-4
_LONE_RATIO = 10.0  # how many times those must outnumber the nearly white ones


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingEvidence:
    """What the histogram says about white."""

    clipped_share: float  # observations with a channel at code 255
    bright_share: float  # observations with their brightest channel nearly white

    @property
    def verdict(self) -> bool | None:
        """True for a clipping curve, False for one that rolls off, None if white does not tell."""
        clipped, bright = self.clipped_share, self.bright_share
        if clipped > max(_CLIPPED_SHARE, _SPIKE_RATIO * bright):
            return True
        if bright > max(_BRIGHT_SHARE, clipped / _ROLLED_RATIO):
            return False
        if clipped > max(_FEW_CLIPPED, _LONE_RATIO * bright):
            return True
        return None


def clipping_evidence(observations: Observations) -> ClippingEvidence:
    """Shares of clipped and of nearly white observations."""
    valid = observations.weight > 0
    brightest = observations.display.max(2)
    clipped = observations.clipped.any(2)
    total = max(1, int(valid.sum()))
    return ClippingEvidence(
        clipped_share=float((clipped & valid).sum() / total),
        bright_share=float(((brightest >= _BRIGHT_CODE) & ~clipped & valid).sum() / total),
    )
