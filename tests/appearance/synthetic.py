# SPDX-License-Identifier: Apache-2.0
"""Baked scenes whose light, albedo and gloss are known, made with exact transport.

No pictures are drawn: what a camera would see of each surface sample is computed from the
rendering equation and put through a tone curve straight into the observations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from transport.shapes import box, mesh_of, patch

from robir.appearance.light.lobes import Amplitudes, soft_lobes
from robir.appearance.light.problem import Scene, make_scene
from robir.appearance.light.solver import Light
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.maths import microfacet
from robir.maths.tone_curve import AbstractToneCurve
from robir.maths.vectors import fibonacci_sphere
from robir.transport.baked import Transport
from robir.transport.observe import Observations
from robir.transport.surfels import Surfels, sample_surfels
from robir.transport.visibility import (
    Visibility,
    lobe_directions,
    lobe_transfer,
    trace_visibility,
)

OFFSET = 0.003
NUM_SOFT = 24
SUN = np.float32([0.48, -0.36, 0.8])
SUN_SHARPNESS = 2000.0
WARM, COOL = np.float32([1.0, 0.93, 0.85]), np.float32([0.8, 0.9, 1.0])
PALETTE = np.float32([[0.55, 0.5, 0.45], [0.2, 0.3, 0.12], [0.4, 0.15, 0.12], [0.7, 0.7, 0.72]])

Corner = tuple[float, float, float]
Boxes = tuple[tuple[Corner, Corner], ...]
# lowest and highest corner of each
TWO_BOXES: Boxes = (
    ((-0.35, -0.3, 0.0), (0.05, 0.1, 0.4)),
    ((0.25, 0.2, 0.0), (0.5, 0.45, 0.6)),
)


@dataclass(frozen=True)
class Material:
    """What a part of a ball is made of."""

    base: np.ndarray  # (3,) albedo, or base colour of a metal, linear Rec.709
    roughness: float  # perceptual
    # f0 of the layer above the diffuse one, 1 for a metal, 0 where there is none
    specular: float = 0.04


@dataclass(frozen=True)
class Stage:
    """Geometry with its transport and albedo; light comes later."""

    mesh: Mesh  # floor and two boxes
    tracer: EmbreeTracer  # of the mesh
    surfels: Surfels  # samples
    visibility: Visibility  # of the samples
    albedo: np.ndarray  # (S, 3), constant in pieces


def boxes_on_a_floor(num_surfels: int = 1500, boxes: Boxes = TWO_BOXES) -> Stage:
    """Boxes on a chequered floor, inside the unit sphere."""
    mesh = mesh_of(
        patch((-0.75, -0.75, 0), (1.5, 0, 0), (0, 1.5, 0), 30),
        *(side for low, high in boxes for side in box(low, high)),
    )
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    surfels = sample_surfels(mesh, num_surfels, np.random.default_rng(0))
    directions = fibonacci_sphere(256).numpy().astype(np.float32)
    visibility = trace_visibility(mesh, tracer, surfels, directions, OFFSET)
    x, y, z = surfels.position.T
    square = (np.floor(x / 0.5 + 0.5) + 2 * np.floor(y / 0.5 + 0.5)).astype(int) % 3
    piece = np.where(z < 1e-4, square, np.where(x < 0.1, 3, 1))
    return Stage(mesh, tracer, surfels, visibility, PALETTE[piece])


def sun_transfer(
    stage: Stage, axis: np.ndarray = SUN, sharpness: float = SUN_SHARPNESS
) -> np.ndarray:
    """Visibility times cosine of a sun at all samples, (S,)."""
    rays = lobe_directions(axis, sharpness, 24)
    surfels = stage.surfels
    return lobe_transfer(stage.tracer, surfels.position, surfels.normal, rays, OFFSET)


def direct(stage: Stage, sun: float, sky: float) -> np.ndarray:
    """Irradiance (S, 3) of a warm sun and a cool, even sky of the model's own soft lobes."""
    visibility = stage.visibility
    cosine = (stage.surfels.normal @ visibility.directions.T).clip(0)
    axes, sharpness = soft_lobes(NUM_SOFT)
    lobes = np.exp(sharpness * (visibility.directions @ axes.numpy().T - 1)).sum(1)
    weight = visibility.unpacked() * cosine * (4 * np.pi / len(visibility.directions))
    return (weight @ lobes)[:, None] * (sky * COOL) + sun_transfer(stage)[:, None] * (sun * WARM)


def exitant(stage: Stage, irradiance: np.ndarray) -> np.ndarray:
    """Radiance (S, 3) with all bounces, R = a / pi (E + G R)."""
    radiance = stage.albedo * irradiance / np.pi
    for _ in range(30):
        radiance = stage.albedo / np.pi * (irradiance + stage.visibility.bounce @ radiance)
    return radiance


def observed(radiance: np.ndarray, curve: AbstractToneCurve, positions: np.ndarray) -> Observations:
    """Radiance (S, V, 3) as 8-bit photographs would hold it, every sample in every view."""
    shown = curve.display_from_linear(torch.from_numpy(radiance.astype(np.float32)))
    display = np.rint(255 * shown.clamp(0, 1).numpy()).astype(np.uint8)
    return Observations(
        display=display,
        weight=np.ones(display.shape[:2], np.float32),
        clipped=display == 255,
        off_axis=np.zeros(display.shape[:2], np.uint8),
        positions=positions.astype(np.float32),
        views=tuple(map(str, range(len(positions)))),
    )


