# SPDX-License-Identifier: Apache-2.0
"""What all tests share: fixed seeds, few threads, and no test that needs what is not there."""

from __future__ import annotations

import importlib.util
import os

import pytest
from hypothesis import HealthCheck, settings

# Before torch loads: threads that wait for each other spin, and most arrays here are too small to
# be shared out; what the tests start inherits it.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

settings.register_profile(
    "robir", max_examples=25, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],  # a busy machine is
)  # fmt: skip
settings.load_profile("robir")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs Blender, CUDA or pycolmap where there is none."""
    has_pycolmap = importlib.util.find_spec("pycolmap") is not None
    has_bpy = importlib.util.find_spec("bpy") is not None
    needs_cuda = [item for item in items if item.get_closest_marker("cuda")]
    has_cuda = bool(needs_cuda) and _has_cuda()
    for item in items:
        if item.get_closest_marker("blender") and not has_bpy:
            item.add_marker(pytest.mark.skip(reason="the bpy wheel is not installed"))
        if item.get_closest_marker("pycolmap") and not has_pycolmap:
            reason = "POSES NOT TESTED: pycolmap is not installed (pip install 'robir[photos]')"
            item.add_marker(pytest.mark.skip(reason=reason))
    for item in needs_cuda:
        if not has_cuda:
            item.add_marker(pytest.mark.skip(reason="no CUDA device"))


def _has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()


@pytest.fixture(autouse=True)
def _seeded() -> None:
    """Every test starts from the same global generators."""
    import numpy as np
    import torch

    np.random.seed(0)
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def shots() -> list:
    """Eight pictures of the captures' test scene with a centred lens of square pixels."""
    from capture.scene import cameras, shoot

    return [shoot(camera) for camera in cameras()]


@pytest.fixture(scope="session")
def odd_shots() -> list:
    """Eight pictures with an off-centre lens, fx != fy."""
    from capture.scene import cameras, shoot

    return [shoot(camera) for camera in cameras(odd_lens=True)]
