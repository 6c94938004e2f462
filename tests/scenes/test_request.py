# SPDX-License-Identifier: Apache-2.0
"""Requests and their fingerprints: what decides the pixels counts, what does not does not."""

from dataclasses import replace
from pathlib import Path

import pytest

from blender_scenes.request import SceneError, SceneRequest, fingerprint

TRUCK = SceneRequest(scene="truck", ground="checker", light="lamp")


@pytest.mark.parametrize(
    "change",
    [
        {"scene": "hotdog"},
        {"ground": "none"},
        {"light": "hdri-sun"},
        {"preset": "high_illumination"},
        {"resolution": 161},
        {"views": 41},
        {"test_views": 9},
        {"samples": 65},
        {"seed": 1},
    ],
)
def test_fingerprint_changes_with_every_field(change: dict) -> None:
    assert fingerprint(replace(TRUCK, **change), "4.5.15") != fingerprint(TRUCK, "4.5.15")


def test_files_enter_the_fingerprint_by_content_not_by_name(tmp_path: Path) -> None:
    first, second, other = (tmp_path / f"{name}.hdr" for name in "abc")
    first.write_bytes(b"sky")
    second.write_bytes(b"sky")
    other.write_bytes(b"sea")
    hashes = [fingerprint(replace(TRUCK, hdri=file), "1") for file in (first, second, other)]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": "cathedral"}, "SCENE is 'cathedral'"),
        ({"ground": "lava"}, "--ground is 'lava'"),
        ({"scene": "asset"}, "needs --asset FILE"),
        ({"asset": Path("a.obj")}, "belongs to scene 'asset'"),
        ({"scene": "asset", "asset": Path("nowhere.obj")}, "no such file"),
        ({"scene": "asset", "asset": Path("a.stl")}, "unknown kind '.stl'"),
        ({"hdri": Path("nowhere.hdr")}, "no such file"),
        ({"hdri": Path("sky.png")}, "unknown kind '.png'"),
        ({"preset": "high_illumination", "light": "hdri-sun"}, "--light lamp"),
        ({"resolution": 4}, "at least 8"),
        ({"views": 0}, "at least 1"),
        ({"samples": 0}, "at least 1"),
        ({"seed": -1}, "at least 0"),
    ],
)
def test_impossible_requests_are_refused_in_words(change: dict, words: str) -> None:
    with pytest.raises(SceneError, match=words.replace("(", r"\(")):
        replace(TRUCK, **change)
