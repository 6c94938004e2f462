# SPDX-License-Identifier: Apache-2.0
"""Scores a finished result against the truth of a rendered capture.

Only test views count, at the resolution of the truth. The foreground of a view is where the
pixel-centre ray meets the scene. Albedo and roughness are compared where the result has a surface
too; what it misses or adds is the business of the mask, the normals and the Chamfer distance.

A result under another light is beside the true scene under it: `robir relight OUT --environment
CAPTURE/truth/second_light.exr` makes the pictures, in Cycles. They go back to radiance by the tone
curve that they were shown through: neither its errors nor those of the recovered light count.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.store import load_settled
from robir.errors import StorageError
from robir.evaluation.layers import (
    TONE_CURVE,
    Layers,
    load_textures,
    stored_facts,
    stored_mesh,
    view_layers,
)
from robir.evaluation.light import load_light, read_exr
from robir.evaluation.metrics import masked_ssim, srgb_from_linear
from robir.evaluation.photos import (
    BACKGROUND,
    display_codes,
    layer_pictures,
    read_picture,
    save_sheet,
)
from robir.evaluation.surfaces import intersection_over_union
from robir.geometry.mesh.triangles import Mesh, vertex_normals
from robir.jobs.paths import JobPaths
from robir.maths import tone
from robir_bench.truth import metrics, surfaces
from robir_bench.truth.aligned import truth_of
from robir_bench.truth.files import TrueView, Truth
from robir_bench.truth.light import light_scores, tone_scores

Picture = NDArray[np.uint8]

Array = NDArray[np.floating[Any]]

_MAX_CHAMFER_POINTS = 40_000


def evaluate(paths: JobPaths, truth: Path, sheet: Path | None = None) -> dict[str, Any]:
    """Every score that needs truth of a result whose appearance stage is done, plain JSON values.

    "scene", those of `image_scores` and `geometry_scores`, "light", "tone_curve", "relighting"
    (None unless the result was relit as the truth was), "views", "alignment" (how the truth of
    photographs was brought to the result; None of renderings). The comparison is written to
    `sheet`, a PNG. `StorageError` if the result lacks a stage, `CaptureError` if there is no truth.
    """
    known, alignment = truth_of(truth, paths)
    capture_file = paths.stage("capture") / "capture.json"
    needed = (capture_file, paths.stage("geometry") / "mesh.npz", paths.manifest("appearance"))
    for file in needed:
        if not file.is_file():
            raise StorageError(
                f"{file} is missing: only a finished reconstruction can be evaluated; "
                "run `robir reconstruct` with --resume first"
            )
    mesh = stored_mesh(paths)
    layers = view_layers(mesh, load_textures(paths), (view.camera for view in known.views))
    scores: dict[str, Any] = {
        "scene": {name: known.scene[name] for name in ("scene", "ground", "light", "seed")},
        "views": len(known.views),
        "alignment": None if alignment is None else alignment.described(),
        **image_scores(layers, known),
        **geometry_scores(layers, mesh, known),
        "light": light_scores(
            load_light(paths.stage("appearance") / "light.json"),
            known.environment_linear * known.exposed,
            known.sun_direction,
            _pooled([_unit(view) for view in known.views], [view.hit for view in known.views]),
        ),
        "tone_curve": tone_scores(
            stored_facts(paths.stage("appearance") / "tone_curve.json", TONE_CURVE), known.scene
        ),
        "relighting": relight_scores(paths, known),
    }
    if sheet is not None:
        scale = scores["albedo"]["scale"]["per_channel_lsq"]
        save_sheet(sheet, truth_sheet(paths, layers, known, np.array(scale)))
    return scores


def image_scores(layers: tuple[Layers, ...], truth: Truth) -> dict[str, Any]:
    """Albedo, its baseline, baked shadows and roughness, of the result as each test view sees it.

    "albedo" (PSNRs, scales, "ssim" averaged over views; SSIM is of the sRGB-encoded
    per-channel least-squares albedo), "photo_as_albedo" (PSNRs of the photograph decoded as sRGB),
    "uncertainty" (how often its bands hold the truth; None where none is stated), "shadow" (and
    "shadow_of_photo": the same ratio of the photograph), "roughness".
    """
    both = [ours.hit & view.hit for ours, view in zip(layers, truth.views, strict=True)]
    photos = [metrics.linear_from_srgb(view.photo_display) for view in truth.views]
    true_albedo = _pooled([view.albedo for view in truth.views], both)
    albedo = metrics.albedo_scores(_pooled([o.albedo_linear for o in layers], both), true_albedo)
    scale = np.array(albedo["scale"]["per_channel_lsq"])
    ssim = []
    for ours, view, mask in zip(layers, truth.views, both, strict=True):
        if mask.any():
            encoded = srgb_from_linear(ours.albedo_linear * scale)
            ssim.append(masked_ssim(encoded, srgb_from_linear(view.albedo), mask))
    regions = [
        metrics.shadow_regions(view.sun_visibility, view.normal, mask, truth.sun_direction)
        for view, mask in zip(truth.views, both, strict=True)
    ]
    in_sun, in_shadow = (np.stack([region[i] for region in regions]) for i in (0, 1))
    stacked = np.stack([view.albedo for view in truth.views])
    return {
        "albedo": {**albedo, "ssim": _mean(ssim)},
        "uncertainty": _uncertainty(layers, both, true_albedo),
        "photo_as_albedo": metrics.albedo_scores(_pooled(photos, both), true_albedo),
        "shadow": metrics.shadow_ratio(
            np.stack([ours.albedo_linear for ours in layers]), stacked, in_sun, in_shadow
        ),
        "shadow_of_photo": metrics.shadow_ratio(np.stack(photos), stacked, in_sun, in_shadow),
        "roughness": metrics.roughness_scores(
            _pooled([ours.roughness for ours in layers], both),
            _pooled([view.roughness for view in truth.views], both),
        ),
    }


def _uncertainty(
    layers: tuple[Layers, ...], both: list[NDArray[np.bool_]], true_albedo: Array
) -> dict[str, Any] | None:
    """Coverage of the stated errors of albedo over the pixels of all views."""
    stated = [ours.uncertainty for ours in layers]
    if any(error is None for error in stated):
        return None
    estimate = _pooled([ours.albedo_linear for ours in layers], both)
    return metrics.band_coverage(estimate, true_albedo, _pooled(stated, both))


def geometry_scores(layers: tuple[Layers, ...], mesh: Mesh, truth: Truth) -> dict[str, Any]:
    """Scores of a mesh in the capture's frame: "normals", "mask_iou" and "chamfer"."""
    views = truth.views
    ours_hit = np.stack([ours.hit for ours in layers])
    true_hit = np.stack([view.hit for view in views])
    masks = [view.hit for view in views]
    true_mesh = Mesh(
        vertices=truth.vertices,
        faces=truth.faces,
        normals=vertex_normals(truth.vertices, truth.faces),
        uvs=np.zeros((0, 2), np.float32),
        uv_faces=np.zeros((0, 3), np.int32),
    )
    return {
        "normals": surfaces.normal_scores(
            _pooled([ours.normal for ours in layers], masks),
            _pooled([_unit(view) for view in views], masks),
            ours_hit[true_hit],
        ),
        "mask_iou": intersection_over_union(ours_hit, true_hit),
        "chamfer": surfaces.chamfer(
            _thinned(_pooled([o.position for o in layers], [o.hit for o in layers])),
            _thinned(_pooled([view.position for view in views], masks)),
            mesh,
            true_mesh,
            truth.radius,
        ),
    }


