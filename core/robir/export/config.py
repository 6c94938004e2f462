# SPDX-License-Identifier: Apache-2.0
"""Settings of the export stage."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportConfig:
    """What is rendered for the report; the asset itself has no settings here.

    Attributes:
        renders: Whether Blender is asked for `scene.blend`, re-renders and a relit picture.
        render_views: Most held-out views that are rendered again in Cycles, far from each other.
        render_samples: Cycles samples a pixel, denoised; pictures of 16 are 42 dB from those of 64.
        render_max_side: Longer side of the rendered pictures, pixels.
    """

    renders: bool = True
    render_views: int = 8
    render_samples: int = 16
    render_max_side: int = 400

    def __post_init__(self) -> None:
        """Refuse values the stage cannot work with."""
        lowest = {"render_views": 1, "render_samples": 1, "render_max_side": 16}
        for name, least in lowest.items():
            if getattr(self, name) < least:
                raise ConfigError(
                    f"export.{name} is {getattr(self, name)}; it must be at least {least}"
                )
