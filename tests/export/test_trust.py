# SPDX-License-Identifier: Apache-2.0
"""The quality check trusts a perfect result and doubts each kind of spoilt one for its own sign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evaluation import sphere_run

from robir.capture.store import load_capture
from robir.evaluation.layers import load_textures, result_mesh
from robir.export.trust import SIGNS, paint, quality, rivals, shown, verdict


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    paths = sphere_run.make_run(tmp_path_factory.mktemp("trust") / "out")
    capture = load_capture(paths.stage("capture"))
    return capture, result_mesh(paths, capture.bounds), load_textures(paths)


def rows(*apart):
    """Rows of tone_curve.json, all but the first of curves that fit as well or not."""
    return [{"family": str(n), "albedo_apart": value} for n, value in enumerate(apart)]


RIVALS = rows(None, 35.0, None, 28.0)


def told(off):
    """Rows of evidence.json: known paint asks for a light so much brighter than all else."""
    values = {"all": (1.0, 0.3), "known paint": (1.0 + off, 0.4)}
    level = [
        {"of": "level", "by": by, "value": value, "deviation": deviation}
        for by, (value, deviation) in values.items()
    ]
    return [*level, {"of": "hue", "by": "all", "value": 0.0, "deviation": 0.1}]


def spoilt_views(capture, change):
    return replace(capture, views=tuple(replace(v, **change(v)) for v in capture.views))


def doubted(capture, mesh, arrays, rerender=25.0, left_open=None):
    found = quality(capture, mesh, arrays, rerender, left_open or {})
    names = [
        name for name, sign in found["signs"].items() if SIGNS[name].is_doubtful(sign["value"])
    ]
    assert len(found["doubts"]) == len(names)
    assert found["is_trusted"] == (not names)
    return names


def test_a_perfect_result_is_trusted_with_all_signs(sound):
    heard = shown({"unexplained": 0.02})
    found = quality(*sound, 25.0, rivals(RIVALS) | paint(told(0.1)) | heard)
    assert found["is_trusted"]
    assert found["signs"].keys() == SIGNS.keys()
    assert found["signs"]["outline"]["value"] == 1.0
    assert found["signs"]["views"]["value"] == 6.0
    assert found["signs"]["rivals"]["value"] == 28.0
    # an error of a tenth of an albedo: paint of 0.6, 0.25, 0.15 beside 0.15, 0.3, 0.5
    rms = np.sqrt(np.mean([0.6**2, 0.25**2, 0.15**2, 0.15**2, 0.3**2, 0.5**2]))
    assert found["signs"]["albedo"]["value"] == pytest.approx(0.1 * rms, rel=0.05)
    assert found["signs"]["shown"]["value"] == 0.02


GOOD = {"outline": 0.995, "rerender": 27.0, "clipped": 0.0, "views": 9.0}


def test_the_verdict_is_one_word_one_reason_and_one_remedy():
    assert verdict(GOOD) == {"word": "Good", "reason": "", "remedy": ""}
    near = verdict(GOOD | {"clipped": 0.08})
    assert near["word"] == "Check this"
    assert near["reason"] == SIGNS["clipped"].reason
    assert near["remedy"] == SIGNS["clipped"].cure
    # the sign that is furthest beyond its limit is named, not the first
    beyond = verdict(GOOD | {"rerender": 17.9, "clipped": 0.4})
    assert beyond == {"word": "Doubtful"} | {key: near[key] for key in ("reason", "remedy")}


@pytest.mark.parametrize("name", SIGNS)
def test_near_lies_on_the_good_side_of_every_limit(name):
    sign = SIGNS[name]
    assert not sign.is_doubtful(sign.near)
    just = sign.limit + 1e-6 * (sign.limit - sign.near)
    assert verdict({name: just})["word"] == "Doubtful"
    assert verdict({name: sign.limit + 0.5 * (sign.near - sign.limit)})["word"] == "Check this"
    assert not set("0123456789%").intersection(sign.reason)


def test_holes_in_the_masks_show_in_the_outline(sound):
    capture, mesh, arrays = sound

    def punch(view):
        mask = view.mask.copy()
        mask[24:34, 24:34] = 0
        return {"mask": mask}

    assert doubted(spoilt_views(capture, punch), mesh, arrays) == ["outline"]


@pytest.mark.parametrize(
    ("name", "array", "value"), [("albedo", "uncertainty", 0.9), ("views", "coverage", 2.0)]
)
def test_textures_tell_of_uncertain_albedo_and_of_few_views(sound, name, array, value):
    capture, mesh, arrays = sound
    worse = arrays | {array: np.where(arrays["inside"], value, 0.0).astype(np.float32)}
    assert doubted(capture, mesh, worse) == [name]


def test_what_is_shown_worse_than_by_the_mean_is_doubted(sound):
    assert doubted(*sound, left_open=shown({"unexplained": 0.2})) == ["shown"]
    assert shown(None) == {}


def test_a_bad_re_render_is_doubted_and_a_missing_one_is_not(sound):
    assert doubted(*sound, rerender=15.0) == ["rerender"]
    assert "rerender" not in quality(*sound, None, {})["signs"]


def test_known_paint_is_doubted_where_all_else_tells_another_light(sound):
    assert doubted(*sound, left_open=paint(told(0.6))) == []
    assert doubted(*sound, left_open=paint(told(-1.6))) == ["paint"]
    # a normal distribution's deviation is that of both
    assert paint(told(0.5))["paint"] == pytest.approx(0.5 / np.sqrt(0.3**2 + 0.4**2))
    assert paint(told(0.5)[:1]) == paint(told(0.5)[2:]) == {}
