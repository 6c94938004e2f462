# SPDX-License-Identifier: Apache-2.0
"""The charts' numbers: Pareto front, losses, what is said, how watchful the program is."""

from __future__ import annotations

import copy
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from bench.fake_robir import scores

from robir_bench.chart import amounts, cost_growth, pareto_front, speed_accuracy
from robir_bench.heat import cases, cause, heat_map, heat_table, worst_cases
from robir_bench.table import bench_tables


def record(albedo=22.0, method="ours", seconds=90.0, factor="", value="", trusted=True, **changes):
    return {
        "name": f"a_{factor}_{value}_{method}_{albedo}",
        "capture": "a",
        "method": method,
        "seed": 0,
        "factor": factor,
        "value": value,
        "cpu_seconds": seconds,
        "peak_gigabytes": 0.8,
        "held_out": {"psnr": 24.0},
        "warnings": [],
        "trust": {"is_trusted": trusted},
        "scores": scores(albedo),
    } | changes


def failure(factor="views", value="1"):
    kept = ("name", "capture", "method", "seed", "factor", "value")
    whole = record(factor=factor, value=value)
    return {name: whole[name] for name in kept} | {"error": "no masks", "exit_code": 3}


def test_the_front_holds_exactly_what_nothing_beats():
    rng = np.random.default_rng(0)
    for _ in range(50):
        points = [tuple(point) for point in rng.integers(0, 8, (12, 2)).astype(float)]
        front = pareto_front(points)
        values = {points[index] for index in front}
        beaten = {
            p for p in points if any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)
        }
        assert values == set(points) - beaten
        assert len(values) == len(front)
        assert [points[i] for i in front] == sorted(values)


def test_costs_grow_with_amounts_and_words_are_no_amounts():
    records = [record(22.0)]
    records += [
        record(20.0 + k, seconds=40.0 * k, factor="views", value=str(10 * k)) for k in (2, 1)
    ]
    records += [record(21.0, seconds=50.0 + k, factor="views", value="20") for k in (0, 4)]
    records += [record(21.0, seconds=9.0, factor="mask", value="dilate 1")]
    records += [record(21.0, seconds=9.0, factor="jpeg", value="70")]  # one amount shows no growth
    steps = [("[280, 220]", 90.0), ("[140, 110]", 60.0)]
    records += [record(21.0, "ours", s, "geometry.level_steps", v) for v, s in steps]
    assert amounts(records) == {
        "views": [(10.0, 40.0, 21.0), (20.0, 54.0, 21.0)],
        "geometry.level_steps": [(250.0, 60.0, 21.0), (500.0, 90.0, 21.0)],
    }
    words = "".join(ET.fromstring(cost_growth(records)).itertext())
    for word in ("views", "geometry.level_steps", "in proportion"):
        assert word in words
    assert cost_growth(records[:1]) == ""


def test_methods_are_compared_capture_by_capture_and_with_their_tenth():
    captures = [str(number) for number in range(10)]
    # captures differ by 18 dB, methods on one by 1 to 3: only pairs tell them apart
    ours = [record(20.0 + 2 * k, capture=c) for k, c in enumerate(captures)]
    theirs = [record(19.0 + 2 * k - k % 3, "mitsuba", capture=c) for k, c in enumerate(captures)]
    summary, against, _ = bench_tables([*ours, *theirs])
    cells = {row[0]: row[1] for row in summary.rows}
    assert cells["ours: median"].startswith("29.0 [")
    assert (cells["ours: worst tenth"], cells["ours: worst"]) == ("22.0", "20.0")
    (row,) = against.rows
    assert row[0] == "mitsuba" and row[2] == "10 of 10"
    middle, low, high = (float(part) for part in re.findall(r"[\d.]+", row[1]))
    assert middle == pytest.approx(1.9) and 1.0 < low < middle < high < 3.0
    assert "mitsuba" in "".join(ET.fromstring(speed_accuracy([*ours, *theirs])).itertext())
    assert len(bench_tables(ours)) == 2  # nothing to compare with


def test_losses_are_against_the_same_capture_method_and_seed():
    records = [record(22.0), record(14.0, "photo")]
    records += [record(19.5, factor="views", value="5"), record(13.0, "photo", 9.0, "views", "5")]
    records += [record(21.0, factor="noise", value="0.1"), failure()]
    found = cases(records)
    assert [case.lost for case in found] == [2.5, 1.0, 1.0, None]
    assert [case.record["value"] for case in worst_cases(found)] == ["1", "0.1"]
    rows = heat_table(found).rows
    assert rows[0] == ["views", "5", "2.5", "1.00", "0 of 1", "1.0", "1.00", "0 of 1"]
    assert rows[2] == ["views", "1", "-", "-", "1 of 1", "-", "-", "0 of 0"]
    words = "".join(ET.fromstring(heat_map(found)).itertext())
    for word in ("views 5", "noise 0.1", "photo", "2.5", "1 of 1 failed"):
        assert word in words


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("mask_iou", 0.9, "outline is off (IoU 0.900 against 0.990)"),
        ("normals.mean_degrees", 20.0, "ormals are 20 degrees off against 6"),
        ("light.strongest_lobe_degrees", 40.0, "sun is 40 degrees off"),
        ("light.strongest_lobe_degrees", None, "o sun was found"),
        ("tone_curve.family", "standard", "tone curve, Filmic, was taken for standard"),
        ("shadow.ratio", 0.4, "hadows stay in the albedo (ratio 0.40 against 1.00)"),
        ("shadow.ratio", 1.5, "over-corrected"),
        ("albedo.psnr_linear.raw", 0.0, "stayed as they were"),
    ],
)
def test_a_cause_is_the_score_that_moved(path, value, words):
    base = record(22.0)
    base["scores"]["light"]["strongest_lobe_degrees"] = 0.5
    spoilt = copy.deepcopy(base) | {"factor": "views", "value": "5"}
    place, (*keys, last) = spoilt["scores"], path.split(".")
    for key in keys:
        place = place[key]
    place[last] = value
    sentence = cause(cases([base, spoilt])[0])
    assert words in sentence
    assert sentence.count(";") == 0
