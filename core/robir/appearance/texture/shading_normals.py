# SPDX-License-Identifier: Apache-2.0
"""Vertex normals under which the evened albedo repeats the photographs.

Evening takes out of the albedo what a slightly wrong normal had put in; rendered with that wrong
normal the surface is then as wrong as before, and the photographs are no longer repeated. So what
was taken out is given to the normals: each is turned as little as explains it, more where normals
vary and the mesh may be wrong, hardly on a plane. This is shape from shading about a known shape
(Wu et al. 2011, "High-quality shape from multi-view stereo and shading under general
illumination"). The surface, visibility and all that was solved with them stay as they are.

Batch letters: N texels, V vertices, S samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg

from robir.appearance.light.lobes import sky_radiance
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.texture.config import ShadingNormalsConfig
from robir.appearance.texture.texels import Blend, TexelAlbedo, Texels, sun_transfer
from robir.geometry.mesh.triangles import Mesh
from robir.maths.vectors import orthonormal_frame
from robir.transport.surfels import interpolate

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]


def shading_normals(
    problem: Problem,
    light: Light,
    mesh: Mesh,
    atlas: tuple[NDArray[np.int32], Floats],
    values: TexelAlbedo,
) -> Floats:
    """Normals (V, 3) of the mesh's vertices, unit, with which it is to be rendered.

    Light that other surfaces send is taken to be the same from all sides.

    Args:
        problem: Scene under the chosen tone curve.
        light: Solved light.
        mesh: Unwrapped, unit frame.
        atlas: Face (N,) and barycentric coordinates (N, 3) of the texels.
        values: Of the texels, baked with the mesh's own normals.
    """
    config = problem.scene.config.texture
    limits = config.shading_normals
    usable = (values.coverage > 0) & (values.metallic < 0.5)
    rows = np.flatnonzero(usable)[:: config.texels.step]
    if len(rows) < len(mesh.normals):  # of a finer mesh than the texels hardly a normal is asked
        return mesh.normals
    face, barycentric = atlas[0][rows], atlas[1][rows]
    position, normal = interpolate(mesh, face, barycentric)
    slope = _log_slope(problem, light, Texels(position=position, normal=normal))
    taken = np.log(values.read[rows] / values.albedo[rows]).mean(1)
    wanted = np.expm1(taken.clip(-limits.most_change, limits.most_change))
    certainty = 1 / (limits.read_error**2 + values.unknown[rows] ** 2)
    error = (limits.error_ratio * _variation(mesh)).clip(limits.least_error, limits.most_error)
    place = (mesh.faces[face], barycentric)
    turn = _least_turn(mesh, place, slope, (wanted, certainty), error, limits)
    length = np.linalg.norm(turn, axis=1, keepdims=True).clip(1e-9)
    turned = mesh.normals + turn * (limits.most_turn * np.tanh(length / limits.most_turn) / length)
    return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)


def _log_slope(problem: Problem, light: Light, texels: Texels) -> Floats:
    """Gradient (N, 3) of the log of mean irradiance by the normal, 1 / radian, tangential."""
    scene = problem.scene
    blend = Blend(problem, texels)
    sun = light.amplitudes.sharp.numpy()
    rays = 2 * scene.config.light.problem.sun_ray_pairs
    lit = sun_transfer(problem, light, texels, light.sharpness, rays)
    soft = blend(scene.soft @ light.amplitudes.soft + problem.indirect)
    irradiance = (soft + lit @ sun).mean(1)
    least_cosine = scene.config.texture.shading_normals.least_cosine
    facing = np.maximum(texels.normal @ light.axes.T, least_cosine)
    arriving = (lit / facing).clip(0, 1) * sun.mean(1)
    slope = blend(_sky_vector(problem, light)) + arriving @ light.axes
    slope -= (slope * texels.normal).sum(1, keepdims=True) * texels.normal
    return (slope / np.maximum(irradiance, 1e-6)[:, None]).astype(np.float32)


def _sky_vector(problem: Problem, light: Light) -> torch.Tensor:
    """Vector irradiance (S, 3) of the visible sky at the samples, mean over the channels.

    Its product with a normal is the irradiance as long as the same directions are above it.
    """
    visibility = problem.scene.transport.visibility
    directions = torch.from_numpy(visibility.directions)
    radiance = sky_radiance(directions, light.amplitudes.soft.mean(1))
    arriving = radiance[:, None] * directions * (4 * np.pi / len(directions))
    parts = []
    for start in range(0, len(visibility.bits), 4096):
        some = visibility.bits[start : start + 4096]
        bits = np.unpackbits(some, axis=1, count=len(directions))  # none below the horizon
        parts.append(torch.from_numpy(bits).float() @ arriving)
    return torch.cat(parts)


def _variation(mesh: Mesh) -> Reals:
    """Root mean square difference (V,) of a vertex's normal from those along its edges."""
    one = mesh.faces.ravel()
    squared = np.zeros(len(mesh.normals))
    for shift in (1, 2):
        other = np.roll(mesh.faces, shift, axis=1).ravel()
        apart = ((mesh.normals[one] - mesh.normals[other]) ** 2).sum(1)
        squared += np.bincount(one, apart, len(squared))
    return np.sqrt(squared / np.maximum(2 * np.bincount(one, minlength=len(squared)), 1))


def _least_turn(
    mesh: Mesh,
    place: tuple[NDArray[np.int32], Floats],
    slope: Floats,
    measured: tuple[Reals, Reals],
    error: Reals,
    config: ShadingNormalsConfig,
) -> Reals:
    """Tangential change (V, 3) of normals that best explains changes of irradiance.

    Texels about one vertex are wrong together: all of them count as one measurement.

    Args:
        mesh: The mesh.
        place: Vertices (N, 3) about each texel and what each of them counts there, (N, 3).
        slope: (N, 3) gradient of log irradiance by the normal.
        measured: Relative change of irradiance (N,) and the inverse of its variance (N,).
        error: (V,) standard deviation of the normals before anything is measured, radians.
        config: Of the conjugate gradients.
    """
    corners, share = place
    wanted, certainty = measured
    frame = torch.stack(orthonormal_frame(torch.from_numpy(mesh.normals)), dim=1).numpy()
    steepness = np.einsum("nd,nkad->nka", slope, frame[corners]) * share[..., None]
    count = len(wanted)
    columns = 2 * corners[..., None] + np.arange(2)
    row_of = np.repeat(np.arange(count), 6)
    matrix = csr_matrix(
        (steepness.ravel(), (row_of, columns.ravel())), shape=(count, 2 * len(error))
    )
    crowd = np.maximum(np.bincount(corners.ravel(), share.ravel(), len(error)), 1.0)
    weight = certainty / np.einsum("nk,nk->n", share, crowd[corners])
    system = matrix.T @ (diags(weight) @ matrix) + diags(np.repeat(1 / error**2, 2))
    measured_turn = matrix.T @ (weight * wanted)
    turn, _ = cg(system, measured_turn, rtol=config.tolerance, maxiter=config.rounds)
    return np.einsum("va,vad->vd", turn.reshape(-1, 2), frame)
