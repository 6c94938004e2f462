# SPDX-License-Identifier: Apache-2.0
"""Presets: functions that return a whole configuration, and say only what differs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from robir.config import RunConfig

EVERYTHING = 1 << 15  # longer side, pixels, that no photograph has


def draft() -> RunConfig:
    """Minutes on two CPU cores; every default of every room."""
    return RunConfig()


def standard() -> RunConfig:
    """About four times the work of `draft`: finer field, mesh, photographs and textures."""
    base = draft()
    return replace(
        base,
        capture=replace(base.capture, max_side=1600),
        geometry=replace(
            base.geometry,
            image_side=400,
            level_cells=(64, 96, 128, 160),
            level_steps=(300, 400, 600, 600),
            face_budget=20000,
            unwrap_seconds=120.0,
        ),
        transport=replace(
            base.transport, num_surfels=32000, num_directions=1024, observation_side=320
        ),
        appearance=replace(
            base.appearance,
            num_solve_surfels=10000,
            iterations=400,
            shading_size=1024,
            texture_size=4096,
        ),
        export=replace(base.export, render_samples=128, render_max_side=800),
    )


def high() -> RunConfig:
    """For a workstation with CUDA: as fine as the photographs allow."""
    base = standard()
    return replace(
        base,
        capture=replace(base.capture, max_side=EVERYTHING),
        geometry=replace(
            base.geometry,
            image_side=800,
            level_cells=(64, 96, 128, 192, 256),
            level_steps=(400, 600, 1000, 1500, 2000),
            rays=4096,
            face_budget=50000,
            unwrap_seconds=600.0,
        ),
        transport=replace(base.transport, num_surfels=64000, observation_side=640, max_views=96),
        appearance=replace(
            base.appearance,
            num_solve_surfels=20000,
            iterations=800,
            texture_size=8192,
        ),
        export=replace(base.export, render_samples=256, render_max_side=1600),
    )


# presets by the name typed on the command line
PRESETS: dict[str, Callable[[], RunConfig]] = {"draft": draft, "standard": standard, "high": high}
