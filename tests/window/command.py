# SPDX-License-Identifier: Apache-2.0
"""A whole Blender without a window, asked on its command line."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

# a run cut to a third of a CPU-minute
SETTINGS = (
    "geometry.level_cells=[48, 80]",
    "geometry.level_steps=[100, 150]",
    "geometry.face_budget=5000",
    "transport.num_surfels=8000",
    "transport.num_directions=256",
    "appearance.texture_size=256",
    'appearance.families=["standard", "filmic"]',
    "export.render_views=1",
    "export.render_samples=8",
    "export.render_max_side=64",
)


# the same with a fit that somebody may look at for some seconds
WATCHED = (*SETTINGS, "geometry.level_steps=[100, 300]")


def small_engine(folder: Path, settings: tuple[str, ...] = SETTINGS) -> Path:
    """A Python that this checkout's serves as, but for reconstructions, which it makes smaller."""
    changes = " ".join(f"--set '{setting}'" for setting in settings)
    engine = folder / "python"
    engine.write_text(
        f"""#!/bin/sh
case " $* " in *" reconstruct "*) set -- "$@" {changes} ;; esac
exec '{sys.executable}' "$@"
"""
    )
    engine.chmod(0o755)
    return engine


@dataclass(frozen=True)
class Finished:
    """A reconstruction by Blender's command line."""

    done: subprocess.CompletedProcess[str]  # the process
    out: Path  # the result folder


def blender(home: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run `blender -b --command` with a user's folder."""
    return subprocess.run(
        ["blender", "-b", "--command", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
        env={**os.environ, "HOME": str(home)},
    )


def reconstruct(home: Path, capture: Path, out: Path) -> Finished:
    """Make the small result, pictures included."""
    changes = [word for setting in SETTINGS for word in ("--set", setting)]
    words = ["--engine", sys.executable, *changes]
    return Finished(blender(home, "robir", capture, "-o", out, *words), out)
