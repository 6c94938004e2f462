# SPDX-License-Identifier: Apache-2.0
"""Ground is told by a bounded number of photographs of a bounded size."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
import trimesh

from robir.geometry import settling
from robir.geometry.config import GeometryConfig
from robir.geometry.ground.backdrop import Backdrop
from robir.geometry.ground.flatten import Ground
from robir.geometry.rays import Photo, reduce_view
from robir.geometry.settling import ground_photos
from robir.geometry.stage import reconstruct
from tests.geometry.scenes import ball, capture_of, disc, drum


def test_of_many_fine_photographs_a_few_coarse_ones_tell_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    capture = capture_of(ball(0.4, (0.0, 0.0, 0.0)), views=20, side=240)
    monkeypatch.setattr(settling, "HULL_VIEWS", 12)
    config = GeometryConfig(image_side=240)
    photos = ground_photos(capture, config)
    assert len(photos) == 12
    assert {max(photo.coverage.shape) for photo in photos} == {settling._IMAGE_SIDE}
    eyes = np.stack([photo.camera.position for photo in photos])
    middle = np.stack([view.camera.position for view in capture.train]).mean(0)
    assert np.linalg.norm(eyes.mean(0) - middle) < 0.5  # from all around


def test_few_small_photographs_tell_the_ground_as_they_are() -> None:
    capture = capture_of(ball(0.4, (0.0, 0.0, 0.0)), views=6, side=64)
    config = GeometryConfig()
    photos = ground_photos(capture, config)
    assert len(photos) == len(capture.train)
    for photo, view in zip(photos, capture.train, strict=True):
        whole = reduce_view(view, config.image_side)
        np.testing.assert_array_equal(photo.coverage, whole.coverage)
        np.testing.assert_array_equal(photo.camera.camera_to_world, view.camera.camera_to_world)


def test_the_stage_tells_the_ground_by_them(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    class Recorded(Backdrop):
        def __init__(self, ground: Ground, photos: list[Photo]) -> None:
            asked.append(len(photos))
            super().__init__(ground, photos)

    monkeypatch.setattr(settling, "Backdrop", Recorded)
    monkeypatch.setattr(settling, "HULL_VIEWS", 16)
    config = GeometryConfig(
        level_cells=(32,), level_steps=(10,), rays=256, face_budget=800,
        without=("rivals",),
    )  # fmt: skip
    scene = trimesh.util.concatenate([disc(), drum(0.3, -0.3, -0.1)])
    reconstruct(capture_of(scene, views=24, side=64, low=0.12), config, 0, "cpu", Mock())
    assert asked == [16]
