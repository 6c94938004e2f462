# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear renders kept by fingerprint: rendered once, tone-mapped many times."""

import os
from collections.abc import Callable
from pathlib import Path

from blender_scenes.request import SceneRequest, fingerprint
from blender_scenes.wheel import wheel_version


def default_folder() -> Path:
    """`$XDG_CACHE_HOME/robir/scenes`, or below `~/.cache`."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robir" / "scenes"


def linear_renders(
    request: SceneRequest, cache: Path, report: Callable[[int, int], None]
) -> tuple[Path, int]:
    """The finished folder of linear renders of a request; views that are missing are rendered.

    Args:
        request: what is asked for.
        cache: folder of all renders.
        report: called with the number of views done and of all views, after each.

    Returns:
        The folder, and the number of views that had to be rendered.
    """
    key = fingerprint(request, wheel_version())
    folder = cache / f"{request.scene}_{key}"
    if (folder / "scene.json").exists():
        return folder, 0
    folder.mkdir(parents=True, exist_ok=True)
    from blender_scenes.render import render_missing  # costs 0.6 CPU-s and 250 MB: only when needed

    return folder, render_missing(request, folder, key, report)
