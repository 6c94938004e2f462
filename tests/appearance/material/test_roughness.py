# SPDX-License-Identifier: Apache-2.0
"""No highlights, one roughness, or one per patch: what is chosen where the answer is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from robir.appearance.blocks import block_numbers
from robir.appearance.material.highlights import LEVELS, Highlights
from robir.appearance.material.roughness import (
    DULL,
    EACH,
    GLOSSY,
    MATTE,
    ONE,
    Patches,
    choose_roughness,
)
from robir.appearance.proof import Proof

VIEWS = 12.0


def peaks(roughness, count=12, seed=0):
    """Near views (N,), what they show and what every level predicts, (N, L); noise of others.

    A view in ten is at the middle of a highlight as bright as the roughness has it.
    """
    rng = np.random.default_rng(seed)
    sample = np.repeat(np.arange(len(roughness)), count)
    at = np.where(rng.random(len(sample)) < 0.1, 1.0, 0.1 * rng.random(len(sample)))
    height = 0.01 * np.array([*LEVELS]) ** -4.0 / (1 + 0.05 * np.array([*LEVELS]) ** -4.0)
    true = 0.01 * roughness**-4.0 / (1 + 0.05 * roughness**-4.0)
    seen = np.repeat((true[sample] * at)[:, None], len(LEVELS), axis=1)
    noise = 0.001 * rng.standard_normal((len(sample), len(LEVELS)))
    return {
        "sample": sample,
        "seen": seen.astype(np.float32),
        "predicted": (height * at[:, None]).astype(np.float32),
        "other": sample,
        "noise": noise.astype(np.float32),
    }


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
    near = peaks(roughness if plain > 0 else np.full(count, 4.0), int(VIEWS), seed)
    highlights = Highlights(error=errors[:, :-1], plain=errors[:, -1], count=views, **near)
    return highlights, position.astype(np.float32)


@dataclass
class FakeTrial:
    """Errors of every sample, as `surface` has them, in each of VIEWS views."""

    errors: np.ndarray
    position: np.ndarray

    def rays_of(self, chosen):
        return np.flatnonzero(np.repeat(chosen, int(VIEWS)))

    def paint_errors(self, chosen, level):
        sample = chosen // int(VIEWS)
        if level is None:
            return self.errors[sample, -1] / VIEWS
        rows = [np.interp(r, LEVELS, e[:-1]) for r, e in zip(level, self.errors, strict=True)]
        return np.array(rows)[sample] / VIEWS

    def proof(self, chosen, plain, rich):
        block = block_numbers(self.position[chosen // int(VIEWS)])
        return Proof.of(plain, rich, (block,))


def answers(highlights, position, material, num_materials=3):
    # patches of no likeness to each other
    features = 9.0 * np.eye(num_materials)
    trial = FakeTrial(np.column_stack([highlights.error, highlights.plain]), position)
    paint = np.ones(len(material), bool)
    choice = choose_roughness(highlights, Patches(features, material), trial, paint)
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
    assert choices[1].held_out_error == pytest.approx(255 * 0.012**0.5, rel=0.2)
    assert choices[1].cost_seconds >= 0


def test_unlike_materials_have_their_own(material):
    true = np.array([0.2, 0.42, 0.72])
    highlights, position = surface(true[material], 0.004, 0.02)
    specular, kind, roughness, _ = answers(highlights, position, material)
    assert (specular, kind) == (GLOSSY, EACH)
    np.testing.assert_allclose(roughness, true, atol=0.06)


def test_without_highlights_there_are_none(material):
    """Every level fits worse than none at all, and the roughness says matte."""
    highlights, position = surface(np.full(1500, 0.9), 0.004, -0.003)
    specular, kind, roughness, _ = answers(highlights, position, material)
    assert (specular, kind) == (DULL, ONE)
    np.testing.assert_array_equal(roughness, MATTE)
