# SPDX-License-Identifier: Apache-2.0
"""A spot whose paint the user knows: on a quad with a known texture, and on a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence import sent_by_known_albedo
from robir.appearance.light import known_albedo
from robir.appearance.light.known_albedo import KnownAlbedo
from robir.appearance.light.lobes import log_sent
from robir.appearance.light.problem import make_problem
from robir.errors import ConfigError
from robir.geometry.mesh.triangles import Mesh
from robir.maths.tone import curve_from_name

RED = synthetic.Material(np.float32([0.45, 0.12, 0.1]), 1.0, specular=0.0)
BLUE = synthetic.Material(np.float32([0.1, 0.25, 0.5]), 1.0, specular=0.0)


@pytest.fixture(scope="module")
def quad() -> Mesh:
    """Two by one in the plane z = 3; its texture lies in the lower half of the atlas."""
    return Mesh(
        vertices=np.float32([[0, 0, 3], [2, 0, 3], [2, 1, 3], [0, 1, 3]]),
        faces=np.int32([[0, 1, 2], [0, 2, 3]]),
        normals=np.float32([[0, 0, 1]] * 4),
        uvs=np.float32([[0, 0], [1, 0], [1, 0.5], [0, 0.5]]),
        uv_faces=np.int32([[0, 1, 2], [0, 2, 3]]),
    )


@pytest.mark.parametrize("texel", [(0.25, 0.125), (0.1, 0.45)])
def test_a_texel_is_found_on_the_mesh(quad, texel):
    known = KnownAlbedo.of(quad, (*texel, 0.5, 0.4, 0.3))
    assert known is not None
    assert known.position == pytest.approx([2 * texel[0], 2 * texel[1], 3.0], abs=1e-5)
    assert known.normal == pytest.approx([0, 0, 1])
    assert known.albedo == pytest.approx([0.5, 0.4, 0.3])


def test_a_texel_of_a_tile_is_found_in_the_cell_of_the_atlas(quad):
    # tiles 1001 and 1012: two by two cells, the second cell's lower left corner at u = .5
    tiled = replace(
        quad,
        uvs=np.float32([[0.5, 0], [1, 0], [1, 0.25], [0.5, 0.25]]),
        tiles=np.int32([1001, 1012]),
    )
    known = KnownAlbedo.of(tiled, (1.25, 1.125, 0.5, 0.4, 0.3))
    assert known.position == pytest.approx([0.5, 0.25, 3.0], abs=1e-5)
    assert known.texel == pytest.approx([0.625, 0.0625])
    with pytest.raises(ConfigError, match=r"coordinates 0\.25, 0\.125"):
        KnownAlbedo.of(tiled, (0.25, 0.125, 0.5, 0.4, 0.3))


def test_a_texel_beside_the_object_is_refused(quad):
    with pytest.raises(ConfigError, match=r"no face has the texture coordinates 0\.5, 0\.75"):
        KnownAlbedo.of(quad, (0.5, 0.75, 0.5, 0.5, 0.5))


def test_the_texels_about_a_spot(quad):
    known = KnownAlbedo.of(quad, (0.25, 0.125, 0.5, 0.5, 0.5))
    inside = np.zeros((8, 8), bool)
    inside[4:] = True
    # u .25 and v .125 of 8 texels: between columns 1 and 2, rows 6 and 7, counted from row 4
    assert set(known.texels(inside)) == {2 * 8 + 1, 2 * 8 + 2, 3 * 8 + 1, 3 * 8 + 2}
    far = np.zeros((8, 8), bool)
    far[0, 0] = True
    assert list(known.texels(far)) == [0]


@pytest.mark.parametrize("paint", [RED, BLUE])
def test_known_paint_tells_level_and_hue(paint):
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0, RED), (lambda at: at[:, 1] <= 0, BLUE)]
    problem = make_problem(synthetic.ball(halves, light, curve)[0], curve)
    at = np.float32([0.5, 0.6 if paint is RED else -0.6, 0.62])
    at /= np.linalg.norm(at)
    surfels = problem.scene.transport.surfels
    radius = np.linalg.norm(surfels.position, axis=1).mean()
    known = replace(spot_of(*paint.base), position=radius * at, normal=at)
    rows = problem.scene.rows
    wanted = log_sent(light.irradiance(problem, rows), problem.indirect[rows])
    for wrong in ([0.0, 0.0, 0.0], [0.8, 0.75, 0.85], [-1.0, -0.95, -0.9]):
        supposed = light.tinted(torch.tensor(wrong))
        assert sent_by_known_albedo(problem, supposed, known) == pytest.approx(wanted, abs=0.05)


def spot_of(*albedo):
    """A spot of some paint."""
    nowhere = np.zeros(3, np.float32)
    return KnownAlbedo(texel=(0, 0), position=nowhere, normal=nowhere, albedo=np.float32(albedo))


@pytest.mark.parametrize("albedo", [(0.18, 0.18, 0.18), (0.5, 0.03, 0.02), (0.05, 0.3, 0.6)])
def test_what_is_told_is_the_likeliest(albedo):
    read = np.float32([[0.3, 0.1, 0.09]])
    measured = np.log(read[0] / np.float32(albedo))

    # least squares for level, hues and a sheen, each with its usual size, and the readings
    sheen = known_albedo._SPECULAR / np.float32(albedo)
    reading = np.column_stack([np.ones(3), np.eye(3), sheen]) / known_albedo.READ_ERROR
    usual = np.diag([1 / known_albedo._LEVEL_SPREAD, *[1 / known_albedo._HUE_SPREAD] * 3, 1.0])
    wanted = np.concatenate([measured / known_albedo.READ_ERROR, np.zeros(5)])
    best = np.linalg.lstsq(np.concatenate([reading, usual]), wanted, rcond=None)[0]
    assert spot_of(*albedo).off(read) == pytest.approx(best[0] + best[1:4], abs=1e-4)


@pytest.mark.parametrize(
    "wrong",
    [
        (0.5, 0.5, 0.5, 0.5),
        (-0.2, 0, 0.5, 0.5, 0.5),
        (0, 0, 0.5, 0, 0.5),
        (0, 0, 1, 1, 1.5),
    ],
)
def test_what_is_no_texel_with_an_albedo_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"appearance\.white_point is"):
        AppearanceConfig(white_point=wrong)


@pytest.mark.parametrize("wrong", [(1.0, 0.0), (0.0, 0.0, 0.0)])
def test_what_is_no_direction_is_refused(wrong):
    with pytest.raises(ConfigError, match=r"appearance\.sun is"):
        AppearanceConfig(sun=wrong)
