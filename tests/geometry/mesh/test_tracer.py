# SPDX-License-Identifier: Apache-2.0
"""Embree, the torch tree and all pairs of rays and triangles agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from transport.shapes import mesh_of, patch

from robir.geometry.mesh.torch_tracer import LEAF_SIZE, TorchTracer, _halved
from robir.geometry.mesh.tracer import EmbreeTracer, make_tracer

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)]


def soup(num_faces: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles without order, each about 0.3 across, in a cube of side 2."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-1, 1, (num_faces, 1, 3))
    vertices = (centres + rng.normal(0, 0.15, (num_faces, 3, 3))).reshape(-1, 3)
    return vertices.astype(np.float32), np.arange(3 * num_faces, dtype=np.int32).reshape(-1, 3)


def rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-1.5, 1.5, (count, 3)).astype(np.float32), directions.astype(np.float32)


def brute_force(vertices, faces, origins, directions):
    """Face, distance and barycentrics of all first hits, by Cramer's rule in float64."""
    corners = vertices[faces].astype(float)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    system = np.stack(
        np.broadcast_arrays((b - a)[None], (c - a)[None], -directions[:, None].astype(float)),
        axis=3,
    )
    solved = np.linalg.solve(system, (origins[:, None] - a[None])[..., None])[..., 0]
    u, v, distance = solved[..., 0], solved[..., 1], solved[..., 2]
    valid = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    distance = np.where(valid, distance, np.inf)
    face = distance.argmin(1)
    row = np.arange(len(face))
    u, v, distance = u[row, face], v[row, face], distance[row, face]
    hit = np.isfinite(distance)
    return np.where(hit, face, -1), distance, np.stack([1 - u - v, u, v], 1) * hit[:, None]


def tracers(vertices, faces, device):
    return [EmbreeTracer(vertices, faces), TorchTracer(vertices, faces, device)]


@pytest.mark.parametrize("device", DEVICES)
def test_first_hits_are_those_of_all_pairs(device):
    vertices, faces = soup(300, 0)
    origins, directions = rays(2000, 1)
    face, distance, barycentric = brute_force(vertices, faces, origins, directions)
    assert 0.15 < (face >= 0).mean() < 0.98
    for tracer in tracers(vertices, faces, device):
        hits = tracer.first_hits(origins, directions)
        # A ray within rounding of an edge may pass on either side.
        alike = hits.face == face
        assert alike.mean() > 0.998
        np.testing.assert_allclose(hits.distance[alike], distance[alike], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(hits.barycentric[alike], barycentric[alike], atol=2e-3)
        assert (hits.face.dtype, hits.distance.dtype) == (np.int32, np.float32)


@pytest.mark.parametrize("device", DEVICES)
def test_blocked_up_to_a_reach(device):
    vertices, faces = soup(300, 2)
    origins, directions = rays(2000, 3)
    _, distance, _ = brute_force(vertices, faces, origins, directions)
    reach = np.random.default_rng(4).uniform(0, 1.5, len(origins)).astype(np.float32)
    sure = np.abs(distance - reach) > 1e-4
    for tracer in tracers(vertices, faces, device):
        assert (tracer.is_blocked(origins, directions) == np.isfinite(distance)).mean() > 0.998
        within = tracer.is_blocked(origins, directions, reach)
        assert (within == (distance < reach))[sure].mean() > 0.998
        assert 0.05 < within.mean() < 0.9


@pytest.mark.parametrize("device", DEVICES)
def test_axis_aligned_rays_and_many_chunks(device, monkeypatch):
    monkeypatch.setattr("robir.geometry.mesh.torch_tracer.CHUNK_CPU", 1000)
    vertices, faces = soup(200, 5)
    origins, _ = rays(3001, 6)
    directions = np.eye(3, dtype=np.float32)[np.arange(3001) % 3]
    directions[::2] *= -1
    embree, torch_hits = (
        tracer.first_hits(origins, directions) for tracer in tracers(vertices, faces, device)
    )
    assert (embree.face == torch_hits.face).mean() > 0.998


def test_no_ray_slips_between_the_triangles_of_a_wall():
    wall = mesh_of(patch((-1, -1, 0), (2, 0, 0), (0, 2, 0), 20))
    tracer = TorchTracer(wall.vertices, wall.faces, "cpu")
    # Through all the vertices and the middles of the edges, from an odd place.
    steps = np.linspace(-0.95, 0.95, 39)
    targets = np.stack([*np.meshgrid(steps, steps), np.zeros((39, 39))], -1).reshape(-1, 3)
    origin = np.array([0.3, -0.2, 2.7])
    directions = (targets - origin) / np.linalg.norm(targets - origin, axis=1, keepdims=True)
    origins = np.broadcast_to(origin, targets.shape).astype(np.float32)
    hits = tracer.first_hits(origins, directions.astype(np.float32))
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.barycentric.sum(1), 1, atol=1e-6)


@given(count=st.integers(1, 67), seed=st.integers(0, 5))
def test_every_triangle_lies_in_one_leaf(count, seed):
    centres = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    order, depth, axes = _halved(centres)
    assert sorted(order) == list(range(count))
    assert len(axes) == 1 << depth
    assert count <= LEAF_SIZE << depth


def test_few_triangles_and_no_rays():
    for count in (1, 3, 5):
        vertices, faces = soup(count, 7)
        middle = vertices[faces].mean(1)
        towards = middle - np.float32([5, 0, 0])
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        origins = np.broadcast_to(np.float32([5, 0, 0]), middle.shape)
        for tracer in tracers(vertices, faces, "cpu"):
            assert tracer.is_blocked(origins, towards).all()
            assert len(tracer.first_hits(origins[:0], towards[:0]).face) == 0


def test_the_device_chooses_the_tracer():
    vertices, faces = soup(4, 0)
    assert isinstance(make_tracer(vertices, faces, "cpu"), EmbreeTracer)


@pytest.mark.cuda
def test_cuda_walks_the_tree_in_torch():
    vertices, faces = soup(4, 0)
    assert isinstance(make_tracer(vertices, faces, "cuda"), TorchTracer)