def scene_of(
    stage: Stage, sun: float, sky: float, curve: AbstractToneCurve, num_rows: int = 2000
) -> Scene:
    """A scene lit by sun and sky, photographed from three places."""
    return lit(stage, direct(stage, sun, sky), curve, num_rows)


def lit(
    stage: Stage, irradiance: np.ndarray, curve: AbstractToneCurve, num_rows: int = 2000
) -> Scene:
    """A scene under a given direct light (S, 3), photographed from three places."""
    radiance = exitant(stage, irradiance)
    seen = observed(np.repeat(radiance[:, None], 3, 1), curve, 3 * np.eye(3))
    transport = Transport(surfels=stage.surfels, visibility=stage.visibility, observations=seen)
    rng = np.random.default_rng(1)
    return make_scene(transport, stage.tracer, OFFSET, (num_rows, NUM_SOFT), rng)


def true_light(sun: float, sky: float) -> Light:
    """The light of `scene_of` in the model's own terms."""
    return Light(
        axes=SUN[None],
        sharpness=np.float32([SUN_SHARPNESS]),
        amplitudes=Amplitudes(
            soft=torch.from_numpy(np.tile(sky * COOL, (NUM_SOFT, 1))).float(),
            sharp=torch.from_numpy(sun * WARM)[None].float(),
        ),
        loss=0.0,
        history=(),
    )


def sun_and_uneven_sky() -> Light:
    """A sky brighter towards +x, and a sun."""
    axes, _ = soft_lobes(NUM_SOFT)
    soft = 0.12 * torch.exp(1.2 * axes[:, :1]) * torch.tensor([[0.8, 0.9, 1.0]])
    return Light(
        axes=np.float32([[0.6, 0.0, 0.8]]),
        sharpness=np.float32([SUN_SHARPNESS]),
        amplitudes=Amplitudes(soft=soft, sharp=torch.full((1, 3), 3.0)),
        loss=0.0,
        history=(),
    )


def ball(
    parts: list[tuple[Callable[[np.ndarray], np.ndarray], Material]],
    light: Light,
    curve: AbstractToneCurve,
    count: int = 700,
) -> tuple[Scene, np.ndarray]:
    """A lone ball, photographed from all around.

    Args:
        parts: Materials, each with what tells from positions (S, 3) whether it is there.
        light: Its light.
        curve: What the photographs went through.
        count: About how many samples.

    Returns:
        The scene and the radiance (S, V, 3) of every observation.
    """
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    surfels = sample_surfels(mesh, count, np.random.default_rng(0))
    directions = fibonacci_sphere(512).numpy().astype(np.float32)
    visibility = trace_visibility(mesh, tracer, surfels, directions, 0.01)
    positions = 3 * fibonacci_sphere(14).numpy().astype(np.float32)
    radiance = np.zeros((len(surfels), len(positions), 3), np.float32)
    for is_there, material in parts:
        chosen = is_there(surfels.position)
        places = surfels.position[chosen], surfels.normal[chosen]
        radiance[chosen] = ball_radiance(places, material, light, positions)
    seen = observed(radiance, curve, positions)
    towards = positions - surfels.position[:, None]
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    cosine = np.einsum("svk,sk->sv", towards, surfels.normal)
    seen.weight[:] = np.where(cosine > 0.2, cosine, 0)
    transport = Transport(surfels=surfels, visibility=visibility, observations=seen)
    rng = np.random.default_rng(0)
    return make_scene(transport, tracer, 0.01, (2000, NUM_SOFT), rng), radiance


def ball_radiance(
    places: tuple[np.ndarray, np.ndarray], material: Material, light: Light, positions: np.ndarray
) -> np.ndarray:
    """Radiance (S, V, 3) of an unshadowed surface; the light integrated over 2048 directions.

    Args:
        places: Positions (S, 3) and normals (S, 3).
        material: Of all of them.
        light: Theirs.
        positions: (V, 3) of the cameras; 0 is seen from behind.
    """
    directions = fibonacci_sphere(2048)
    axes, sharpness = soft_lobes(NUM_SOFT)
    sky = torch.exp(sharpness * (directions @ axes.T - 1)) @ light.amplitudes.soft
    sky = sky * (4 * np.pi / len(directions))
    # The sun is one more direction, with its irradiance for a weight.
    directions = torch.cat([directions, torch.from_numpy(light.axes)])
    arriving = torch.cat([sky, light.amplitudes.sharp])
    position, normal = map(torch.from_numpy, places)
    cosine = (normal @ directions.T).clamp(min=0)
    base, rough, f0 = (
        torch.from_numpy(material.base),
        torch.tensor(material.roughness),
        material.specular,
    )
    diffuse = base / np.pi * (cosine @ arriving)
    radiance = torch.zeros(len(normal), len(positions), 3)
    for view, place in enumerate(torch.from_numpy(positions)):
        view_dir = torch.nn.functional.normalize(place - position, dim=1)
        seen = (view_dir * normal).sum(1) > 0
        view_dir, facing = view_dir[seen], normal[seen]
        lobe = microfacet.specular_brdf(
            directions[None], view_dir[:, None], facing[:, None], rough, torch.tensor([f0])
        )[..., 0]
        above = (lobe * cosine[seen]) @ arriving
        # What the specular layer reflects of even light does not reach the diffuse layer.
        scale, bias = microfacet.environment_brdf((view_dir * facing).sum(1), rough)
        below = (1 - f0 * scale - bias)[:, None] * diffuse[seen]
        shown = {0.0: diffuse[seen], 1.0: base * above}.get(f0, below + above)
        radiance[seen, view] = shown
    return radiance.numpy()
