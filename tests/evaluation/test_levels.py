# SPDX-License-Identifier: Apache-2.0
"""Each level of a perfect sphere scores, and what is spoilt at one level is lost there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from evaluation import sphere_run
from PIL import Image

from robir.capture.store import load_capture, save_capture
from robir.evaluation.levels import LEVELS, level_scores
from robir.jobs.paths import read_json, write_json


@pytest.fixture
def paths(tmp_path):
    """A result of which every level is there, Cycles and field being the photographs."""
    made = sphere_run.make_run(tmp_path / "out")
    shown = held_out(made)
    np.savez(made.stage("geometry") / "field_held_out.npz", **shown)
    np.savez(made.stage("appearance") / "held_out_diffuse.npz", **shown)
    made.renders.mkdir()
    for name, picture in shown.items():
        Image.fromarray(picture).save(made.rerender(name))
    return made


def held_out(paths):
    """The held-out photographs with their masks, RGBA."""
    views = load_capture(paths.stage("capture")).held_out
    return {view.name: np.dstack([view.image_display, view.mask]) for view in views}


def spoil(file, change):
    with np.load(file) as arrays:
        table = {name: change(arrays[name]) for name in arrays.files}
    np.savez(file, **table)


FILES = (
    "geometry/field_held_out.npz",
    "appearance/held_out_diffuse.npz",
    "appearance/held_out.npz",
)
GRAIN = 3.0  # standard deviation of what `grainy` adds, codes


def grainy(picture):
    noise = np.random.default_rng(1).normal(0.0, GRAIN, picture[..., :3].shape)
    codes = np.rint(np.clip(picture[..., :3] + noise, 0, 255))
    return np.dstack([codes, picture[..., 3:]]).astype(np.uint8)


def darker(picture):
    """Two fifths of the display values."""
    return np.dstack([np.rint(0.4 * picture[..., :3]), picture[..., 3:]]).astype(np.uint8)


def test_a_perfect_result_loses_nothing_that_its_photographs_have(paths):
    scores = level_scores(paths, paths.levels_strip)
    json.dumps(scores, allow_nan=False)
    chain = scores["chain"]
    assert list(chain) == [level.name for level in LEVELS]
    assert scores["views"] == 3 and scores["seen_share"] > 0.8
    for name in ("field", "diffuse", "material", "cycles"):
        assert chain[name]["psnr"] == 100.0  # the ceiling
        assert chain[name]["ssim"] == pytest.approx(1.0)
        assert chain[name]["sharpness"] == 1.0
    # the sphere is matt, so its mean is what every photograph shows, sharpness aside
    assert chain["mesh"]["psnr"] > 25 and chain["mean"]["psnr"] > 25
    assert chain["hull"]["psnr"] < chain["mesh"]["psnr"]
    assert chain["mesh"]["psnr_whole_mask"] < chain["mesh"]["psnr"]  # what none shows is black
    with Image.open(paths.levels_strip) as strip:
        assert strip.width > 8 * 40 and strip.height > 3 * 40


@pytest.mark.parametrize(
    ("name", "place", "stage"),
    [
        ("field", "geometry/field_held_out.npz", "The fit of the surface"),
        ("diffuse", "appearance/held_out_diffuse.npz", "Texture and light"),
        ("material", "appearance/held_out.npz", "The material"),
    ],
)
def test_the_stage_that_spoils_a_level_is_named(paths, name, place, stage):
    stages = paths.root / "stages"
    for file in FILES:
        spoil(stages / file, grainy)  # no level is without any error, or the next one loses it all
    clean = level_scores(paths)["chain"]
    assert clean[name]["psnr"] == pytest.approx(-20 * np.log10(GRAIN / 255), abs=0.5)
    spoil(stages / place, darker)
    scores = level_scores(paths)
    chain = scores["chain"]
    photographs = np.concatenate([p[p[..., 3] > 0, :3] / 255 for p in held_out(paths).values()])
    expected = -10 * np.log10((0.36 * photographs**2).mean() + (0.4 * GRAIN / 255) ** 2)
    assert chain[name]["psnr"] == pytest.approx(expected, abs=0.3)
    assert scores["verdict"].startswith(f"{stage} loses"), scores["verdict"]
    others = {other for other in chain if chain[other]["psnr"] != clean[other]["psnr"]}
    assert others == {name}


def test_exposures_are_undone_for_all_levels_alike(paths):
    before = level_scores(paths)["chain"]
    folder, table = paths.stage("capture"), paths.stage("appearance") / "exposure.json"
    capture = load_capture(folder)
    steps = {view.name: [0.4 * (-1) ** k] * 3 for k, view in enumerate(capture.views)}
    views = []
    for view in capture.views:
        linear = decoded(view.image_display / 255) * 2 ** steps[view.name][0]
        codes = np.rint(255 * encoded(linear).clip(0, 1)).astype(np.uint8)
        views.append(replace(view, image_display=codes))
    save_capture(folder, replace(capture, views=tuple(views)))
    told = level_scores(paths)["chain"]
    write_json(table, read_json(table) | {"steps": steps})
    undone = level_scores(paths)["chain"]
    assert told["mean"]["psnr"] < before["mean"]["psnr"] - 2
    assert undone["mean"]["psnr"] == pytest.approx(before["mean"]["psnr"], abs=0.6)
    assert undone["mesh"]["psnr"] == pytest.approx(before["mesh"]["psnr"], abs=0.8)
    # Cycles and field know no exposure of a photograph, our own renderer does
    assert undone["cycles"]["psnr"] > 40 and undone["field"]["psnr"] > 40
    assert undone["material"]["psnr"] < 30 and undone["diffuse"]["psnr"] < 30


def decoded(display):
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def encoded(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
