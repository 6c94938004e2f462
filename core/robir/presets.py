# SPDX-License-Identifier: Apache-2.0
"""Presets: functions that return a whole configuration."""

from __future__ import annotations

from collections.abc import Callable

from robir.config import RunConfig


def draft() -> RunConfig:
    """Two CPU cores, about two minutes; every default of every room."""
    return RunConfig()


PRESETS: dict[str, Callable[[], RunConfig]] = {"draft": draft}
"""Presets by the name typed on the command line."""
