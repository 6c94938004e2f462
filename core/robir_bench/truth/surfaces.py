# SPDX-License-Identifier: Apache-2.0
"""Scores of a surface against the true one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.geometry.mesh.triangles import Mesh

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
_NEIGHBOURS = 8


def surface_distance(points: Array, vertices: Array, faces: NDArray[np.integer[Any]]) -> Array:
    """Distances (N,) of points (N, 3) to a triangle mesh: vertices (Nv, 3) and faces (Nf, 3).

    Exact for the nearest of the candidate triangles, which are those of the 8 nearest surface
    samples (every corner, centroid and some 200 000 area-weighted points); a nearer triangle can be
    missed only where many small ones crowd, by less than the samples' spacing.
    """
    # Not above: it takes most of a second to load, and a reconstruction does without it.
    from trimesh.triangles import closest_point

    corners = np.asarray(vertices, np.float64)[faces]
    samples, owner = _surface_samples(corners)
    _, nearest = cKDTree(samples).query(points, k=min(_NEIGHBOURS, len(samples)))
    best = np.full(len(points), np.inf)
    for face in owner[nearest.reshape(len(points), -1)].T:
        foot = closest_point(corners[face], np.asarray(points, np.float64))
        best = np.minimum(best, np.linalg.norm(foot - points, axis=1))
    return best


def _surface_samples(corners: Array) -> tuple[Array, NDArray[np.int64]]:
    """Points on every triangle (N, 3), more on large ones, and the triangle of each (N,)."""
    rng = np.random.default_rng(0)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    every = np.arange(len(corners))
    drawn = rng.choice(len(corners), 200_000, p=area / area.sum())
    root, other = np.sqrt(rng.random(len(drawn))), rng.random(len(drawn))
    weights = np.stack([1 - root, root * (1 - other), root * other], axis=1)
    random = np.einsum("nk,nkc->nc", weights, corners[drawn])
    samples = [random, corners.mean(axis=1), *(corners[:, k] for k in range(3))]
    return np.concatenate(samples), np.concatenate([drawn, every, every, every, every])


def chamfer(
    visible: Array, true_visible: Array, mesh: Mesh, true_mesh: Mesh, radius: float
) -> dict[str, float]:
    """Chamfer distance between what cameras see of two surfaces, in thousandths of the radius.

    "accuracy", mean distance of visible points (N, 3) to the true surface; "completeness", of truly
    visible points (M, 3) to the estimate; "chamfer", the mean of the two.
    """
    scale = 1000.0 / radius
    accuracy = scale * surface_distance(visible, true_mesh.vertices, true_mesh.faces).mean()
    completeness = scale * surface_distance(true_visible, mesh.vertices, mesh.faces).mean()
    return {
        "chamfer": float(0.5 * (accuracy + completeness)),
        "accuracy": float(accuracy),
        "completeness": float(completeness),
    }


def normal_scores(estimate: Array, truth: Array, hit: Mask) -> dict[str, float]:
    """Mean and median angle, degrees, of unit normals (N, 3); 90 degrees where `hit` is False."""
    sine = np.linalg.norm(np.cross(estimate, truth), axis=1)
    cosine = np.sum(np.asarray(estimate) * truth, axis=1)
    angle = np.where(hit, np.degrees(np.arctan2(sine, cosine)), 90.0)
    return {"mean_degrees": float(angle.mean()), "median_degrees": float(np.median(angle))}
