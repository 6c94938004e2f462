# SPDX-License-Identifier: Apache-2.0
"""Embree against all pairs of rays and triangles."""

from __future__ import annotations

import numpy as np

from robir.geometry.mesh.tracer import EmbreeTracer


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


def test_first_hits_are_those_of_all_pairs():
    vertices, faces = soup(300, 0)
    origins, directions = rays(2000, 1)
    face, distance, barycentric = brute_force(vertices, faces, origins, directions)
    assert 0.15 < (face >= 0).mean() < 0.98
    hits = EmbreeTracer(vertices, faces).first_hits(origins, directions)
    # A ray within rounding of an edge may pass on either side.
    alike = hits.face == face
    assert alike.mean() > 0.998
    np.testing.assert_allclose(hits.distance[alike], distance[alike], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(hits.barycentric[alike], barycentric[alike], atol=2e-3)
    assert (hits.face.dtype, hits.distance.dtype) == (np.int32, np.float32)


def test_blocked_up_to_a_reach():
    vertices, faces = soup(300, 2)
    origins, directions = rays(2000, 3)
    _, distance, _ = brute_force(vertices, faces, origins, directions)
    reach = np.random.default_rng(4).uniform(0, 1.5, len(origins)).astype(np.float32)
    sure = np.abs(distance - reach) > 1e-4
    tracer = EmbreeTracer(vertices, faces)
    assert (tracer.is_blocked(origins, directions) == np.isfinite(distance)).mean() > 0.998
    within = tracer.is_blocked(origins, directions, reach)
    assert (within == (distance < reach))[sure].mean() > 0.998
    assert 0.05 < within.mean() < 0.9


def test_few_triangles_and_no_rays():
    for count in (1, 3, 5):
        vertices, faces = soup(count, 7)
        middle = vertices[faces].mean(1)
        towards = middle - np.float32([5, 0, 0])
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        origins = np.broadcast_to(np.float32([5, 0, 0]), middle.shape)
        tracer = EmbreeTracer(vertices, faces)
        assert tracer.is_blocked(origins, towards).all()
        assert len(tracer.first_hits(origins[:0], towards[:0]).face) == 0
