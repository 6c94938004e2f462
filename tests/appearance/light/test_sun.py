# SPDX-License-Identifier: Apache-2.0
"""The search for a sun's direction, on boxes whose sun is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light import sun, sun_search
from robir.appearance.light.problem import make_problem
from robir.appearance.light.sun import SunCandidate, SunProblem, lowest_point, refine, scan
from robir.appearance.light.sun_search import find_suns, polish
from robir.maths.tone import curve_from_name

SUN, SKY = 2.4, 0.12


@pytest.fixture(scope="module")
def problem():
    curve = curve_from_name("filmic")
    return make_problem(synthetic.scene_of(synthetic.boxes_on_a_floor(), SUN, SKY, curve), curve)


@pytest.fixture(scope="module")
def scanned(problem):
    scene = problem.scene
    normal = scene.transport.surfels.normal[scene.rows]
    pairs = scene.pairs.facing_alike(normal, sun_search._ALIKE_COSINE)
    sky = scene.soft.sum(1)[:, None].expand(-1, 3)
    return SunProblem.of(problem, sky, scene.rows, pairs)


def degrees(first, second) -> float:
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def test_every_direction_is_the_rival_of_one_light_at_most(scanned):
    candidates = scan(scanned, 1000, 20)
    assert len(candidates) > 5 and 3 < len(candidates[0].alternatives) <= sun._NUM_ALTERNATIVES
    for candidate in candidates:
        same = candidate.alternatives @ candidate.axis
        assert (same > np.cos(sun.SEPARATION)).all() and (same < 0.9999).all()
    every = np.concatenate([np.stack([c.axis, *c.alternatives]) for c in candidates])
    assert len(np.unique(every, axis=0)) == len(every)


def test_a_rival_that_more_samples_prefer_is_the_sun(scanned):
    low = synthetic.SUN - np.float32([0, 0, 0.3])
    low /= np.linalg.norm(low)
    near = synthetic.SUN + np.float32([0.05, 0, 0])
    rivals = np.stack([near / np.linalg.norm(near), np.float32([0, 0, 1])])
    astray = SunCandidate(axis=low, loss=0.0, gain=0.0)
    assert degrees(low, synthetic.SUN) > 12
    assert degrees(refine(scanned, astray, 0.06).axis, synthetic.SUN) > 4
    found = refine(scanned, replace(astray, alternatives=rivals), 0.06)
    assert degrees(found.axis, synthetic.SUN) < 1


@pytest.mark.parametrize("seed", range(2))
def test_leaps_of_the_loss_do_not_move_its_lowest_point(seed):
    rng = np.random.default_rng(seed)
    tried = synthetic.SUN + 0.01 * rng.normal(size=(60, 3))
    tried = np.float32(tried / np.linalg.norm(tried, axis=1, keepdims=True))
    away = np.arccos(np.clip(tried @ synthetic.SUN, -1, 1))
    losses = 0.5 + 30 * away**2
    lowest = tried[losses.argmin()]
    assert degrees(lowest_point(lowest, tried, losses), synthetic.SUN) < 0.01
    leaping = losses + rng.uniform(0, 0.004, 60)
    lowest = tried[leaping.argmin()]
    assert degrees(lowest_point(lowest, tried, leaping), synthetic.SUN) < 0.15


def test_a_sun_is_polished_by_all_samples():
    stage, curve = synthetic.boxes_on_a_floor(), curve_from_name("filmic")
    some = make_problem(synthetic.scene_of(stage, SUN, SKY, curve, num_rows=200), curve)
    aside = synthetic.SUN + np.float32([0.03, 0.0, -0.02])
    start = replace(synthetic.true_light(SUN, SKY), axes=aside[None] / np.linalg.norm(aside))
    found = polish(some, start, AppearanceConfig(iterations=20), 0).axes[0]
    assert degrees(found, synthetic.SUN) < 0.6


@pytest.mark.parametrize("strength", [SUN, 0.0])
def test_a_sun_that_the_user_tells_is_taken_and_moved_a_little(strength):
    curve = curve_from_name("filmic")
    scene = synthetic.scene_of(synthetic.boxes_on_a_floor(), strength, SKY, curve)
    told = synthetic.SUN + np.float32([0.05, 0, 0])
    told /= np.linalg.norm(told)
    config = AppearanceConfig(iterations=60, num_scan_directions=300, num_sharp_lobes=1)
    light = find_suns(make_problem(replace(scene, sun=told), curve), config, 0)
    assert len(light.axes) == 1
    assert degrees(light.axes[0], told) < 20
    if strength:
        assert degrees(light.axes[0], synthetic.SUN) < 1.5
    else:
        assert len(find_suns(make_problem(scene, curve), config, 0).axes) == 0


@pytest.mark.parametrize(
    ("tried", "chosen"),
    [
        ([(0.9, 0.95), (0.3, 0.98)], 1),  # a shadow that shows comes first
        ([(0.3, 0.97), (0.5, 0.96)], 1),  # of two that show the lower loss
        ([(0.3, 1.2), (0.95, 0.9)], 1),  # one lowers the loss, the other does not
        ([(0.45, 1.05), (0.3, 1.1)], 1),  # none does: the plainest shadow
        ([(0.7, 1.05)], None),
        ([], None),
    ],
)
def test_a_plain_shadow_tells_a_sun_that_lowers_no_other_difference(monkeypatch, tried, chosen):
    """Of (what is left of the differences across its shadow, loss), where it was 1 without a sun"""
    axes = np.eye(3, dtype=np.float32)[: len(tried)]
    lights = [SimpleNamespace(loss=loss, left=left) for left, loss in tried]

    def fitted(_, axis, *rest):
        return lights[int(axis[-1].argmax())]

    monkeypatch.setattr(sun_search, "fit", fitted)
    monkeypatch.setattr(sun_search, "_left_across_shadow", lambda _, before, after: after.left)
    before = SimpleNamespace(axes=axes[:0], sharpness=np.zeros(0, np.float32), loss=1.0)
    problem = SimpleNamespace(scene=SimpleNamespace(sun=None))
    candidates = [SunCandidate(axis=axis, loss=1.0, gain=0.0) for axis in axes]
    best = sun_search._best_addition(problem, before, candidates, 1)
    assert (best and best[1]) is (None if chosen is None else lights[chosen])
