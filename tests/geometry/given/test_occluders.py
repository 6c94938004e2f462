# SPDX-License-Identifier: Apache-2.0
"""A hand drawn over some photographs is found where it is, and nothing is found where none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from geometry.given.test_surface import Quiet, paint, statue
from geometry.scenes import ball, capture_of

from robir.capture.capture import Capture, Finding, View
from robir.geometry.config import GeometryConfig
from robir.geometry.given.occluders import cleared
from robir.geometry.given.surface import hand_in
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.triangles import Mesh


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


@pytest.fixture(scope="module")
def capture() -> Capture:
    return capture_of(statue(), views=40, side=128, low=-0.5, paint=paint)


def hand(view: View, place: tuple[float, float], skin=(206, 152, 126)) -> tuple[View, np.ndarray]:
    """The photograph with an arm that comes in from below, and where it covers the object."""
    y, x = np.mgrid[:128, :128]
    cx, cy = place
    covered = (np.hypot(x - cx, (y - cy) / 1.3) < 13) | ((np.abs(x - cx) < 6) & (y > cy))
    shade = 1 - 0.25 * (x - cx + 13) / 26
    painted = np.clip(np.array(skin) * shade[..., None], 0, 255).astype(np.uint8)
    image = np.where(covered[..., None], painted, view.image_display)
    return replace(view, image_display=image), covered & (view.mask > 127)


PLACES = {3: (64, 60), 9: (50, 70), 10: (70, 75), 17: (60, 50)}


def test_a_hand_is_left_out_where_it_is_and_nothing_else(capture):
    views, truth = list(capture.views), {}
    for number, place in PLACES.items():
        views[number], truth[number] = hand(views[number], place)
    found = cleared(mesh_of(statue()), views)
    assert set(found.pixels) == {views[number].name for number in PLACES}
    shares = []
    for number, (before, after) in enumerate(zip(views, found.views, strict=True)):
        gone = (before.mask > 127) & (after.mask <= 127)
        if number not in PLACES:
            assert after is before
            continue
        covered = truth[number]
        shares.append((gone & covered).sum() / covered.sum())
        assert (gone & ~covered).sum() < 0.12 * (before.mask > 127).sum()
        assert found.pixels[before.name] == gone.sum()
    assert min(shares) > 0.75
    assert np.mean(shares) > 0.85
    (note,) = found.notes()
    assert f"in 4 of 40 photographs ({max(found.pixels, key=found.pixels.__getitem__)}" in note
    assert f"{sum(found.pixels.values())} pixels" in note


def test_photographs_of_the_object_alone_stay_whole(capture):
    found = cleared(mesh_of(statue()), capture.views)
    assert not found.pixels
    assert found.notes() == ()
    assert all(a is b for a, b in zip(found.views, capture.views, strict=True))


def test_an_exposure_of_its_own_is_nothing_in_front(capture):
    views = list(capture.views)
    darker = np.clip(views[4].image_display * 0.6, 0, 255).astype(np.uint8)
    views[4] = replace(views[4], image_display=darker)
    assert not cleared(mesh_of(statue()), views).pixels


def test_a_hand_before_a_photograph_with_an_exposure_of_its_own(capture):
    views = list(capture.views)
    covered, truth = hand(views[3], (64, 60))
    darker = np.clip(covered.image_display * 0.7, 0, 255).astype(np.uint8)
    views[3] = replace(covered, image_display=darker)
    found = cleared(mesh_of(statue()), views)
    assert set(found.pixels) == {views[3].name}
    gone = (views[3].mask > 127) & (found.views[3].mask <= 127)
    assert (gone & truth).sum() > 0.8 * truth.sum()


def normals_of(view: View, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rays meet a ball about the origin: which do (N,), normals, and mirrored directions."""
    origin, direction = view.camera.rays(view.camera.pixel_centres())
    along = (origin * direction).sum(1)
    root = np.sqrt(np.maximum(along**2 - (origin**2).sum(1) + radius**2, 0))
    normal = (origin + (-along - root)[:, None] * direction) / radius
    mirrored = direction - 2 * (direction * normal).sum(1, keepdims=True) * normal
    return root > 0, normal, mirrored


