# SPDX-License-Identifier: Apache-2.0
"""The method `photo`: what photogrammetry gives today, photographs blended into a texture.

It takes the surface of the whole method and calls the photographs, decoded as sRGB, its albedo:
light and shadows stay in it. Every step has the whole method's readers and metrics about it, so
what it scores below the whole method is what inverse rendering is worth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.appearance.texturing import solved_side
from robir.capture.capture import Capture
from robir.capture.store import load_settled
from robir.config import RunConfig
from robir.evaluation.layers import view_layers
from robir.evaluation.metrics import srgb_from_linear
from robir.evaluation.photos import mean_scores, photo_scores
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.transport.baked import RAY_OFFSET
from robir.transport.observe import observe
from robir.transport.surfels import interpolate
from robir_bench.truth.metrics import linear_from_srgb

Floats = NDArray[np.floating[Any]]

_ROUGHNESS = 0.5


def texture_photographs(paths: JobPaths, config: RunConfig) -> dict[str, Any]:
    """Write an appearance stage whose albedo is the photographs themselves.

    Args:
        paths: Result folder with the capture and geometry stages done.
        config: For the size of the texture and how rays start.

    Returns:
        Scores of the re-rendered held-out views, as `mean_scores` gives them.
    """
    capture = load_settled(paths).normalised()
    mesh = Mesh.load(paths.stage("geometry") / "mesh.npz")
    face, barycentric = rasterise_atlas(mesh, solved_side(config.appearance, mesh.cells))
    inside = face >= 0
    position, normal = interpolate(mesh, face[inside], barycentric[inside].astype(np.float32))
    albedo, coverage = _blended(capture, mesh, position, normal, RAY_OFFSET)
    arrays: dict[str, NDArray[Any]] = {
        name: np.zeros(inside.shape, np.float32) for name in ("roughness", "coverage")
    }
    arrays["albedo_linear"] = np.zeros((*inside.shape, 3), np.float32)
    arrays["albedo_linear"][inside] = albedo
    arrays["roughness"][inside] = _ROUGHNESS
    arrays["coverage"][inside] = coverage
    appearance = paths.stage("appearance")
    appearance.mkdir(parents=True, exist_ok=True)
    again, scores = _shown_again(capture, mesh, arrays | {"inside": inside})
    for name, table in (("textures", arrays | {"inside": inside}), ("held_out", again)):
        with replacing(appearance / f"{name}.npz") as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **table)
    write_json(appearance / "light.json", {"lobes": []})
    write_json(appearance / "tone_curve.json", {"family": "standard", "parameters": {}})
    write_json(paths.manifest("appearance"), {"stage": "appearance", "method": "photo"})
    return scores


def _blended(
    capture: Capture, mesh: Mesh, position: Floats, normal: Floats, offset: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Mean of the photographs that show each point, (N, 3), and their number, (N,).

    Photographs count by the cosine they see the point under; points that none shows take the
    nearest one's mean.
    """
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    seen = observe(tracer, position, normal, capture.train, offset)
    total = np.zeros((len(position), 3))
    for view in range(len(capture.train)):
        total += seen.weight[:, view, None] * linear_from_srgb(seen.display[:, view] / 255.0)
    weight = seen.weight.sum(axis=1)
    shown = weight > 0
    albedo = total / np.maximum(weight, 1e-9)[:, None]
    if shown.any() and not shown.all():
        nearest = cKDTree(position[shown]).query(position[~shown])[1]
        albedo[~shown] = albedo[shown][nearest]
    return albedo, (seen.weight > 0).sum(axis=1)


def _shown_again(
    capture: Capture, mesh: Mesh, arrays: dict[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
    """Held-out views of the texture as it is, RGBA codes by name, and their scores."""
    again, scores = {}, []
    layers = view_layers(mesh, arrays, (view.camera for view in capture.held_out))
    for view, ours in zip(capture.held_out, layers, strict=True):
        shown = np.dstack([srgb_from_linear(ours.albedo_linear), ours.hit])
        again[view.name] = np.rint(255 * shown).astype(np.uint8)
        scores.append(photo_scores(again[view.name], view))
    return again, mean_scores(scores)
