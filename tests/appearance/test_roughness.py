# SPDX-License-Identifier: Apache-2.0
"""No highlights, one roughness, or one per material: what is chosen where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from robir.appearance.roughness import (
    DULL,
    EACH,
    GLOSSY,
    LEVELS,
    MATTE,
    MIN_HIGHLIGHTS,
    ONE,
    UNKNOWN,
    Highlights,
    choose_roughness,
    lowest_cost,
)

VIEWS = 12.0


def surface(roughness, noise, plain, seed=0):
    """Samples of a unit square whose errors are lowest at their roughness, block by block noisy.

    Args:
        roughness: (N,) of each sample.
        noise: Deviation of the errors between blocks.
        plain: Error a view without highlights, on top of the least with one.
        seed: Of the noise.
    """
    rng = np.random.default_rng(seed)
    count = len(roughness)
    position = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), np.zeros(count)])
    block = np.floor(position[:, :2] / 0.2 + 10).astype(int) @ [100, 1]
    level = 0.01 + 0.08 * (np.log(np.array(LEVELS)) - np.log(roughness)[:, None]) ** 2
    # the mesh is better in some places than in others, for all models
    level += 0.004 * rng.random(2000)[block, None]
    lowest = level.min(1)
    level += noise * rng.standard_normal((2000, len(LEVELS)))[block]
    errors = VIEWS * np.column_stack([level, lowest + plain]).clip(0).astype(np.float32)
    views = np.full(count, VIEWS, np.float32)
    return Highlights(errors[:, :-1], errors[:, -1], views), position.astype(np.float32)


def answers(highlights, position, material, num_materials=3):
    choice = choose_roughness(highlights, material, position, num_materials)
    specular, roughness = choice.choices
    assert [one.choice for one in choice.choices] == ["specular", "roughness"]
    assert specular.alternatives == (GLOSSY if specular.chosen == DULL else DULL,)
    assert roughness.alternatives == (ONE if roughness.chosen == EACH else EACH,)
    assert choice.has_highlights == (specular.chosen == GLOSSY)
    return specular.chosen, roughness.chosen, choice.roughness, choice.choices


@pytest.fixture
def material():
    return np.random.default_rng(5).integers(0, 3, 1500)


def test_alike_materials_share_one_roughness(material):
    kinds = []
    for seed in range(12):
        highlights, position = surface(np.full(1500, 0.42), 0.004, 0.02, seed)
        kinds.append(answers(highlights, position, material)[1])
    # chance alone goes beyond one standard error now and then
    assert kinds.count(ONE) >= 10
    highlights, position = surface(np.full(1500, 0.42), 0.004, 0.02)
    specular, kind, roughness, choices = answers(highlights, position, material)
    assert (specular, kind) == (GLOSSY, ONE)
    np.testing.assert_allclose(roughness, 0.42, atol=0.06)
    assert len(set(roughness)) == 1
    # what it costs in codes, as if nothing of it had been fitted
    assert choices[1].held_out_error == pytest.approx(255 * 0.012, rel=0.2)
    assert 0 <= choices[1].cost_seconds < 0.5


def test_unlike_materials_have_their_own(material):
    true = np.array([0.2, 0.42, 0.72])
    highlights, position = surface(true[material], 0.004, 0.02)
    specular, kind, roughness, _ = answers(highlights, position, material)
    assert (specular, kind) == (GLOSSY, EACH)
    np.testing.assert_allclose(roughness, true, atol=0.06)


def test_without_highlights_there_are_none(material):
    """No level fits better than none at all, and the roughness says matte."""
    for plain in (0.0, -0.003):
        highlights, position = surface(np.full(1500, 0.9), 0.004, plain)
        specular, kind, roughness, _ = answers(highlights, position, material)
        assert (specular, kind) == (DULL, ONE)
        np.testing.assert_array_equal(roughness, MATTE)


def test_a_material_that_hardly_any_view_judges_goes_half_the_way_to_the_others():
    material = np.random.default_rng(5).integers(0, 2, 1500)
    material[:4] = 2
    true = np.array([0.72, 0.9, 0.2])
    highlights, position = surface(true[material], 0.001, 0.02)
    assert highlights.of(material == 2).count.sum() < MIN_HIGHLIGHTS
    _, kind, roughness, _ = answers(highlights, position, material)
    assert kind == EACH
    np.testing.assert_allclose(roughness[:2], true[:2], atol=0.05)
    assert 0.6 < roughness[2] < 0.7


@pytest.mark.parametrize(("spoilt", "expected"), [(0, 0.2), (2, UNKNOWN)])
def test_what_no_roughness_explains_is_not_believed_to_be_rough(material, spoilt, expected):
    true = np.array([0.2, 0.3, 0.72])
    highlights, position = surface(true[material], 0.004, 0.02)
    spoilt = material == spoilt
    highlights.error[spoilt] += VIEWS * 0.03
    highlights.plain[spoilt] += VIEWS * 0.03
    _, kind, roughness, _ = answers(highlights, position, material)
    assert kind == EACH
    true[material[spoilt][0]] = expected
    np.testing.assert_allclose(roughness, true, atol=0.06)


def test_where_no_sun_is_mirrored_nothing_is_judged(material):
    none = np.zeros(1500, np.float32)
    highlights = Highlights(np.zeros((1500, len(LEVELS)), np.float32), none, none)
    position = np.zeros((1500, 3), np.float32)
    specular, kind, roughness, choices = answers(highlights, position, material)
    assert (specular, kind) == (GLOSSY, ONE)
    np.testing.assert_array_equal(roughness, UNKNOWN)
    assert choices[0].held_out_error is choices[1].held_out_error is None


def test_what_a_sample_says_takes_no_part_in_how_it_is_judged():
    """Errors that are pure chance in every block: what is fitted to some says nothing of others."""
    rng = np.random.default_rng(1)
    cell = rng.integers(0, 100, 4000)
    position = np.column_stack([0.2 * (cell // 10) + 0.1, 0.2 * (cell % 10) + 0.1, 0 * cell])
    level = 0.02 + 0.01 * rng.random((100, len(LEVELS)))[cell]
    errors = (VIEWS * level).astype(np.float32)
    highlights = Highlights(errors, 2 * errors.max(1), np.full(4000, VIEWS, np.float32))
    _, _, _, choices = answers(highlights, position.astype(np.float32), cell % 20, 20)
    # fitted to themselves they would come to the lowest of seven draws
    assert choices[1].held_out_error > 255 * 0.0244


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