def test_a_window_that_polish_mirrors_is_no_thing_in_front():
    """It hides most of the paint, over a tenth of the ball, in a quarter of the photographs."""
    radius, window = 0.8, np.array([0.6, 0.0, 0.8])
    solid = ball(radius, (0, 0, 0))
    capture = capture_of(solid, views=90, side=96, low=0.6, paint=lambda p: p * 0 + (20, 170, 40))
    views, shares = [], []
    for view in capture.views:
        hit, _, mirrored = normals_of(view, radius)
        shown = (hit & (mirrored @ window > 0.8) & (view.camera.position[0] < -1)).reshape(96, 96)
        shares.append(shown.sum() / (view.mask > 127).sum())
        image = np.where(shown[..., None], (190, 195, 215), view.image_display).astype(np.uint8)
        views.append(replace(view, image_display=image))
    assert 0.1 < np.mean(np.array(shares) > 0.02) < 0.4
    assert max(shares) > 0.08
    assert not cleared(mesh_of(solid), views).pixels


@pytest.mark.parametrize("base", [(150, 40, 30), (60, 60, 60)])
def test_a_highlight_that_wanders_is_no_thing_in_front(base):
    """Phong's on a ball, as large as satin paint has it: a thirtieth of the ball."""
    radius, lamp = 0.8, np.array([0.3, 0.4, 0.87])
    capture = capture_of(
        ball(radius, (0, 0, 0)),
        views=32,
        side=96,
        paint=lambda p: np.tile(base, (len(p), 1)) * 1.0,
    )
    views, largest = [], 0.0
    for view in capture.views:
        hit, _, mirrored = normals_of(view, radius)
        shine = 90 * np.maximum(mirrored @ lamp, 0) ** 25
        shine = np.where(hit, shine, 0).reshape(96, 96, 1)
        largest = max(largest, (shine[..., 0] > 30).sum() / (view.mask > 127).sum())
        image = np.clip(view.image_display + shine, 0, 255).astype(np.uint8)
        views.append(replace(view, image_display=image))
    assert largest > 0.02
    assert not cleared(mesh_of(ball(radius, (0, 0, 0))), views).pixels


def test_a_photograph_that_is_another_as_a_whole_is_not_cut(capture):
    """Another light or a wrong camera is told elsewhere, and no mask mends it."""
    views = list(capture.views)
    turned = replace(
        views[2], image_display=np.ascontiguousarray(views[2].image_display[..., ::-1])
    )
    views[2] = turned
    assert views[2].name not in cleared(mesh_of(statue()), views).pixels


def test_few_photographs_tell_nothing(capture):
    views = list(capture.views[:6])
    views[3], _ = hand(views[3], PLACES[3])
    assert not cleared(mesh_of(statue()), views).pixels


@pytest.mark.parametrize("code", ["guessed-masks", "given"])
def test_only_photographs_without_masks_of_their_own_are_looked_at(capture, tmp_path, code):
    views = list(capture.views)
    views[3], truth = hand(views[3], PLACES[3])
    finding = Finding(level="note", code=code, message="")
    shown = replace(capture, views=tuple(views), findings=(finding,))
    path = tmp_path / "scan.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(statue()))
    handed = hand_in(path, (shown, shown), GeometryConfig(), tmp_path / "fit.png", Quiet())
    told = [note for note in handed.notes if "stands before the object in 1 of 40" in note]
    if code == "given":
        assert handed.views is None
        assert not told
    else:
        assert handed.views is not None
        assert (handed.views[3].mask[truth] <= 127).mean() > 0.8
        assert len(told) == 1
