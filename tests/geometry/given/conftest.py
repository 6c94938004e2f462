# SPDX-License-Identifier: Apache-2.0
"""How thoroughly a mesh's place is looked for."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from addon.tiny_engine import QUICK_TO_PLACE

from robir.constants import changed


@pytest.fixture
def thorough() -> None:
    """Of a test that asks how well a place is found."""


@pytest.fixture(autouse=True)
def _quick_to_place(request: pytest.FixtureRequest) -> Iterator[None]:
    """Few photographs and few turns, for all other tests."""
    with changed(() if "thorough" in request.fixturenames else QUICK_TO_PLACE):
        yield
