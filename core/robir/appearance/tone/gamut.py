# SPDX-License-Identifier: Apache-2.0
"""Curves that cannot have made the photographs, whatever was in front of the camera.

A curve that mixes channels does not reach every display colour: AgX draws saturated colours
towards grey. Photographs that hold what it cannot show did not go through it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from robir.appearance.tone.config import GamutConfig
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import Observations


def share_beyond(
    curve: AbstractToneCurve, observations: Observations, config: GamutConfig
) -> float:
    """Share of the observations whose colour no light gives under a curve.

    Args:
        curve: The tone curve.
        observations: What photographs show; clipped codes, which may stand for anything, aside.
        config: How far it may lie beyond, and how many are asked.

    Returns:
        0..1.
    """
    if not curve.mixes_channels:
        return 0.0
    shown = (observations.weight > 0) & ~observations.clipped.any(2)
    codes = observations.display[shown]
    codes = codes[:: max(1, len(codes) // config.num_asked)]
    display = torch.from_numpy(codes.astype(np.float32) / 255)
    reached = curve.display_from_linear(curve.linear_from_display(display))
    missed = 255 * (reached - display).abs().amax(1)
    return float((missed > config.tolerance).float().mean()) if len(codes) else 0.0


def unable(
    curves: Iterable[AbstractToneCurve], observations: Observations, config: GamutConfig
) -> dict[str, float]:
    """The curves that cannot have made the photographs: their `share_beyond` by name."""
    shares = {curve.name: share_beyond(curve, observations, config) for curve in curves}
    return {name: share for name, share in shares.items() if share > config.most_beyond}
