# SPDX-License-Identifier: Apache-2.0
"""Curves that cannot have made the photographs, whatever was in front of the camera.

A curve that mixes channels does not reach every display colour: AgX draws saturated colours
towards grey. Photographs that hold what it cannot show did not go through it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import Observations

# by how much a colour may miss what a curve reaches: compression shifts colours (codes)
_TOLERANCE = 5.0
_MOST_BEYOND = 1e-3  # share of observations that may lie farther beyond
_NUM_ASKED = 20000  # observations that are asked


def share_beyond(curve: AbstractToneCurve, observations: Observations) -> float:
    """Share of the unclipped observations, 0..1, whose colour no light gives under a curve."""
    if not curve.mixes_channels:
        return 0.0
    shown = (observations.weight > 0) & ~observations.clipped.any(2)
    codes = observations.display[shown]
    codes = codes[:: max(1, len(codes) // _NUM_ASKED)]
    display = torch.from_numpy(codes.astype(np.float32) / 255)
    reached = curve.display_from_linear(curve.linear_from_display(display))
    missed = 255 * (reached - display).abs().amax(1)
    return float((missed > _TOLERANCE).float().mean()) if len(codes) else 0.0


def unable(curves: Iterable[AbstractToneCurve], observations: Observations) -> dict[str, float]:
    """The curves that cannot have made the photographs: their `share_beyond` by name."""
    shares = {curve.name: share_beyond(curve, observations) for curve in curves}
    return {name: share for name, share in shares.items() if share > _MOST_BEYOND}
