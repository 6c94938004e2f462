# SPDX-License-Identifier: Apache-2.0
"""Settings of the capture stage (standard library only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robir.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureConfig:
    """How photographs are taken in.

    Attributes:
        max_side: Longer side, in pixels, of what is kept of a photograph about the object, at
            least 16; what is larger is averaged down to it, what is smaller stays as it is.
        held_out_sector: Degrees about the object, seen from above, of which no photograph takes
            part: those held out then lie outside what was seen, not between it. 0 for none.
        adjust_cameras: Whether given cameras are moved where points that stand out in the
            photographs meet better for it.
        outside: What becomes of photographs and masks that lie outside the capture's folder, by
            the paths its files hold or by links: "refuse" them, or "take" them.
        box: Where the object is, for captures without masks: centre x, y, z and sides x, y, z
            along the axes of the capture's own frame, in its unit; empty to look for it.
        missing: What becomes of poses whose photograph is missing: "refuse" the capture, or "skip"
            them.
        leave_out: Photographs to do without, named as the findings of the check name them.
    """

    max_side: int = 800
    held_out_sector: float = 0.0
    adjust_cameras: bool = True
    outside: Literal["refuse", "take"] = "refuse"
    box: tuple[float, ...] = ()
    missing: Literal["refuse", "skip"] = "refuse"
    leave_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse values that make no sense."""
        if self.max_side < 16:
            raise ConfigError(f"capture.max_side is {self.max_side}; it must be at least 16")
        if not 0 <= self.held_out_sector <= 180:
            raise ConfigError(
                f"capture.held_out_sector is {self.held_out_sector}; it must be 0 to 180 degrees"
            )
        if self.box and (len(self.box) != 6 or min(self.box[3:]) <= 0):
            raise ConfigError(
                f"capture.box is {list(self.box)}; give centre x, y, z and sides x, y, z, the "
                "sides above 0"
            )
