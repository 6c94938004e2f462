# SPDX-License-Identifier: Apache-2.0
"""What one kind of evidence says of the light."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

BY_ALL, BY_KNOWN_ALBEDO = "all", "known paint"
"""Names of the last rows: all evidence together, and the albedo that the user knows, if any."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One row of the report's table of evidence.

    Attributes:
        of: "level", mean over the channels of the log mean irradiance; or "hue", log of its red
            over its blue.
        by: The evidence.
        value: Log units.
        deviation: One standard deviation.
    """

    of: str
    by: str
    value: float
    deviation: float

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)
