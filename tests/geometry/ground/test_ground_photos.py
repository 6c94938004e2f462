# SPDX-License-Identifier: Apache-2.0
"""Ground is told by a bounded number of photographs of a bounded size."""

from __future__ import annotations

import pytest
import torch
import trimesh

from robir.geometry.ground import backdrop
from robir.geometry.ground.backdrop import find_ground
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import SupportPlane
from robir.geometry.hull import carve, hull_of
from robir.geometry.lattice import Lattice
from robir.geometry.rays import Photo, reduce_view
from tests.geometry.scenes import capture_of, disc, drum


def test_of_many_fine_photographs_a_few_coarse_ones_tell_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[set[int]] = []

    class Recorded(Ground):
        def __init__(
            self, plane: SupportPlane, photos: list[Photo], lattice: Lattice, hull: torch.Tensor
        ) -> None:
            asked.append({len(photos), *(max(photo.coverage.shape) for photo in photos)})
            super().__init__(plane, photos, lattice, hull)

    monkeypatch.setattr(backdrop, "Ground", Recorded)
    monkeypatch.setattr(backdrop, "HULL_VIEWS", 16)
    monkeypatch.setattr(backdrop, "_IMAGE_SIDE", 48)
    scene = trimesh.util.concatenate([disc(), drum(0.3, -0.3, -0.1)])
    views = capture_of(scene, views=24, side=64, low=0.12).train
    photos = [reduce_view(view, 64) for view in views]
    hull = carve(hull_of(photos), 32)
    assert find_ground(views, photos, hull, torch.Generator().manual_seed(0)) is not None
    assert asked == [{16, 48}]
