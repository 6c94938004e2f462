# SPDX-License-Identifier: Apache-2.0
"""Guessed masks cut again by the surface, against traced silhouettes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from capture.masks import scene
from scipy.ndimage import binary_dilation

from robir.capture.capture import GUESSED_MASKS, Bounds, Capture, Finding, View
from robir.capture.store import load_settled, save_capture, save_masks
from robir.capture.support import Plane
from robir.errors import StorageError
from robir.geometry import hull, remask
from robir.geometry.config import GeometryConfig
from robir.geometry.hull import HullCarver, object_hull
from robir.geometry.lattice import Sampled
from robir.geometry.rays import reduce_view
from robir.geometry.remask import remasked
from robir.jobs.paths import JobPaths

CONFIG = GeometryConfig(hull_cells=48, stereo_side=160)
TABLE = Plane(normal=np.array([0.0, 0.0, 1.0]), offset=0.0, tolerance=0.01)


def finding(code: str) -> Finding:
    return Finding(level="note", code=code, message="")


@pytest.fixture(scope="module")
def shots() -> list[scene.Posed]:
    return scene.photographs(20, size=(240, 180))


@pytest.fixture(scope="module")
def guessed(shots) -> Capture:
    """Masks that hold a rim of the table and the room; of one a side is missing."""
    views = []
    for number, shot in enumerate(shots):
        mask = binary_dilation(shot.truth, iterations=4)
        if number == 11:
            columns = np.flatnonzero(mask.any(0))
            mask[:, columns[: len(columns) // 3]] = False
        views.append(
            View(
                name=shot.name,
                image_display=shot.image_display,
                mask=np.where(mask, 255, 0).astype(np.uint8),
                camera=shot.camera,
                split="held_out" if number % 8 == 5 else "train",
            )
        )
    bounds = Bounds(centre=np.array([0.25, 0.0, 0.45]), radius=0.9, origin="made")
    return Capture(
        source=Path("made"),
        format="made",
        views=tuple(views),
        bounds=bounds,
        findings=(finding(GUESSED_MASKS),),
        table=TABLE,
    )


def overlaps(capture: Capture, shots: list[scene.Posed]) -> np.ndarray:
    pairs = [(view.mask > 127, shot.truth) for view, shot in zip(capture.views, shots, strict=True)]
    return np.array([(one & two).sum() / (one | two).sum() for one, two in pairs])


def test_masks_come_nearer_to_the_silhouettes(guessed, shots, monkeypatch):
    monkeypatch.setattr("robir.geometry.stereo.fusion._CELLS", 80)
    heard: list[float] = []
    found = remasked(guessed.normalised(), CONFIG, heard.append)
    before, after = overlaps(guessed, shots), overlaps(found, shots)
    assert np.median(after) > 0.97 > np.median(before)
    assert after.min() > 0.9 > before.min()
    assert heard[-1] == 1.0


def plain(view: View, truth: np.ndarray) -> View:
    """The photograph with the object in one colour."""
    colours = np.where(truth[..., None], np.uint8([150, 60, 40]), view.image_display)
    return replace(view, image_display=colours)


def test_a_part_that_one_mask_misses_is_put_back(shots, guessed, monkeypatch):
    monkeypatch.setattr(remask, "_ROUNDS", 0)
    views = [
        replace(plain(view, shot.truth), mask=np.where(shot.truth, np.uint8(255), np.uint8(0)))
        for view, shot in zip(guessed.views, shots, strict=True)
    ]
    columns = np.flatnonzero(shots[11].truth.any(axis=0))
    views[11].mask[:, columns[: len(columns) // 3]] = 0
    capture = replace(guessed, views=tuple(views))
    after = overlaps(remasked(capture.normalised(), CONFIG, lambda _: None), shots)
    assert overlaps(capture, shots)[11] < 0.75
    assert after[11] > 0.93
    assert np.delete(after, 11).min() > 0.96


def test_a_part_that_depth_maps_lose_comes_back_for_its_edge(shots, guessed, monkeypatch):
    def without_ball(_photos: object, hull: Sampled, _coarseness: float) -> Sampled:
        """The hull up to the height of the box; the upper half of the ball is lost."""
        height = hull.lattice.nodes()[:, 2] * 0.9 + 0.45
        return Sampled(hull.lattice, torch.maximum(hull.values, height - 0.5))

    monkeypatch.setattr(remask, "stereo_surface", without_ball)
    pairs = zip(guessed.views, shots, strict=True)
    views = tuple(plain(view, shot.truth) for view, shot in pairs)
    unit = replace(guessed, views=views).normalised()
    after = overlaps(remasked(unit, CONFIG, lambda _: None), shots)
    assert np.median(after) > 0.93
    monkeypatch.setattr(remask, "_FIRMER", np.inf)
    assert np.median(overlaps(remasked(unit, CONFIG, lambda _: None), shots)) < 0.85


def test_the_hull_of_guessed_masks_ends_above_the_table(guessed, monkeypatch):
    capture = guessed.normalised()
    photos = [reduce_view(view, 160) for view in capture.train]
    lattice, values = object_hull(capture, photos, 48)
    height = lattice.nodes()[:, 2].numpy() * 0.9 + 0.45
    assert (values[torch.from_numpy(height < 0.9 * hull._CLEARANCE - 1e-4)] > 0).all()
    given = replace(capture, findings=())
    reaching = object_hull(given, photos, 48)
    inside = reaching[0].nodes()[reaching[1] < 0][:, 2].numpy() * 0.9 + 0.45
    assert inside.min() < 0.5 * hull._CLEARANCE
    monkeypatch.setattr(hull, "_CLEARANCE", 0.1)
    assert (object_hull(capture, photos, 48)[1] < 0).sum() < (values < 0).sum()


def test_outvoted_masks_are_those_that_say_outside_most(shots):
    cameras = [shot.camera.normalised(np.array([0.25, 0, 0.45]), 0.9) for shot in shots[:7]]
    masks = [shot.truth.astype(np.float32) for shot in shots[:7]]
    points = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (500, 3))).float()
    each = torch.stack(list(HullCarver(cameras, masks).by_view(points)))
    for outvoted in range(3):
        expected = each.sort(0, descending=True).values[outvoted]
        torch.testing.assert_close(HullCarver(cameras, masks, outvoted)(points), expected)


def test_later_stages_read_the_masks_and_the_table(tmp_path, guessed):
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), guessed)
    stored = load_settled(paths)
    assert stored.table is not None
    np.testing.assert_array_equal(stored.table.normal, TABLE.normal)
    unit = stored.normalised()
    assert unit.table is not None
    # a point of the table stays one
    assert unit.table.height(
        (np.array([[0.4, 0.2, 0.0]]) - [0.25, 0, 0.45]) / 0.9
    ) == pytest.approx(0)
    cut = [replace(view, mask=255 - view.mask) for view in guessed.views]
    save_masks(paths, cut)
    for view, own in zip(load_settled(paths).views, cut, strict=True):
        np.testing.assert_array_equal(view.mask, own.mask)
    (paths.cut_masks / "000.png").write_bytes(b"")
    with pytest.raises(StorageError, match="geometry stage"):
        load_settled(paths)
