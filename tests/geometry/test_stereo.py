# SPDX-License-Identifier: Apache-2.0
"""Depth by stereo: matching against brute force, planes and spheres against their depths."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from geometry.scenes import ball, camera_at, capture_of

from robir.geometry.hull import carve, hull_of, mask_distance
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.rays import reduce_view
from robir.geometry.stereo.fusion import (
    carved_in_vain,
    choose_sources,
    entry_depth,
    fuse,
    laplacian,
    smoothest,
    stereo_surface,
    stereo_surfaces,
)
from robir.geometry.stereo.sweep import (
    DepthMap,
    StereoPicture,
    aggregate,
    correlation,
    mean_of_best,
    refined_minimum,
    seen_through_planes,
    sweep,
    window_mean,
)

RADIUS = 0.6


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr("robir.geometry.stereo.fusion._CELLS", 48)


def grain(points):
    """Colours of a solid texture without edges: waves of random directions and lengths."""
    rng = np.random.default_rng(0)
    waves = rng.standard_normal((40, 3)) * 14
    value = np.cos(points @ waves.T + rng.uniform(0, 6, 40)).sum(1)
    return (128 + 12 * value)[:, None].repeat(3, 1).clip(10, 245)


def plain(points):
    return np.full((len(points), 3), 150.0)


def cut(paint, other):
    """One paint on one half of the space, another on the other."""
    return lambda points: np.where(points[:, :1] > 0, paint(points), other(points))


@pytest.fixture(scope="module")
def sphere():
    capture = capture_of(ball(RADIUS, (0, 0, 0)), views=30, side=96, paint=grain)
    return [reduce_view(view, 96) for view in capture.train]


def hull_of_radius(radius, cells=32):
    lattice = Lattice.around(np.full(3, -0.8), np.full(3, 0.8), cells)
    return lattice, lattice.nodes().norm(dim=1) - radius


def true_depths(camera):
    """Depth (H, W) of the sphere, not a number beside it."""
    origins, directions = camera.rays(camera.pixel_centres())
    along = -(origins * directions).sum(1)
    half = RADIUS**2 - ((origins + along[:, None] * directions) ** 2).sum(1)
    far = np.where(half > 0, along - np.sqrt(np.maximum(half, 0)), np.nan)
    depth = far * (directions @ camera.forward)
    return depth.reshape(camera.height, camera.width).astype(np.float32)


def test_paths_are_those_of_brute_force():
    """All sequences of labels that end at a pixel, along a row and back."""
    rng = np.random.default_rng(1)
    cost = rng.random((1, 5, 4)).astype(np.float32)
    small, large = 0.1, 0.3

    def best(line, end, label):
        totals = []
        for before in itertools.product(range(4), repeat=end):
            labels = (*before, label)
            step = np.abs(np.diff(labels))
            paid = small * (step == 1).sum() + large * (step > 1).sum()
            totals.append(paid + sum(line[k, one] for k, one in enumerate(labels)))
        return min(totals)

    found = 4 * aggregate(cost, (small, large))[0]
    row = cost[0]
    for pixel in range(5):
        both = np.array(
            [best(row, pixel, one) + best(row[::-1], 4 - pixel, one) for one in range(4)]
        )
        wanted = both + 2 * row[pixel]  # the two along a column of one pixel
        np.testing.assert_allclose(found[pixel] - found[pixel][0], wanted - wanted[0], atol=1e-5)


def test_the_least_of_a_parabola_lies_between_labels():
    cost = ((np.arange(8) - np.array([[3.3], [0.0], [7.0]])) ** 2)[None].astype(np.float32)
    label, exact = refined_minimum(cost)
    np.testing.assert_array_equal(label[0], [3, 0, 7])
    np.testing.assert_allclose(exact[0], [3.3, 0, 7], atol=1e-4)


def test_correlation_is_that_of_numpy():
    rng = np.random.default_rng(2)
    one, other = rng.random((2, 1, 9, 9)).astype(np.float32)
    found = correlation(one, other, 2, 0.0)[0, 4, 4]
    window = np.s_[0, 2:7, 2:7]
    assert found == pytest.approx(
        np.corrcoef(one[window].ravel(), other[window].ravel())[0, 1], abs=1e-5
    )
    # indifferent to exposure, and to what is no texture
    assert correlation(one, 0.3 * one + 0.2, 2, 0.0)[0, 4, 4] == pytest.approx(1, abs=1e-4)
    assert correlation(0.01 * one, 0.01 * one, 2, 0.1)[0, 4, 4] < 0.01


def test_planes_are_seen_where_the_cameras_project_them():
    own, other = camera_at(0.3, 0.5, 20), camera_at(0.5, 0.6, 24)
    depths = np.array([2.7, 3.4])
    places, inside = seen_through_planes(own, other, depths)
    origins, directions = own.rays(own.pixel_centres())
    for index, depth in enumerate(depths):
        points = origins + directions * (depth / (directions @ own.forward))[:, None]
        pixels, _ = other.project(points)
        np.testing.assert_allclose((places[index].numpy() + 1) * 12, pixels, atol=1e-3)
        np.testing.assert_array_equal(
            inside[index].numpy(), ((pixels >= 0) & (pixels <= 24)).all(1)
        )


def test_a_sphere_has_its_depths(sphere, monkeypatch):
    """With others at 15 degrees and a start in front of it; a plain one has none to trust."""
    monkeypatch.setattr("robir.geometry.stereo.fusion._BASELINE_DEGREES", 20.0)
    pictures = [StereoPicture.of(photo) for photo in sphere]
    positions = np.stack([photo.camera.position for photo in sphere])
    own = 12
    others = [pictures[k] for k in choose_sources(positions)[own]]
    camera = pictures[own].camera
    true = true_depths(camera)
    entry = np.where(np.isfinite(true), 2.4, np.inf).astype(np.float32)
    found = sweep(pictures[own], others, entry, 3.4)
    sure = found.trust > 0.5
    assert sure.sum() > 0.4 * np.isfinite(true).sum()
    off = np.abs(found.depth - true)[sure]
    assert np.median(off) < 0.015
    assert np.quantile(off, 0.9) < 0.04


def test_fused_distances_are_those_of_the_sphere(sphere):
    """Of exact maps: right in sign, and too long by no more than views are tilted."""
    lattice, outer = hull_of_radius(0.68, 40)
    maps = []
    for photo in sphere:
        true = true_depths(photo.camera)
        sure = np.isfinite(true).astype(np.float32)
        maps.append(DepthMap(camera=photo.camera, depth=true, correlation=sure, trust=sure))
    fused = fuse(maps, lattice, outer)
    true = lattice.nodes().norm(dim=1) - RADIUS
    above = lattice.nodes()[:, 2] > 0.1
    near = above & (fused.weight > 3) & (true.abs() < 0.4 * fused.band)
    assert near.sum() > 500
    assert float((fused.distance - true)[near].abs().median()) < 0.035
    clear = near & (true.abs() > 0.5 * lattice.cell)
    assert (torch.sign(fused.distance) == torch.sign(true))[clear].float().mean() > 0.98
    assert not (fused.weight[outer > lattice.cell] > 0).any()


def test_the_smoothest_grid_is_that_of_a_dense_solve():
    generator = torch.Generator().manual_seed(0)
    shape = (5, 6, 4)
    measured = torch.randn(shape, generator=generator)
    weight = 0.1 + torch.rand(shape, generator=generator)
    count = measured.numel()
    bend = torch.stack(
        [laplacian(row.view(shape)).reshape(-1) for row in torch.eye(count)], dim=1
    ).double()
    matrix = torch.diag(weight.reshape(-1).double()) + 0.3 * bend.T @ bend
    wanted = torch.linalg.solve(matrix, (weight * measured).reshape(-1).double())
    found = smoothest(measured, weight, 0.3)
    np.testing.assert_allclose(found.reshape(-1), wanted, atol=1e-4)


def test_stereo_finds_a_sphere_in_a_wide_hull(sphere):
    lattice, outer = hull_of_radius(0.7)
    fine, sdf = stereo_surface(sphere, (lattice, outer))
    mesh = extract(fine, sdf)
    above = mesh.vertices[mesh.vertices[:, 2] > 0.1]  # no camera looks from below
    radius = np.linalg.norm(above, axis=1)
    assert np.median(np.abs(radius - RADIUS)) < 0.01
    assert np.quantile(np.abs(radius - RADIUS), 0.95) < 0.03


def test_a_plain_part_stays_where_its_hull_is():
    """One half without texture: no noise of depths that nothing tells, no pits."""
    capture = capture_of(ball(RADIUS, (0, 0, 0)), views=30, side=96, paint=cut(grain, plain))
    photos = [reduce_view(view, 96) for view in capture.train]
    fine, sdf = stereo_surface(photos, hull_of_radius(0.63))
    mesh = extract(fine, sdf)
    place = mesh.vertices[mesh.vertices[:, 2] > 0.25]
    radius = np.linalg.norm(place, axis=1)
    is_plain = place[:, 0] < -0.2
    # one vertex of 600 lies on the border, where it goes by the processor's roundings
    assert np.quantile(radius[is_plain], 0.005) > RADIUS - 0.012
    assert radius[is_plain].min() > RADIUS - 0.03
    assert radius[is_plain].max() < 0.645
    assert np.median(np.abs(radius[place[:, 0] > 0.15] - RADIUS)) < 0.01


def test_masks_hold_what_mirrors_in_front_of_what_it_shows():
    """A ball that shows what looks like a smaller one behind its surface, as mirrors do."""
    inner = capture_of(ball(0.42, (0, 0, 0)), views=30, side=96, paint=grain)
    outer = capture_of(ball(RADIUS, (0, 0, 0)), views=30, side=96, paint=grain)
    views = []
    for shown, view in zip(inner.views, outer.views, strict=True):
        inside = shown.mask[..., None] > 127
        image = np.where(inside, shown.image_display, np.uint8(128))
        views.append(replace(view, image_display=image))
    photos = [reduce_view(view, 96) for view in views]
    hull = carve(hull_of(photos), 32)

    def missed(surface):
        """Share of the rays well inside the masks that do not meet a surface."""
        mesh = extract(*surface)
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        shares = []
        for photo in photos:
            deep = mask_distance(photo.coverage) < -3
            depth = entry_depth(tracer, photo.camera)
            shares.append((~np.isfinite(depth[deep])).mean())
        return float(np.mean(shares))

    free, held = stereo_surfaces(photos, hull)
    assert missed(free) > 0.1
    assert missed(held) < 0.01


def test_a_rim_that_lacks_is_not_filled_along_whole_rays(sphere):
    """A cap of a ball is missing: of a low one only what is near comes back, of a high one all."""
    lattice, outer = hull_of_radius(0.75)
    radius, up = lattice.nodes().norm(dim=1), lattice.nodes()[:, 0]

    def farthest(height):
        """Largest distance from the surface of what is taken back, unit frame."""
        values = torch.maximum(radius - RADIUS, up - height)
        marked = carved_in_vain(Sampled(lattice, values), sphere, outer)
        assert marked.any()
        return float(values[marked].max())

    # two nodes about a marked one are marked as well, along each axis: up to 3.5 cells
    assert farthest(0.52) < 5.0 * lattice.cell
    assert farthest(0.3) > 5.0 * lattice.cell


def test_mean_of_the_best_of_several_maps():
    maps = [np.random.default_rng(seed).random((5, 6), np.float32) for seed in range(4)]
    for count in (1, 2, 4):
        wanted = np.sort(np.stack(maps), axis=0)[-count:].mean(axis=0)
        np.testing.assert_allclose(mean_of_best(maps, count), wanted, rtol=1e-6)


def test_window_mean_is_that_of_windows_mirrored_at_the_border():
    image = np.random.default_rng(0).random((2, 9, 7), np.float32)
    wide = np.pad(image, ((0, 0), (2, 2), (2, 2)), mode="reflect")
    wanted = np.lib.stride_tricks.sliding_window_view(wide, (5, 5), axis=(1, 2)).mean((3, 4))
    np.testing.assert_allclose(window_mean(image, 2), wanted, rtol=1e-5)
