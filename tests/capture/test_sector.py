# SPDX-License-Identifier: Apache-2.0
"""A sector of photographs that judges alone, seen from above, wherever the object stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from transport.shapes import looking_at

from robir.capture import views
from robir.capture.config import CaptureConfig
from robir.capture.frames import Frame, Lens
from robir.capture.views import splits
from robir.errors import ConfigError

ANGLES = np.radians(15.0 * np.arange(24))


def ring(centre=(0.0, 0.0, 0.0)) -> list[Frame]:
    """24 photographs round an object, by turns low and high."""
    frames = []
    for index, angle in enumerate(ANGLES):
        place = (3 * np.cos(angle), 3 * np.sin(angle), 0.8 + index % 2)
        pose = looking_at(place).camera_to_world.copy()
        pose[:3, 3] += centre
        frames.append(
            Frame(
                name=f"view_{index:02d}",
                image=Path("none.png"),
                lens=Lens(width=100, height=100, fx=100.0),
                relative="none.png",
                camera_to_world=pose,
            )
        )
    return frames


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (40.0, -25.0, 7.0)])
def test_no_photograph_of_the_sector_takes_part(centre):
    found = splits(ring(centre), CaptureConfig(held_out_sector=62.0))
    held_out = [frame.name for frame, split in found if split == "held_out"]
    train = [frame.name for frame, split in found if split == "train"]
    # the middle one and two on either side: 30 degrees
    assert held_out == [f"view_{index:02d}" for index in range(10, 15)]
    assert len(train) == 19 and not set(train) & set(held_out)


def test_what_is_too_many_to_judge_takes_no_part_either(monkeypatch):
    monkeypatch.setattr(views, "_MAX_HELD_OUT", 3)
    found = splits(ring(), CaptureConfig(held_out_sector=122.0))
    kinds = [split for _, split in found]
    assert kinds.count("held_out") == 3
    assert kinds.count("train") == 24 - 9


def test_without_a_sector_every_eighth_judges():
    kinds = [split for _, split in splits(ring(), CaptureConfig())]
    assert kinds.count("held_out") == 3 and kinds.count("train") == 21


def test_half_a_circle_is_the_widest():
    with pytest.raises(ConfigError, match="held_out_sector is 200"):
        CaptureConfig(held_out_sector=200.0)
