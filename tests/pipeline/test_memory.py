# SPDX-License-Identifier: Apache-2.0
"""Freed memory is used again, not asked for anew."""

from __future__ import annotations

import subprocess
import sys

import pytest

_FAULTS_OF_LATER_ROUNDS = """
import resource
import numpy as np
from robir.pipeline.device import keep_freed_memory
keep_freed_memory()
def step():
    blocks = [np.ones(1 << 20) for _ in range(5)]
step()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(4):
    step()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_no_page_is_mapped_twice() -> None:
    # five blocks of 8 MiB; by default each round maps their 2048 pages of 4 KiB anew
    ended = subprocess.run(
        [sys.executable, "-c", _FAULTS_OF_LATER_ROUNDS], capture_output=True, check=True
    )
    assert int(ended.stdout) < 1000


@pytest.mark.slow
def test_what_is_loaded_is_not_looked_through_for_garbage_again() -> None:
    told = (
        "import gc; from robir.pipeline.runner import load_stages; load_stages();"
        "print(gc.get_freeze_count(), len(gc.get_objects()))"
    )
    ended = subprocess.run([sys.executable, "-c", told], capture_output=True, check=True)
    frozen, looked_through = map(int, ended.stdout.split())
    assert frozen > 100 * looked_through
