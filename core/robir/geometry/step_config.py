# SPDX-License-Identifier: Apache-2.0
"""Settings of the steps that stand directly in this room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class HullConfig:
    """The visual hull.

    Attributes:
        clearance: Height above the table, unit frame, from which something belongs to the object,
            where masks were guessed.
    """

    clearance: Annotated[float, Within(0, 0.5)] = 0.015


@dataclass(frozen=True, slots=True, kw_only=True)
class RaySamplerConfig:
    """Which pixels the fit learns from.

    Attributes:
        ring: Width of the band around the mask whose pixels teach the field what is empty.
    """

    ring: Annotated[int, Within(1, 256, "pixels")] = 4
