# SPDX-License-Identifier: Apache-2.0
"""`python fake_engine.py PAUSE reconstruct ...`: the real command line over stages that only wait.

PAUSE is the seconds before each of a stage's four files; "deaf" is a worker that does not listen,
with a child of its own whose number it writes to OUT/child; "doubtful" has a result that fails its
own quality check.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "core"), str(ROOT), str(ROOT / "tests")]

from robir import cli  # noqa: E402
from robir.pipeline import device, runner  # noqa: E402
from tests.pipeline.fakes import fake_stages  # noqa: E402


def deaf(context) -> None:
    """Go on whatever is asked, for a minute."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    (context.paths.root / "child").write_text(str(child.pid))
    time.sleep(600)


def main() -> int:
    pause = sys.argv[1]
    stages = fake_stages(pause=0.0 if pause in ("deaf", "doubtful") else float(pause))
    stages["export"].metrics = {"is_trusted": pause != "doubtful"}
    if pause == "deaf":
        stages["geometry"].mischief = deaf
    runner.load_stages = lambda: stages
    runner._seed_everything = lambda _seed: None
    device.choose_execution = lambda *_: device.Execution(device="cpu", threads=1)
    return cli.main(sys.argv[2:])


if __name__ == "__main__":
    os.environ.pop("PYTHONPATH", None)
    sys.exit(main())
