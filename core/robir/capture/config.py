# SPDX-License-Identifier: Apache-2.0
"""Settings of the capture stage (standard library only)."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureConfig:
    """How photographs are taken in; the defaults are the preset draft.

    Attributes:
        max_side: Longer side of a photograph in pixels, at least 16; larger photographs are
            averaged down to it, smaller ones stay as they are.
        held_out_every: Every how many-th view is kept aside, at least 2; used only if the
            capture brings no test views of its own.
        max_held_out: Number of views kept aside at most, at least 1.
    """

    max_side: int = 400
    held_out_every: int = 8
    max_held_out: int = 8

    def __post_init__(self) -> None:
        """Refuse values that make no sense."""
        for name, least in (("max_side", 16), ("held_out_every", 2), ("max_held_out", 1)):
            value = getattr(self, name)
            if value < least:
                raise ConfigError(f"capture.{name} is {value}; it must be at least {least}")
