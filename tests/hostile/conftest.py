# SPDX-License-Identifier: Apache-2.0
"""Pictures of the test scene, rendered once."""

from __future__ import annotations

import pytest
from capture.scene import cameras, shoot


@pytest.fixture(scope="session")
def shots() -> list:
    """Eight pictures with a centred lens of square pixels."""
    return [shoot(camera) for camera in cameras()]


@pytest.fixture(scope="session")
def odd_shots() -> list:
    """Eight pictures with an off-centre lens, fx != fy."""
    return [shoot(camera) for camera in cameras(odd_lens=True)]
