# SPDX-License-Identifier: Apache-2.0
"""The plot of the recovered tone curve."""

from __future__ import annotations

import subprocess
import sys


def test_no_plotting_library_is_loaded_for_a_run() -> None:
    told = "import sys, robir.export.stage; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", told], check=False).returncode == 0
