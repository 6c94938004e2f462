# SPDX-License-Identifier: Apache-2.0
"""A result's surface and material as a camera sees them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import Bounds
from robir.evaluation.surfaces import MeshCaster, sample_texture
from robir.geometry.mesh import Mesh
from robir.jobs.paths import JobPaths

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layers:
    """Images of one view; 0 where the camera misses the mesh.

    Attributes:
        hit: (H, W) bool.
        position: (H, W, 3), frame of the mesh.
        normal: (H, W, 3), unit, world.
        albedo_linear: (H, W, 3), linear Rec.709.
        roughness: (H, W), perceptual.
    """

    hit: NDArray[np.bool_]
    position: Array
    normal: Array
    albedo_linear: Array
    roughness: Array


def result_mesh(paths: JobPaths, bounds: Bounds) -> Mesh:
    """The reconstructed mesh in the capture's own frame and unit."""
    mesh = Mesh.load(paths.stage("geometry") / "mesh.npz")
    vertices = mesh.vertices * bounds.radius + bounds.centre
    return replace(mesh, vertices=vertices.astype(np.float32))


def load_textures(paths: JobPaths) -> dict[str, Array]:
    """Arrays of the appearance stage's textures.npz by name."""
    with np.load(paths.stage("appearance") / "textures.npz", allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def view_layers(
    mesh: Mesh, textures: dict[str, Array], cameras: Iterable[Camera]
) -> tuple[Layers, ...]:
    """What each camera sees.

    Args:
        mesh: Unwrapped, in the cameras' frame.
        textures: "albedo_linear" (T, T, 3), "roughness" (T, T) and "inside" (T, T).
        cameras: In the mesh's frame.
    """
    caster = MeshCaster(mesh)
    inside = textures["inside"].astype(bool)
    stack = np.concatenate([textures["albedo_linear"], textures["roughness"][..., None]], axis=-1)
    layers = []
    for camera in cameras:
        seen = caster.cast(camera)
        material = np.zeros((*seen.hit.shape, 4))
        material[seen.hit] = sample_texture(stack, seen.uv[seen.hit], inside)
        layers.append(
            Layers(
                hit=seen.hit,
                position=seen.position,
                normal=seen.normal,
                albedo_linear=material[..., :3],
                roughness=material[..., 3],
            )
        )
    return tuple(layers)
