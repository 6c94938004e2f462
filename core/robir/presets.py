# SPDX-License-Identifier: Apache-2.0
"""Presets: functions that return a whole configuration, and say only what differs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from robir.config import RunConfig


def draft() -> RunConfig:
    """Minutes on two CPU cores; every default of every room."""
    return RunConfig()


def standard() -> RunConfig:
    """Finer pixels, mesh and textures, for photographs of more than 800 pixels."""
    base = draft()
    return replace(
        base,
        capture=replace(base.capture, max_side=1600),
        geometry=replace(base.geometry, image_side=400, face_budget=20000, unwrap_seconds=120.0),
        transport=replace(base.transport, observation_side=400),
        appearance=replace(base.appearance, shading_size=1024, texture_size=4096),
        export=replace(base.export, render_samples=64, render_max_side=800),
    )


# presets by the name typed on the command line
PRESETS: dict[str, Callable[[], RunConfig]] = {"draft": draft, "standard": standard}