def _unit(view: TrueView) -> Array:
    length = np.linalg.norm(view.normal, axis=-1, keepdims=True)
    return view.normal / np.maximum(length, 1e-6)


def _pooled(images: list[Any], masks: list[NDArray[np.bool_]]) -> Array:
    """Masked pixels of all views in one array, (N,) or (N, C)."""
    return np.concatenate([image[mask] for image, mask in zip(images, masks, strict=True)])


def _thinned(points: Array) -> Array:
    return points[:: -(-len(points) // _MAX_CHAMFER_POINTS) or 1]


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


LIGHT = "second_light"  # name, without suffix, of the map beside the truth
WHOLE = 254  # code of alpha from which a pixel is wholly the object's
_WHOLE_SHARE = 0.999


def second_light(capture: Path) -> Path | None:
    """The map under which a rendered capture was rendered once more, or None."""
    file = capture / "truth" / f"{LIGHT}.exr"
    return file if file.is_file() else None


def relit_picture(paths: JobPaths, view: str) -> Path:
    """Where `robir relight` leaves a test view under the second light."""
    return paths.renders / f"relit_{LIGHT}_test_{view}.png"


def relight_scores(paths: JobPaths, truth: Truth) -> dict[str, Any] | None:
    """`metrics.albedo_scores` of relit radiance in [0, 1], and its "views"; None if not relit."""
    facts = stored_facts(paths.stage("appearance") / "tone_curve.json", TONE_CURVE)
    curve = tone.curve_from_name(facts["family"], facts["parameters"])
    pairs = [_radiance(paths, truth, view, curve) for view in truth.views]
    known = [pair for pair in pairs if pair is not None]
    if not known:
        return None
    ours, true = (np.concatenate([pair[i] for pair in known]) for i in (0, 1))
    return metrics.albedo_scores(ours, np.clip(true, 0.0, 1.0)) | {"views": len(known)}


def _radiance(
    paths: JobPaths, truth: Truth, view: TrueView, curve: tone.AbstractToneCurve
) -> tuple[Array, Array] | None:
    """Radiance (N, 3) of the result and of the truth over the pixels that count."""
    picture = relit_picture(paths, view.name)
    file = truth.root / "truth" / "relit" / f"{view.name}.exr"
    if not (picture.is_file() and file.is_file()):
        return None
    codes, planes = read_picture(picture), read_exr(file)
    if codes.shape != (*view.hit.shape, 4):
        return None
    shown = torch.from_numpy(codes[..., :3].astype(np.float32) / 255)
    ours = curve.linear_from_display(shown).numpy()
    true = np.stack([planes[f"radiance.{axis}"] for axis in "RGB"], axis=-1)
    both = view.hit & (planes["mask"] > _WHOLE_SHARE) & (codes[..., 3] >= WHOLE)
    return (ours[both], true[both]) if both.any() else None


_MAX_ROWS = 4


def truth_sheet(
    paths: JobPaths, layers: tuple[Layers, ...], truth: Truth, albedo_scale: Array
) -> list[dict[str, Picture]]:
    """Up to four rows: photograph, re-render, and materials and normals, beside their truth."""
    rerenders = _rerenders(paths)
    rows = []
    count = min(_MAX_ROWS, len(truth.views))
    for index in np.linspace(0, len(truth.views) - 1, count).round().astype(int):
        view, ours = truth.views[index], layers[index]
        pictures = layer_pictures(ours, albedo_scale)
        blank = np.full((*view.hit.shape, 3), BACKGROUND, np.uint8)
        again = rerenders.get(_pose_key(view.camera.camera_to_world), blank)
        true_albedo = srgb_from_linear(view.albedo)
        rows.append(
            {
                "photo": display_codes(view.photo_display, view.hit),
                "re-render": again,
                "albedo (scaled)": pictures["albedo"],
                "true albedo": display_codes(true_albedo, view.hit),
                "roughness": pictures["roughness"],
                "true roughness": display_codes(view.roughness, view.hit),
                "normals": pictures["normals"],
                "true normals": display_codes(0.5 + 0.5 * view.normal, view.hit),
            }
        )
    return rows


def _rerenders(paths: JobPaths) -> dict[tuple[float, ...], Picture]:
    """Our own re-renders of held-out views by camera pose."""
    held_out = paths.stage("appearance") / "held_out.npz"
    capture = load_settled(paths)
    arrays = stored_arrays(held_out, PICTURES)
    found = {
        _pose_key(view.camera.camera_to_world): arrays[view.name]
        for view in capture.held_out
        if view.name in arrays
    }
    return {key: picture[..., :3] for key, picture in found.items()}


def _pose_key(camera_to_world: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(np.round(camera_to_world[:3, 3], 4).tolist())
