# SPDX-License-Identifier: Apache-2.0
"""What samples reflect of sky and surroundings, against sums written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.light.lobes import lobes_of
from robir.appearance.light.problem import make_problem
from robir.appearance.material.reflections import _SHARPEST_KERNEL, Reflections, as_rays, view_rays
from robir.maths import microfacet
from robir.maths.tone import curve_from_name

SUN, SKY = 2.4, 0.12


@pytest.fixture(scope="module")
def problem():
    curve = curve_from_name("filmic")
    return make_problem(synthetic.scene_of(synthetic.boxes_on_a_floor(), SUN, SKY, curve), curve)


@pytest.fixture(scope="module")
def light():
    return synthetic.sun_and_uneven_sky()


def surfaces_about(problem, row, otherwise):
    """Radiance (D, 3) that a sample sees of others; `otherwise` (3,) where it meets none."""
    transport = problem.scene.transport
    directions, position = transport.visibility.directions, transport.surfels.position
    met: list[list[np.ndarray]] = [[] for _ in directions]
    for other in transport.visibility.bounce[[row]].indices:
        towards = position[other] - position[row]
        met[int((directions @ towards).argmax())].append(problem.exitant[other].double().numpy())
    return np.array([np.mean(each, axis=0) if each else otherwise for each in met])


@pytest.mark.parametrize("roughness", [0.2, 0.5])
def test_the_sky_is_the_mean_about_the_mirror_direction(problem, light, roughness):
    transport = problem.scene.transport
    visibility, surfels = transport.visibility, transport.surfels
    rows = np.arange(3, len(surfels), 40)
    rays = view_rays(surfels, transport.observations, rows, visibility.directions)
    reflected = Reflections(problem, light, rows).from_sky(rays, roughness)[:, 1].numpy()

    directions = visibility.directions.astype(np.float64)
    soft = lobes_of(light.amplitudes, light.axes[:0], light.sharpness[:0])
    spread = np.exp(float(soft.sharpness[0]) * (directions @ soft.axis.double().numpy().T - 1))
    sky = spread @ soft.amplitude[: synthetic.NUM_SOFT].double().numpy()
    sharpness = min(_SHARPEST_KERNEL, 1 / (1.5 * roughness**4))
    scale, bias = microfacet.environment_brdf(rays.cosine, torch.full_like(rays.cosine, roughness))
    for ray in range(0, len(reflected), 7):
        row = rows[rays.sample[ray]]
        cosine = (directions @ surfels.normal[row]).clip(0)
        above, seen = cosine > 0, visibility.unpacked()[row]
        hidden = above & ~seen
        around = max(0.05, (hidden * cosine).sum() * 4 * np.pi / len(directions))
        bounced = problem.indirect[row].double().numpy() / around
        surfaces = surfaces_about(problem, row, bounced)
        arriving = seen[:, None] * sky + hidden[:, None] * surfaces
        weight = np.exp(sharpness * (directions @ directions[rays.mirror[ray]] - 1))
        expected = (weight @ arriving) / (weight @ above) * float(scale[ray] + bias[ray])
        np.testing.assert_allclose(reflected[ray], expected, rtol=2e-4)


@pytest.mark.parametrize("distance", [2.5, np.inf])
def test_a_lamp_shines_on_each_point_from_where_it_stands(problem, light, distance):
    near = replace(problem, scene=replace(problem.scene, light_distance=distance))
    transport, roughness = problem.scene.transport, 0.3
    surfels, directions = transport.surfels, transport.visibility.directions
    rows = np.arange(3, len(surfels), 40)
    rays = view_rays(surfels, transport.observations, rows, directions)
    found = Reflections(near, light, rows).from_suns(rays, roughness)
    arriving = near.scene.sharp_transfer(light.axes, light.sharpness, rows)[rays.sample, 0]
    position = torch.from_numpy(surfels.position[rows[rays.sample]]).double()
    axis = torch.from_numpy(light.axes[0]).double()
    aside = (axis if np.isinf(distance) else distance * axis - position).expand_as(position)
    wide = (roughness**4 + 0.5 / float(light.sharpness[0])) ** 0.25
    lobe = microfacet.specular_brdf(
        aside / aside.norm(dim=1, keepdim=True),
        rays.view_dir.double(),
        torch.from_numpy(surfels.normal[rows[rays.sample]]).double(),
        torch.full((len(position),), wide, dtype=torch.float64),
        torch.tensor([0.04, 1.0], dtype=torch.float64),
    )
    expected = lobe[:, :, None] * (arriving[:, None] * light.amplitudes.sharp[0])[:, None]
    assert float(expected.max()) > 0.1
    torch.testing.assert_close(found.double(), expected, rtol=2e-3, atol=1e-5)


def test_a_polished_floor_mirrors_the_one_box_that_is_bright(problem, light):
    transport = problem.scene.transport
    position, directions = transport.surfels.position, transport.visibility.directions
    bounce = transport.visibility.bounce
    other = int(np.bincount(bounce.indices).argmax())
    row = int(bounce[:, [other]].tocoo().row[0])
    exitant = torch.full_like(problem.exitant, 0.01)
    exitant[other] = 5.0
    towards = position[other] - position[row]
    column = int((directions @ towards).argmax())
    bright = Reflections(replace(problem, exitant=exitant), light, np.array([row]))
    normal = transport.surfels.normal[[row]].astype(np.float32)

    def mirrored(direction):
        view = 2 * (normal[0] @ direction) * normal[0] - direction
        rays = as_rays(np.zeros(1, np.int64), np.zeros(1, np.int64), view[None], normal, directions)
        return float(bright.from_sky(rays, 0.12)[0, 1, 0])

    met = bounce[[row]].indices
    away = min((position[met] - position[row]), key=lambda step: float(step @ towards))
    opposite = directions[int((directions @ away).argmax())]
    assert mirrored(directions[column]) > 5 * mirrored(opposite)
