# SPDX-License-Identifier: Apache-2.0
"""A result's surface and material as a camera sees them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.arrays import stored_arrays
from robir.capture.camera import Camera
from robir.capture.capture import Bounds
from robir.capture.store import load_bounds
from robir.errors import StorageError
from robir.evaluation.surfaces import MeshCaster
from robir.geometry.mesh.tiles import sample_texture
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths
from robir.jobs.records import NUMBERS, read_record

Array = NDArray[np.floating[Any]]

TONE_CURVE = {"family": str, "parameters": {...: float}}  # what tone_curve.json has to hold
_EXPOSURE = {
    "steps": {...: NUMBERS}, "corner_steps": float, "slope_steps": {...: NUMBERS},
    "other_light": [str],
}  # fmt: skip
_BY_VIEW = "steps", "slope_steps"
_NORMALS = {"normals": "f V 3"}
_TEXTURES = {
    "inside": "b T T", "albedo_linear": "f T T 3", "roughness": "f T T", "metallic?": "f T T",
    "coverage?": "f T T", "uncertainty?": "f T T", "specular?": "f",
}  # fmt: skip

SUB_PIXELS = 3  # rays along either side of a pixel whose mean a layer holds, as in a renderer


@dataclass(frozen=True, slots=True, kw_only=True)
class Layers:
    """Images of one view; 0 where the camera misses the mesh."""

    hit: NDArray[np.bool_]  # (H, W) bool, whether the ray through the pixel's centre meets the mesh
    # (H, W, 3), where it does, frame of the mesh. The others are means over the part of the pixel
    # that shows the mesh.
    position: Array
    normal: Array  # (H, W, 3), unit, world
    albedo_linear: Array  # (H, W, 3), linear Rec.709
    roughness: Array  # (H, W), perceptual
    uncertainty: Array | None  # (H, W), standard error of log albedo, if stated


def shaded_mesh(paths: JobPaths) -> Mesh:
    """The reconstructed mesh in the unit frame, with its shading normals."""
    mesh = Mesh.load(paths.stage("geometry") / "mesh.npz")
    shading = paths.stage("appearance") / "normals.npz"
    if not shading.is_file():  # not every method corrects them
        return mesh
    shaded = replace(mesh, normals=stored_arrays(shading, _NORMALS)["normals"])
    if not shaded.is_whole():
        raise StorageError(f"{shading} is damaged; run `robir reconstruct` with --resume")
    return shaded


def result_mesh(paths: JobPaths, bounds: Bounds) -> Mesh:
    """The same in the capture's own frame and unit."""
    mesh = shaded_mesh(paths)
    vertices = mesh.vertices * bounds.radius + bounds.centre
    return replace(mesh, vertices=vertices.astype(np.float32))


def stored_mesh(paths: JobPaths) -> Mesh:
    """The same, by the bounds alone."""
    return result_mesh(paths, load_bounds(paths))


def stored_facts(path: Path, form: Any) -> Any:
    """Contents of a stage's JSON file of a form of `robir.jobs.records`, or a `StorageError`."""
    try:
        return read_record(path, form)
    except (OSError, ValueError) as fault:
        raise StorageError(f"{path} is damaged ({fault}); reconstruct with --resume") from fault


def stored_exposure(path: Path) -> dict[str, Any]:
    """Contents of the appearance stage's exposure.json, or a `StorageError`."""
    exposure = stored_facts(path, _EXPOSURE)
    if any(len(row) != 3 for name in _BY_VIEW for row in exposure[name].values()):
        raise StorageError(f"{path} is damaged (not three values); reconstruct with --resume")
    return exposure


def load_textures(paths: JobPaths, *needed: str) -> dict[str, Array]:
    """Arrays of the appearance stage's textures.npz by name; a `StorageError` without `needed`."""
    path = paths.stage("appearance") / "textures.npz"
    return stored_arrays(path, _TEXTURES | {name: _TEXTURES[f"{name}?"] for name in needed})


def view_layers(
    mesh: Mesh, textures: dict[str, Array], cameras: Iterable[Camera], sub_pixels: int = SUB_PIXELS
) -> tuple[Layers, ...]:
    """What cameras see of an unwrapped mesh with textures (T, T, ...), by odd rays a pixel side."""
    caster = MeshCaster(mesh)
    inside = textures["inside"].astype(bool)
    planes = [textures[name] for name in ("roughness", "uncertainty") if name in textures]
    stack = np.dstack([textures["albedo_linear"], *planes])
    layers = []
    for camera in cameras:
        size = (sub_pixels * camera.width, sub_pixels * camera.height)
        seen = caster.cast(camera.resized(*size))
        material = np.zeros((*seen.hit.shape, stack.shape[-1]))
        material[seen.hit] = sample_texture(stack, seen.uv[seen.hit], inside, mesh.cells)
        centre = (slice(sub_pixels // 2, None, sub_pixels),) * 2
        hit = seen.hit[centre]
        share = np.maximum(_pixel_means(seen.hit[..., None].astype(float), sub_pixels), 1e-9)
        normal = _pixel_means(seen.normal, sub_pixels)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        material = _pixel_means(material, sub_pixels) / share
        normal[~hit], material[~hit] = 0.0, 0.0
        parts: dict[str, Any] = {"albedo_linear": material[..., :3], "roughness": material[..., 3]}
        parts["uncertainty"] = material[..., 4] if "uncertainty" in textures else None
        layers.append(Layers(hit=hit, position=seen.position[centre], normal=normal, **parts))
    return tuple(layers)


def _pixel_means(image: Array, side: int) -> Array:
    """Means over the `side` by `side` sub-pixels of every pixel, (H, W, C)."""
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean(axis=(1, 3))
