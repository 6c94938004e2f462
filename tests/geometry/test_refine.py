# SPDX-License-Identifier: Apache-2.0
"""Meshes moved to where patches of photographs agree, and photographs that predict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from geometry.scenes import ball, camera_at, capture_of
from geometry.test_stereo import RADIUS, grain, plain

from robir.geometry import selection
from robir.geometry.config import GeometryConfig
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.pipeline import post_processed
from robir.geometry.prediction import Predictions, lead
from robir.geometry.rays import reduce_view
from robir.geometry.refine.correlation import (
    agreement,
    correlations,
    outline_shifts,
    pixel_size,
    projection,
    seen_by,
)
from robir.geometry.refine.step import ThinPlate, refine
from robir.geometry.selection import STEREO, PhotographJudge, Selection, bending
from robir.geometry.stereo.fusion import stereo_surfaces
from robir.geometry.stereo.sweep import StereoPicture
from robir.steps import Pipeline

SIDE = 128
CONFIG = GeometryConfig(stereo_side=SIDE, refine_sides=(SIDE,), face_budget=3000)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr("robir.geometry.refine.step._MOST_VERTICES", 12000)
    monkeypatch.setattr("robir.geometry.stereo.fusion._CELLS", 48)


@pytest.fixture(scope="module")
def capture():
    return capture_of(ball(RADIUS, (0, 0, 0)), views=24, side=SIDE, paint=grain)


@pytest.fixture(scope="module")
def photos(capture):
    return [reduce_view(view, SIDE) for view in capture.train]


def judges_of(capture):
    return [PhotographJudge([reduce_view(view, SIDE) for view in capture.train])]


def sphere(radius=RADIUS, dents=0.0):
    """A sphere, with dents of a depth on its upper side."""
    solid = ball(1.0, (0, 0, 0))
    place = np.asarray(solid.vertices)
    depth = dents * np.cos(9 * place[:, 0]) * np.cos(9 * place[:, 1]) * (place[:, 2] > 0.2)
    return plain_mesh(place * (radius - depth)[:, None], np.asarray(solid.faces))


def roughness(mesh):
    """Root mean square distance of the upper side from the true sphere."""
    upper = mesh.vertices[mesh.vertices[:, 2] > 0.15]
    return float(np.sqrt(((np.linalg.norm(upper, axis=1) - RADIUS) ** 2).mean()))


def test_the_matrix_projects_as_the_camera_does():
    camera, points = camera_at(0.4, 0.7, 50), np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    homogeneous = np.concatenate([points, np.ones((20, 1))], 1) @ projection(camera).numpy().T
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], pixels, atol=1e-3)
    np.testing.assert_allclose(homogeneous[:, 2], depth, atol=1e-5)


def test_agreement_is_the_mean_of_pairs_and_spares_what_disagrees():
    rng = np.random.default_rng(0)
    shown = rng.standard_normal(25)
    rows = np.stack([shown, shown, shown, rng.standard_normal(25)])
    rows -= rows.mean(1, keepdims=True)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    patches = torch.from_numpy(rows).float()[None, :, None]
    pairs = (rows @ rows.T).sum(1) - 1
    valid = torch.ones(1, 4)
    assert float(agreement(patches, valid, 1.0)) == pytest.approx(pairs.mean() / 3, abs=1e-5)
    three = np.sort(pairs)[1:].mean() / 3
    assert float(agreement(patches, valid, 0.75)) == pytest.approx(three, abs=1e-5)
    # photographs that do not show it take no part, and one alone tells nothing
    valid[0, 3] = 0
    assert float(agreement(patches, valid, 1.0)) == pytest.approx(1, abs=1e-5)
    assert float(agreement(patches, torch.tensor([[1.0, 0, 0, 0]]), 1.0)) == 0


def test_photographs_agree_most_on_the_surface(photos):
    """Of a sphere that is too small by two pixels the best shift is two pixels."""
    pictures = [StereoPicture.of(photo) for photo in photos]
    pixel = pixel_size([photo.camera for photo in photos])
    mesh = sphere(RADIUS - 2 * pixel)
    cosine = seen_by(mesh, EmbreeTracer(mesh.vertices, mesh.faces), pictures, pixel)
    assert (cosine[mesh.normals[:, 2] < -0.9] == 0).all()
    shifts = np.linspace(-5, 5, 21).astype(np.float32) * pixel
    agreed = correlations(mesh, pictures, cosine, shifts)
    sure = ((cosine > 0).sum(1) >= 4) & (agreed.max(1) > 0.8)
    assert sure.sum() > 300
    best = shifts[agreed[sure].argmax(1)] / pixel
    assert np.median(best) == pytest.approx(2, abs=0.5)


def test_outlines_ask_a_mesh_to_be_as_large_as_the_masks(photos):
    pixel = pixel_size([photo.camera for photo in photos])
    for off in (-1.5, 1.5):
        mesh = sphere(RADIUS + off * pixel)
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        shift, count = outline_shifts(mesh, tracer, photos, pixel)
        assert (count > 0).sum() > 200
        assert np.median(shift[count > 0]) / pixel == pytest.approx(-off, abs=0.5)


def test_the_thin_plate_is_that_of_a_dense_solve():
    solid = trimesh.creation.icosphere(subdivisions=1)
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    plate = ThinPlate(mesh, 1.0, 80)
    count = len(mesh.vertices)
    rng = np.random.default_rng(0)
    start, normals = mesh.vertices.astype(np.float64), mesh.normals.astype(np.float64)
    weight, found = rng.uniform(0, 2, count), rng.normal(0, 0.1, count)
    pull = (weight * found)[:, None] * normals
    solved = plate.solve(
        (start, np.zeros_like(start)), (weight, normals, pull), 0.1, 0.5, has_creases=False
    )
    neighbours = np.zeros((count, count))
    for face in mesh.faces:
        for one, other in zip(face, np.roll(face, 1), strict=True):
            neighbours[one, other] = neighbours[other, one] = 1
    laplacian = np.eye(count) - neighbours / neighbours.sum(1, keepdims=True)
    bending = np.kron(0.5 * laplacian.T @ laplacian, np.eye(3))
    along = np.zeros((3 * count, 3 * count))
    for k in range(count):
        along[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = weight[k] * np.outer(normals[k], normals[k])
    matrix = bending + along + 0.1 * np.eye(3 * count)
    wanted = np.linalg.solve(matrix, (pull.ravel() - bending @ start.ravel()))
    np.testing.assert_allclose(solved.ravel(), wanted, atol=3e-3)


def test_dents_are_taken_out_where_photographs_tell(capture):
    dented = sphere(dents=0.03)
    before = roughness(dented)
    after = roughness(refine(dented, judges_of(capture)))
    assert before > 0.01
    assert after < 0.4 * before


def test_without_texture_a_mesh_is_not_made_rougher():
    capture = capture_of(ball(RADIUS, (0, 0, 0)), views=16, side=SIDE, paint=plain)
    assert roughness(refine(sphere(), judges_of(capture))) < 0.012


class Unasked(PhotographJudge):
    """Photographs that nobody asks about relief."""

    def keeps_relief(self, smooth, rough):
        return False


def test_relief_stays_where_photographs_show_it():
    """A ball with bumps, as it is: bending them away shows photographs something else."""
    bumpy = sphere(dents=0.06)
    solid = trimesh.Trimesh(bumpy.vertices, bumpy.faces, process=False)
    capture = capture_of(solid, views=24, side=SIDE, paint=grain)

    def lost(judges):
        moved = refine(bumpy, judges)
        tracer = EmbreeTracer(bumpy.vertices, bumpy.faces)
        upper = moved.vertices[moved.vertices[:, 2] > 0.25]
        away = upper / np.linalg.norm(upper, axis=1, keepdims=True)
        hits = tracer.first_hits((2 * away).astype(np.float32), -away.astype(np.float32))
        off = 2 - hits.distance - np.linalg.norm(upper, axis=1)
        return float(np.sqrt(np.nanmean(off**2)))

    (judge,) = judges_of(capture)
    asked, smoothest = lost([judge]), lost([Unasked(judge.photos)])
    assert asked < 0.7 * smoothest


def test_photographs_predict_each_other_better_over_the_better_surface(photos):
    predictions = Predictions(photos)
    true, dented, small = (
        predictions.errors(mesh) for mesh in (sphere(), sphere(dents=0.04), sphere(RADIUS - 0.05))
    )
    assert lead(true, true) == 0
    assert lead(dented, true) > 2
    assert lead(true, dented) == pytest.approx(-lead(dented, true))
    # a surface that shows fewer pixels is judged by those that both show
    assert np.mean([np.isnan(one).mean() for one in small]) > np.mean(
        [np.isnan(one).mean() for one in true]
    )
    assert lead(small, true) > 2
    assert lead(true[:1], dented[:1]) == 0


def test_parts_are_judged_one_by_one(photos):
    """Dents on the upper half: photographs speak for the sphere there, and of nothing below."""
    dented, true = sphere(dents=0.04), sphere()
    height = dented.vertices[dented.faces].mean(axis=1)[:, 2]
    part = np.where(height > 0.1, 1, np.where(height < -0.1, 0, -1))
    below, above = Predictions(photos).leads((dented, true), part)
    assert above > 2 > abs(below)


def test_of_many_pixels_every_nth_tells_the_same(photos, monkeypatch):
    dented, true = sphere(dents=0.04), sphere()

    def told():
        predictions = Predictions(photos)
        return [predictions.errors(mesh) for mesh in (dented, true)]

    whole = told()
    monkeypatch.setattr("robir.geometry.prediction._MOST_PIXELS", 600)
    some = told()
    assert max(len(error) for error in some[0]) < 800 < min(len(error) for error in whole[0])
    assert lead(*some) == pytest.approx(lead(*whole), rel=0.35)


def lattice_and_radius():
    lattice = Lattice.around(np.full(3, -0.8), np.full(3, 0.8), 48)
    return lattice, lattice.nodes().norm(dim=1)


def waves(lattice):
    nodes = lattice.nodes()
    return torch.cos(9 * nodes[:, 0]) * torch.cos(9 * nodes[:, 1])


@pytest.mark.parametrize(("dents", "given", "holds"), [(0.0, 0, 1), (0.05, 0, 0), (0.05, 1, 1)])
def test_guessed_masks_are_held_unless_photographs_are_against_it(
    capture, photos, monkeypatch, dents, given, holds
):
    lattice, radius = lattice_and_radius()
    hull = Sampled(lattice, radius - 0.63)
    free = Sampled(lattice, radius - RADIUS)
    held = Sampled(lattice, radius - RADIUS + dents * waves(lattice))
    monkeypatch.setattr(selection, "stereo_surfaces", lambda *_, **__: (free, held))
    rival = Selection(capture.train, photos, (hull, hull), CONFIG, holds_masks=bool(given))
    assert rival._by_depth_maps() is (held if holds else free)


def test_the_rivals_take_the_place_of_a_worse_field_alone(capture, photos, monkeypatch):
    lattice, radius = lattice_and_radius()
    hull = Sampled(lattice, radius - 0.63)
    depths = tuple(stereo_surfaces(photos, hull))  # the same for both fields
    dented = tuple(one._replace(values=one.values + 0.05 * waves(one.lattice)) for one in depths)
    monkeypatch.setattr(selection, "stereo_surfaces", lambda *_, **__: depths)
    for dents, wins in ((0.0, False), (0.05, True)):
        rival = Selection(capture.train, photos, (hull, hull), CONFIG, holds_masks=True)
        field = Sampled(lattice, radius - RADIUS + dents * waves(lattice))
        assert rival.has_better(field) == (rival.best is not None) == wins
        assert not rival.has_better(field), "only the first level is compared"
        assert (rival.best is not None) == wins
    assert rival.best.name == STEREO
    mesh = post_processed(rival.best.dense, CONFIG, print, Pipeline())
    assert 1000 < len(mesh.faces) <= 24000
    assert roughness(mesh) < 0.02
    # what is done to depth maps before they are compared counts
    monkeypatch.setattr(selection, "stereo_surfaces", lambda *_, **__: dented)
    mended = Selection(capture.train, photos, (hull, hull), CONFIG, holds_masks=True)
    assert mended.has_better(field, lambda _: depths[-1])
    assert mended.best.name == STEREO
    assert mended.best.lead == pytest.approx(rival.best.lead)
    off = replace(CONFIG, stereo_side=0)
    silent = Selection(capture.train, photos, (hull, hull), off, holds_masks=True)
    assert not silent.has_better(field)


def test_how_much_a_sphere_and_a_box_bend():
    fine = trimesh.creation.icosphere(subdivisions=4, radius=0.37)
    assert bending(plain_mesh(fine.vertices, fine.faces)) == pytest.approx(
        2 * np.sqrt(np.pi), rel=0.01
    )
    sides = np.array([1.0, 2.0, 3.0])
    box = trimesh.creation.box(sides)
    # twelve edges of a right angle, four of each length
    wanted = 0.5 * (4 * sides.sum() * np.pi / 2) / np.sqrt(box.area)
    assert bending(plain_mesh(box.vertices, box.faces)) == pytest.approx(wanted, rel=1e-6)


def test_the_true_surface_is_better_and_print_is_no_mirror(capture, photos):
    lattice, radius = lattice_and_radius()
    true, dented = (
        Sampled(lattice, radius - RADIUS + dents * waves(lattice)) for dents in (0.0, 0.05)
    )
    hull = Sampled(lattice, radius - 0.63)
    judge = Selection(capture.train, photos, (hull, hull), CONFIG, holds_masks=True)
    assert judge.is_better(true, dented) and not judge.is_better(dented, true)
    assert not judge.is_mirror(true)
