# SPDX-License-Identifier: Apache-2.0
"""A ball, half rough plastic and half metal, rendered by quadrature of the reflection integral."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from appearance import synthetic

from robir.appearance.gloss import LEVELS, estimate_gloss, lowest_cost
from robir.appearance.light import Amplitudes, soft_lobes
from robir.appearance.problem import make_problem, make_scene
from robir.appearance.solver import Light
from robir.geometry.surface import plain_mesh
from robir.maths import microfacet
from robir.maths.tone import curve_from_name
from robir.maths.vectors import fibonacci_sphere
from robir.transport.baked import Transport
from robir.transport.surfels import sample_surfels
from robir.transport.tracer import EmbreeTracer
from robir.transport.visibility import trace_visibility

GOLD = np.float32([0.9, 0.62, 0.25])
PLASTIC = np.float32([0.12, 0.3, 0.35])
GOLD_ROUGHNESS, PLASTIC_ROUGHNESS = 0.3, 0.56
NUM_SOFT, NUM_VIEWS = 24, 14
SUN_IRRADIANCE = 3.0


def true_light() -> Light:
    """A sky brighter towards +x, and a sun."""
    axes, _ = soft_lobes(NUM_SOFT)
    soft = 0.12 * torch.exp(1.2 * axes[:, :1]) * torch.tensor([[0.8, 0.9, 1.0]])
    return Light(
        axes=np.float32([[0.6, 0.0, 0.8]]),
        sharpness=np.float32([2000]),
        amplitudes=Amplitudes(soft=soft, sharp=torch.full((1, 3), SUN_IRRADIANCE)),
        loss=0.0,
        history=(),
    )


def rendered(surfels, is_gold, light, positions) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (S, V, 3) and cosines (S, V); the light integrated over 2048 directions."""
    directions = fibonacci_sphere(2048)
    axes, sharpness = soft_lobes(NUM_SOFT)
    sky = torch.exp(sharpness * (directions @ axes.T - 1)) @ light.amplitudes.soft
    sky = sky * (4 * np.pi / len(directions))
    # The sun is one more direction, with its irradiance for a weight.
    directions = torch.cat([directions, torch.from_numpy(light.axes)])
    arriving = torch.cat([sky, light.amplitudes.sharp])
    normal, position = torch.from_numpy(surfels.normal), torch.from_numpy(surfels.position)
    gold = torch.from_numpy(is_gold)[:, None]
    cosine = (normal @ directions.T).clamp(min=0)
    diffuse = torch.from_numpy(PLASTIC) / np.pi * (cosine @ arriving)
    radiance, facing = [], []
    for place in torch.from_numpy(positions):
        view_dir = torch.nn.functional.normalize(place - position, dim=1)
        lobes = [
            microfacet.specular_brdf(
                directions[None],
                view_dir[:, None],
                normal[:, None],
                torch.tensor(roughness),
                torch.tensor([f0]),
            )[..., 0]
            for roughness, f0 in ((PLASTIC_ROUGHNESS, 0.04), (GOLD_ROUGHNESS, 1.0))
        ]
        plastic, metal = ((lobe * cosine) @ arriving for lobe in lobes)
        # What the specular layer reflects of even light does not reach the diffuse layer.
        above = (view_dir * normal).sum(1)
        scale, bias = microfacet.environment_brdf(above, torch.tensor(PLASTIC_ROUGHNESS))
        below = (1 - 0.04 * scale - bias)[:, None] * diffuse
        radiance.append(torch.where(gold, torch.from_numpy(GOLD) * metal, below + plastic))
        facing.append(above)
    return torch.stack(radiance, 1).numpy(), torch.stack(facing, 1).numpy()


@pytest.fixture(scope="module")
def ball():
    """The problem, its light and which samples are gold."""
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    surfels = sample_surfels(mesh, 700, np.random.default_rng(0))
    directions = fibonacci_sphere(512).numpy().astype(np.float32)
    visibility = trace_visibility(mesh, tracer, surfels, directions, 0.01)
    light, is_gold = true_light(), surfels.position[:, 1] > 0
    positions = 3 * fibonacci_sphere(NUM_VIEWS).numpy().astype(np.float32)
    radiance, cosine = rendered(surfels, is_gold, light, positions)
    curve = curve_from_name("filmic")
    seen = synthetic.observed(radiance, curve, positions)
    seen.weight[:] = np.where(cosine > 0.2, cosine, 0)
    transport = Transport(surfels=surfels, visibility=visibility, observations=seen)
    scene = make_scene(transport, tracer, 0.01, (2000, NUM_SOFT), np.random.default_rng(0))
    return make_problem(scene, curve), light, is_gold, radiance


def test_metal_and_plastic_are_told_apart(ball):
    problem, light, is_gold, radiance = ball
    gloss, diffuse = estimate_gloss(problem, light, 4, 0)
    seen = problem.radiance.seen.numpy()
    metallic = gloss.metallic > 0.5
    # along the border neighbours of both kinds judge together
    assert (metallic == is_gold)[seen].mean() > 0.95
    assert np.median(gloss.roughness[seen & is_gold]) == pytest.approx(GOLD_ROUGHNESS, abs=0.08)
    np.testing.assert_allclose(np.median(gloss.metal[seen & is_gold], 0), GOLD, atol=0.08)
    plastic = seen & ~is_gold
    assert np.median(gloss.roughness[plastic]) == pytest.approx(PLASTIC_ROUGHNESS, abs=0.08)
    # What is left of plastic without its highlights is Lambert's share, the same from everywhere.
    left = diffuse.numpy()[plastic]
    weight = problem.scene.transport.observations.weight[plastic] > 0
    share = np.where(weight[..., None], left, np.nan)
    spread = np.nanstd(share, axis=1) / np.nanmean(share, axis=1)
    whole = np.where(weight[..., None], radiance[plastic], np.nan)
    before = np.nanstd(whole, axis=1) / np.nanmean(whole, axis=1)
    assert np.nanmedian(spread) < 0.25 * np.nanmedian(before)
    assert sum(row["share"] for row in gloss.table) == pytest.approx(1)


@pytest.mark.parametrize(
    ("costs", "lowest", "highest"),
    [
        # a valley, with its bottom between two levels
        ((9.0, 7.0, 4.0, 3.8, 6.0, 9.0, 11.0), 0.3, 0.42),
        # no view shows the sharpest, none the roughest: the sharp one is not believed
        ((6.3, 6.8, 8.2, 8.5, 7.1, 6.5, 6.6), 0.56, 0.8),
        # it is where it does much better
        ((3.0, 4.0, 6.0, 7.0, 8.0, 9.0, 9.5), 0.12, 0.12),
        ((5.0, 4.0, 4.9, 7.0, 8.0, 9.0, 9.5), 0.17, 0.25),
    ],
)
def test_roughness_is_at_the_lowest_cost_that_photographs_can_show(costs, lowest, highest):
    assert len(costs) == len(LEVELS)
    assert lowest <= lowest_cost(np.array(costs)) <= highest
