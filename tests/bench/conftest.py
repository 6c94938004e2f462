# SPDX-License-Identifier: Apache-2.0
"""A capture with truth, and a command line whose results are perfect at once."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench.fake_robir import FakeRobir
from evaluation import sphere_run

from robir_bench import runs as bench_runs


@pytest.fixture
def robir(monkeypatch) -> FakeRobir:
    fake = FakeRobir()
    monkeypatch.setattr(bench_runs, "_robir", fake)
    return fake


@pytest.fixture(scope="session")
def capture(tmp_path_factory) -> Path:
    return sphere_run.make_truth(tmp_path_factory.mktemp("bench") / "good")
