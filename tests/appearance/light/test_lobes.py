# SPDX-License-Identifier: Apache-2.0
"""The light solve on boxes whose light, albedo and transport are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light import lobes, sun
from robir.appearance.light.lobes import (
    NO_PRIOR,
    Amplitudes,
    Priors,
    log_ratio,
    range_loss,
    soft_lobes,
    soft_transfer,
    solve_amplitudes,
    unevenness,
)
from robir.appearance.light.pair_loss import PairWeights
from robir.appearance.light.problem import make_problem, with_hidden
from robir.appearance.light.solver import fit, refit
from robir.appearance.light.sun import SunProblem, refine, scan
from robir.appearance.light.sun_search import find_suns
from robir.appearance.photometry.statistics import Pairs, Radiance, neighbour_pairs
from robir.maths.daylight import hue
from robir.maths.tone import curve_from_name

SUN, SKY = 2.4, 0.12  # irradiance of the sun at normal incidence and amplitude of each soft lobe

CONFIG = AppearanceConfig(num_scan_directions=600, num_sharp_lobes=2, iterations=90)


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor()


@pytest.fixture(scope="module")
def problem(stage):
    curve = curve_from_name("filmic")
    return make_problem(synthetic.scene_of(stage, SUN, SKY, curve), curve)


def test_elimination_gives_the_albedo_under_the_true_light(stage, problem):
    light = synthetic.true_light(SUN, SKY)
    rows = problem.scene.rows
    sharp = torch.from_numpy(synthetic.sun_transfer(stage)[rows])[:, None]
    irradiance = light.amplitudes.irradiance(problem.transfer(sharp, rows))
    log_albedo = log_ratio(problem.radiance.linear[rows], irradiance)
    # What is left is the photographs' 8 bits.
    bright = (irradiance > 0.3 * irradiance.mean(0)).all(1).numpy()
    error = log_albedo.exp().numpy() / stage.albedo[rows] - 1
    assert np.abs(error[bright]).mean() < 0.006
    assert np.abs(error[bright]).max() < 0.05


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_shadows_give_the_sky_its_strength_back(problem, factor):
    true = synthetic.true_light(SUN, SKY)
    wrong = Amplitudes(soft=factor * true.amplitudes.soft, sharp=true.amplitudes.sharp)
    mended = refit(problem, replace(true, amplitudes=wrong), NO_PRIOR, CONFIG).amplitudes
    share = (mended.soft.mean() / mended.sharp.mean()) / (SKY * synthetic.COOL.mean())
    assert float(share * SUN * synthetic.WARM.mean()) == pytest.approx(1, abs=0.06)


def test_a_brighter_light_darkens_all_albedos_alike_for_gradients_too():
    """Or deep shadows would ask for ever more sun, which seems to bring what is lit nearer."""
    irradiance = torch.tensor([4.0, 1.0, 1e-2, 1e-4])[:, None].expand(4, 3)
    brighter = torch.zeros((), requires_grad=True)
    for sample in range(4):
        values = log_ratio(torch.ones(4, 3), brighter.exp() * irradiance)
        (slope,) = torch.autograd.grad(values[sample, 0], brighter)
        assert float(slope) == pytest.approx(-1.0, abs=1e-5)


def test_log_ratio_is_exact_in_the_light_and_finite_in_the_dark():
    irradiance = torch.rand(200, 3, dtype=torch.float64) + 0.5
    albedo = torch.rand(200, 3, dtype=torch.float64) * 0.8 + 0.05
    result = log_ratio(albedo * irradiance / np.pi, irradiance).exp()
    torch.testing.assert_close(result, albedo, rtol=1.5e-3, atol=0)
    irradiance[0] = 0
    assert log_ratio(albedo / np.pi, irradiance).isfinite().all()


def test_the_sky_alone_is_pi_times_its_radiance_on_open_ground(stage):
    rows = np.flatnonzero(stage.surfels.position[:, 2] > 0.39)
    rows = rows[stage.surfels.normal[rows, 2] > 0.99]
    highest = rows[stage.surfels.position[rows, 2] > 0.59]
    soft = soft_transfer(stage.visibility, stage.surfels, 400)[highest].sum(1)
    # So many lobes make a flat sky: radiance is their number times their mean over the sphere.
    sharpness = 0.17 * 400
    radiance = 400 * (1 - np.exp(-2 * sharpness)) / (2 * sharpness)
    np.testing.assert_allclose(soft.numpy(), np.pi * radiance, rtol=0.02)


@pytest.mark.parametrize("carriers", [1, 6, 24])
def test_unevenness_counts_the_lobes_that_carry_the_sky(carriers):
    soft = torch.full((24, 3), 1e-9)
    soft[:carriers] = torch.tensor([0.2, 3.0, 7.0])
    hidden = torch.ones(24)
    assert float(unevenness(soft, hidden)) == pytest.approx(np.log(24 / carriers), abs=1e-4)


def test_paint_that_a_light_from_below_would_explain_stays_paint(stage):
    axes, _ = soft_lobes(synthetic.NUM_SOFT)
    below = int((axes[:, 2] + 0.5).abs().argmin())
    curve = curve_from_name("filmic")
    reached = synthetic.scene_of(stage, SUN, SKY, curve).soft[:, below, None].numpy()
    painted = replace(stage, albedo=stage.albedo * (0.4 + 0.6 * reached / reached.max()))
    problem = make_problem(synthetic.scene_of(painted, SUN, SKY, curve), curve)
    light = fit(problem, synthetic.SUN[None], np.float32([synthetic.SUN_SHARPNESS]), 90)
    # without the prior .59
    assert float(unevenness(light.amplitudes.soft, torch.ones(len(axes)))) < 0.3


@pytest.mark.parametrize(
    ("clipped", "expected"),
    [
        ((False, False), 0.5),
        # The darker one may be as bright as its partner.
        ((True, False), 0.0),
        # The brighter one is brighter still: wrong by at least this much.
        ((False, True), 0.5),
        ((True, True), 0.0),
    ],
)
def test_a_clipped_sample_is_only_wrong_when_it_comes_out_brighter(clipped, expected):
    log_albedo = torch.tensor([[0.2], [0.7]])
    flags = torch.tensor(clipped)[:, None]
    for first, second in ((0, 1), (1, 0)):
        pairs = Pairs(
            first=torch.tensor([first]), second=torch.tensor([second]), weight=torch.ones(1)
        )
        assert float(PairWeights.of(pairs, flags).loss(log_albedo)) == pytest.approx(expected)


def test_the_pair_loss_and_its_gradient_are_those_of_plain_look_ups():
    generator = torch.Generator().manual_seed(5)
    first, second = torch.randint(40, (2, 300), generator=generator)
    pairs = Pairs(first=first, second=second, weight=torch.rand(300, generator=generator))
    clipped = torch.rand(40, 3, generator=generator) < 0.2
    log_albedo = torch.randn(40, 3, generator=generator).requires_grad_()
    difference = log_albedo[first] - log_albedo[second]
    weight = pairs.weight[:, None]
    plain = (weight * ~clipped[second] * difference.clamp(min=0)).sum()
    plain = plain + (weight * ~clipped[first] * (-difference).clamp(min=0)).sum()
    (expected,) = torch.autograd.grad(plain, log_albedo)
    loss = PairWeights.of(pairs, clipped).loss(log_albedo)
    (gradient,) = torch.autograd.grad(3 * loss, log_albedo)
    torch.testing.assert_close(loss, plain)
    torch.testing.assert_close(gradient, 3 * expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 100, 101])
def test_what_is_too_bright_is_judged_by_a_quantile(monkeypatch, count):
    monkeypatch.setattr(lobes, "_BRIGHTEST", 0.1)
    log_albedo = torch.randn(count, 3, generator=torch.Generator().manual_seed(7)) - 1
    nothing, priors = torch.zeros(0, dtype=torch.int64), Priors()
    brightest = log_albedo.amax(1).quantile(lobes.BRIGHTEST_QUANTILE)
    expected = 2 * (brightest - np.log(0.1)).clamp(min=0)
    every = torch.arange(count)
    torch.testing.assert_close(range_loss(log_albedo, (nothing, every), priors), expected)


def test_sun_against_sky_is_recovered():
    # as many samples as a run has: where there are few, partners across a shadow lie far away
    stage, curve = synthetic.boxes_on_a_floor(4500), curve_from_name("filmic")
    problem = make_problem(synthetic.scene_of(stage, SUN, SKY, curve, 4500), curve)
    light = fit(problem, synthetic.SUN[None], np.float32([synthetic.SUN_SHARPNESS]), 100)
    top = np.flatnonzero(stage.surfels.position[:, 2] > 0.59)
    sky = (problem.scene.soft[top] @ light.amplitudes.soft).mean(0)
    true = synthetic.true_light(SUN, SKY).amplitudes
    true_sky = (problem.scene.soft[top] @ true.soft).mean(0)
    ratio = light.amplitudes.sharp[0] / sky
    np.testing.assert_allclose(ratio, true.sharp[0] / true_sky, rtol=0.05)


def test_what_pairs_do_not_tell_has_the_hue_of_lights(problem):
    """Without pairs a green sun and a magenta patch of sky come back to the line of daylight."""
    true = synthetic.true_light(SUN, SKY)
    green, magenta = torch.tensor([0.7, 1.4, 0.7]), torch.tensor([1.5, 0.6, 1.5])
    soft = true.amplitudes.soft.clone()
    soft[:3] *= magenta
    start = Amplitudes(soft=soft, sharp=true.amplitudes.sharp * green)
    rows = problem.scene.rows
    sharp = problem.scene.sharp_transfer(true.axes, true.sharpness, rows)
    none = Pairs(first=torch.zeros(0).long(), second=torch.zeros(0).long(), weight=torch.zeros(0))
    found, _ = solve_amplitudes(
        problem.rows_radiance(rows),
        problem.transfer(sharp, rows),
        (none, none),
        Priors(smooth=0.0),
        200,
        start=start,
    )

    def greenness(amplitudes):
        sky = amplitudes.soft.mean(0).log()
        return [
            float(hue(part - sky)[1].abs().mean())
            for part in (amplitudes.sharp.log(), amplitudes.soft[:3].log())
        ]

    before, after = greenness(start), greenness(found)
    assert before[0] > 0.5 and before[1] > 0.7
    assert after[0] < 0.1 * before[0]
    assert after[1] < 0.5 * before[1]


def test_scan_and_refinement_find_the_sun_within_a_degree(monkeypatch, problem):
    sun_problem = sun_problem_of(problem)
    candidates = scan(sun_problem, 1000, 3)
    losses = [candidate.loss for candidate in candidates]
    assert losses == sorted(losses) and candidates[0].gain > 0.2
    assert degrees(candidates[0].axis, synthetic.SUN) < 8
    monkeypatch.setattr(sun, "_NUM_ROUNDS", 6)
    reach = 0.8 * np.sqrt(4 * np.pi / 1000)
    found = refine(sun_problem, candidates[0], reach)
    assert found.loss < candidates[0].loss
    assert degrees(found.axis, synthetic.SUN) < 1


def sun_problem_of(problem) -> SunProblem:
    """What the scan compares, under a grey sky."""
    scene, surfels = problem.scene, problem.scene.transport.surfels
    rows = scene.rows
    rng = np.random.default_rng(0)
    return SunProblem(
        position=surfels.position[rows],
        normal=surfels.normal[rows],
        radiance=problem.rows_radiance(rows),
        base=scene.soft.sum(1)[:, None].expand(-1, 3)[rows],
        indirect=problem.indirect[rows],
        pairs=neighbour_pairs(surfels, rows, (0.05, 0.12, 0.25), 2, rng),
        tracer=scene.tracer,
        offset=scene.offset,
        distance=np.inf,
    )


def degrees(first, second) -> float:
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def test_one_sun_is_found_where_there_is_one(problem):
    light = find_suns(problem, CONFIG, 0)
    assert len(light.axes) == 1 and len(light.history) == 2
    assert degrees(light.axes[0], synthetic.SUN) < 2
    assert light.history[1] < 0.7 * light.history[0]


def test_a_sun_too_faint_for_the_scan_is_known_from_its_shadow():
    problem = problem_under(synthetic.boxes_on_a_floor(3000), 0.081, SKY, 0.0)
    assert scan(sun_problem_of(problem), 1000, 1)[0].gain < 0.001
    light = find_suns(problem, AppearanceConfig(num_sharp_lobes=1), 0)
    assert [degrees(axis, synthetic.SUN) < 3 for axis in light.axes] == [True]


@pytest.mark.parametrize(("sky", "away"), [(0.6, 1.5)])
def test_the_sun_is_found_beside_what_mirrors_a_sky(stage, sky, away):
    """Boxes as bright towards the sun as away from it, or less, as metal is, on plain ground."""
    received = synthetic.direct(stage, SUN, sky).mean(1, keepdims=True)
    mirroring = stage.albedo * (received / received.mean()).clip(0.05) ** -away
    on_ground = stage.surfels.position[:, 2:] < 1e-4
    shiny = replace(stage, albedo=np.where(on_ground, 0.4, mirroring).astype(np.float32))
    light = find_suns(problem_under(shiny, SUN, sky, 0.0), CONFIG, 0)
    assert [degrees(axis, synthetic.SUN) < 2 for axis in light.axes] == [True]


def problem_under(stage, sun, sky, lamp):
    """What is known under sun, sky and a lamp of some irradiance (S, 1) more."""
    curve = curve_from_name("filmic")
    irradiance = synthetic.direct(stage, sun, sky) + lamp
    return make_problem(synthetic.lit(stage, irradiance, curve), curve)


def test_no_sun_is_found_under_an_even_sky(stage):
    curve = curve_from_name("filmic")
    problem = make_problem(synthetic.scene_of(stage, 0.0, 0.3, curve), curve)
    light = find_suns(problem, CONFIG, 0)
    assert len(light.history) == 1
    assert light.axes.shape == (0, 3)


def test_what_no_camera_sees_is_as_dark_as_its_corner(stage, problem):
    """Hidden samples against a solve of the reflections to their end."""
    scene, total = problem.scene, problem.radiance
    seen = total.seen.clone()
    height = torch.from_numpy(stage.surfels.position[:, 2])
    upright = torch.from_numpy(np.abs(stage.surfels.normal[:, 2]) < 0.5)
    hidden = upright & (height < 0.2)
    seen[hidden] = False
    linear = total.linear.clone()
    linear[~seen] = 77.0
    found = with_hidden(scene, Radiance(linear=linear, clipped=total.clipped, seen=seen))
    assert torch.equal(found[seen], total.linear[seen])
    sky = scene.soft.sum(1)
    open_sky = (sky / sky.quantile(0.99)).clamp(max=1)[~seen, None]
    median = total.linear[seen].median(0).values
    position = torch.from_numpy(scene.transport.surfels.position)
    nearest = torch.cdist(position[~seen], position[seen]).topk(64, largest=False).indices
    bright = total.linear[seen][nearest].quantile(0.9, dim=1)
    albedo = (0.3 * bright / median).clamp(0.05, 0.8)
    bounce = torch.from_numpy(scene.transport.visibility.bounce.toarray())[~seen]
    for c in range(3):
        share = albedo[:, c, None] / np.pi * bounce
        emitted = albedo[:, c] * median[c] * open_sky[:, 0] + share[:, seen] @ total.linear[seen, c]
        wanted = torch.linalg.solve(torch.eye(len(share)) - share[:, ~seen], emitted)
        torch.testing.assert_close(found[~seen, c], wanted, rtol=0.01, atol=1e-4)
