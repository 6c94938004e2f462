# SPDX-License-Identifier: Apache-2.0
"""What shows photographs worse than their mean does is taken back there, and only there."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from appearance.texture.test_albedo import PAINTS, lit_floor
from scipy.spatial import cKDTree

from robir.appearance import photograph_check
from robir.appearance.material.roughness import MATTE
from robir.appearance.photograph_check import Asset, PhotographCheck, check_asset
from robir.appearance.texture.albedo import LitTexels, texel_albedo
from robir.steps import Pipeline


@pytest.fixture(scope="module")
def floor():
    """A matt floor of two materials, read right; the jury that photographed it, and its reader."""
    problem, light, texels, views, specular, tracer = lit_floor(PAINTS, lambda at: at[:, 1] > 0)
    specular = replace(specular, has_highlights=False)

    lit = LitTexels.of((problem, light), texels, views, tracer)

    def read(material):
        return texel_albedo(lit, material, Pipeline())

    asset = Asset(problem=problem, light=light, specular=specular, values=read(specular))
    return asset, PhotographCheck(problem, texels, views, tracer), read, texels


def seen_half(floor):
    asset, _, _, texels = floor
    return (texels.position[:, 1] > 0.1) & (asset.values.coverage == 3)


def test_nothing_is_taken_back_from_what_is_right(floor):
    asset, check, read, texels = floor
    word = check_asset(check, asset, read, texels)
    assert word.asset is asset
    assert word.taken_back == {"metal": 0.0, "specular": 0.0, "smoothing": 0.0}
    assert word.unexplained == 0.0 and word.worst < 0.5
    assert word.choice.chosen == "nothing"


def test_metal_that_photographs_do_not_show_becomes_a_dielectric(floor):
    asset, check, read, texels = floor
    surfels = asset.problem.scene.transport.surfels
    half = surfels.position[:, 1] > 0
    specular = replace(
        asset.specular,
        metallic=half.astype(np.float32),
        roughness=np.where(half, np.float32(0.3), asset.specular.roughness),
        metal=np.full_like(asset.specular.metal, 0.9),
    )
    wrong = replace(asset, specular=specular, values=read(specular))
    assert check.loss(wrong).beyond(3.0).mean() > 0.2
    word = check_asset(check, wrong, read, texels)
    assert word.taken_back["metal"] > 0.2
    assert word.unexplained == 0.0
    inner = seen_half(floor)
    assert word.asset.values.metallic[inner].max() == 0
    np.testing.assert_allclose(word.asset.values.albedo[inner].mean(0), PAINTS[1], rtol=0.05)
    assert "metal" in word.choice.chosen


def glossy_of(asset, read):
    count = len(asset.specular.roughness)
    roughness = np.full(count, 0.3, np.float32)
    specular = replace(asset.specular, has_highlights=True, roughness=roughness)
    return replace(asset, specular=specular, values=read(specular))


def test_a_specular_layer_that_photographs_do_not_show_goes_as_a_whole(floor):
    asset, check, read, texels = floor
    word = check_asset(check, glossy_of(asset, read), read, texels)
    assert word.taken_back["specular"] == 1.0 and not word.asset.specular.has_highlights
    assert word.asset.specular.floor.max() == 0 and word.asset.specular.kept.min() == 1
    np.testing.assert_array_equal(word.asset.values.albedo, asset.values.albedo)


def test_a_specular_layer_that_photographs_show_stays(floor):
    asset, check, read, texels = floor
    glossy = glossy_of(asset, read)
    shown = np.rint(255 * check._codes(check._radiance(glossy))).astype(np.uint8)
    other = copy.copy(check)
    other._seen = replace(check._seen, display=shown)
    word = check_asset(other, glossy, read, texels)
    assert word.taken_back["specular"] == 0.0 and word.asset.specular.has_highlights


def test_a_specular_layer_that_a_part_does_not_show_fades_out_there(floor, monkeypatch):
    asset, check, read, texels = floor
    glossy = glossy_of(asset, read)
    shown, matt = (check._codes(check._radiance(one)) for one in (glossy, asset))
    monkeypatch.setattr(photograph_check, "_LOSS", 0.1)
    is_matt = check._points.position[:, 1] < -0.3
    codes = np.where(is_matt[:, None, None], matt, shown)
    other = copy.copy(check)
    other._seen = replace(check._seen, display=np.rint(255 * codes).astype(np.uint8))
    word = check_asset(other, glossy, read, texels)
    assert 0.05 < word.taken_back["specular"] < 0.6 and word.asset.specular.has_highlights
    assert word.unexplained == 0.0
    roughness = word.asset.values.roughness
    assert roughness.min() == pytest.approx(0.3) and roughness.max() == pytest.approx(MATTE)
    _, beside = cKDTree(texels.position).query(texels.position, 5)
    # an edge would be a step of all of it
    assert np.abs(roughness[beside] - roughness[:, None]).max() < 0.7 * (MATTE - 0.3)


def test_a_texture_that_was_smoothed_away_comes_back(floor):
    asset, check, read, texels = floor
    patch = (np.abs(texels.position[:, 0]) < 0.3) & (texels.position[:, 1] < -0.1)
    albedo = np.where(patch[:, None], 0.4 * asset.values.albedo, asset.values.albedo)
    wrong = replace(asset, values=replace(asset.values, albedo=albedo.astype(np.float32)))
    word = check_asset(check, wrong, read, texels)
    assert word.taken_back["smoothing"] > 0.05 and word.taken_back["metal"] == 0
    middle = patch & (np.abs(texels.position[:, 0]) < 0.15) & (texels.position[:, 1] < -0.25)
    np.testing.assert_allclose(
        word.asset.values.albedo[middle], asset.values.albedo[middle], rtol=0.02
    )


def test_what_is_given_back_fades_towards_other_blocks(floor):
    _, check, _, texels = floor
    chosen = np.arange(len(check._seeds)) % 3 == 0
    share = check.faded(chosen, texels.position, texels.normal)
    held = chosen[check.blocks(texels.position, texels.normal)]
    np.testing.assert_array_equal(share[share != 0.5] > 0.5, held[share != 0.5])
    assert (share == 1).mean() > 0.02 and (share == 0).mean() > 0.2
    _, beside = cKDTree(texels.position).query(texels.position, 5)
    steps, hard = (np.abs(of[beside] - of[:, None]).max() for of in (share, held.astype(float)))
    assert steps < 0.5 and hard == 1
    assert (check.faded(np.ones_like(chosen), texels.position, texels.normal) == 1).all()


def test_what_nothing_explains_is_reported(floor):
    asset, check, read, texels = floor
    patch = texels.position[:, 1] < -0.1
    albedo = np.where(patch[:, None], 0.4 * asset.values.albedo, asset.values.albedo)
    albedo = albedo.astype(np.float32)
    wrong = replace(asset, values=replace(asset.values, albedo=albedo, read=albedo))
    word = check_asset(check, wrong, read, texels)
    assert word.unexplained > 0.2 and word.worst > 3.0
    assert "still is" in word.choice.why
    assert word.plain["unexplained"] == word.unexplained
