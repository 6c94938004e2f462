# SPDX-License-Identifier: Apache-2.0
"""Settings of the geometry stage's steps, from the command line to what the steps find."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

import numpy as np
import pytest
from geometry.test_mirror_map import directions

from robir.config import RunConfig, resolve
from robir.geometry.config import GeometryConfig
from robir.geometry.mirror_map import mirrored_cells
from robir.geometry.rival import weighed
from robir.settings import Within


def geometry_set(*assignments: str) -> GeometryConfig:
    """Settings of the stage as the command line changes them."""
    given = [f"geometry.{assignment}" for assignment in assignments]
    return resolve(RunConfig(), None, given).geometry


def sections(settings: Any) -> Iterator[Any]:
    """Settings and all that are nested in them."""
    yield settings
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value):
            yield from sections(value)


def test_a_setting_of_the_mirror_map_changes_its_cells() -> None:
    normals = directions(2000)
    coarse = geometry_set("prediction.mirror_map.side=4").prediction.mirror_map
    cells = mirrored_cells(normals, normals, coarse)
    assert set(cells) == set(range(16)) and coarse.cells == 16
    fine = geometry_set().prediction.mirror_map
    assert mirrored_cells(normals, normals, fine).max() > 500


def test_a_setting_of_the_rivals_changes_which_leads() -> None:
    leads = [weighed(-4.0, np.e, geometry_set(f"rival.bent={bent}").rival.bent) for bent in (3, 5)]
    assert leads == pytest.approx([-1.0, 1.0])


def test_every_setting_of_a_step_is_explained_and_by_itself_in_its_range() -> None:
    for section in sections(GeometryConfig()):
        explained = type(section).__doc__ or ""
        hints = get_type_hints(type(section), include_extras=True)
        for item in fields(section):
            assert f"        {item.name}:" in explained, f"{type(section).__name__}.{item.name}"
            value = getattr(section, item.name)
            for note in getattr(hints[item.name], "__metadata__", ()):
                if isinstance(note, Within):
                    numbers = value if isinstance(value, tuple) else (value,)
                    assert all(note.low <= number <= note.high for number in numbers)
