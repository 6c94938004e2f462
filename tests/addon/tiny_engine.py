# SPDX-License-Identifier: Apache-2.0
"""`python tiny_engine.py check|reconstruct ...`: the real command line with a run of seconds.

ROBIR_TEST_SLOWLY in the environment is a number of seconds to wait at every progress report.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "core"), str(ROOT)]  # this checkout, whichever is installed

from robir import cli, commands  # noqa: E402
from robir.config import RunConfig  # noqa: E402
from robir.pipeline.reporter import RunReporter  # noqa: E402

# constants by which a mesh's place is looked for by fewer photographs and among fewer turns
QUICK_TO_PLACE = (
    "geometry.given.placing._VIEWS=6",
    "geometry.given.placing._TURNS=150",
    "geometry.given.placing._FOLLOWED=2",
    "geometry.given.placing._EVALUATIONS=150",
)


def tiny():
    """The least that every stage still works with."""
    base = RunConfig()
    geometry = replace(
        base.geometry, image_side=48, hull_cells=24, level_cells=(24, 32), level_steps=(50, 50),
        rays=256, face_budget=600, unwrap_seconds=20.0,
    )  # fmt: skip
    transport = replace(base.transport, num_surfels=600, num_directions=64)
    appearance = replace(
        base.appearance, families=("standard",), num_sharp_lobes=0, num_scan_directions=200,
        num_solve_surfels=500, iterations=20, texture_size=64,
    )  # fmt: skip
    export = replace(base.export, renders=False)
    return replace(
        base, geometry=geometry, transport=transport, appearance=appearance, export=export,
        constants=QUICK_TO_PLACE,
    )  # fmt: skip


def main() -> int:
    """Run the command line."""
    commands.RunConfig = tiny
    pause, progress = float(os.environ.get("ROBIR_TEST_SLOWLY", "0")), RunReporter.progress

    def slowly(self: RunReporter, fraction: float, message: str) -> None:
        progress(self, fraction, message)
        time.sleep(pause)

    RunReporter.progress = slowly
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
