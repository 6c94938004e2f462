# SPDX-License-Identifier: Apache-2.0
"""What one kind of evidence says of the light."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

# names of the last rows: all evidence together, and the albedo that the user knows, if any
BY_ALL, BY_KNOWN_ALBEDO = "all", "known paint"


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One row of the report's table of evidence."""

    # "level", mean over the channels of the log mean irradiance; or "hue", log of its red over its
    # blue
    of: str
    by: str  # the evidence
    value: float  # log units
    deviation: float  # one standard deviation

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)
