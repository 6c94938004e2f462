# SPDX-License-Identifier: Apache-2.0
"""Variations: what they refuse, and what a render of them shows."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_scenes.environment import LUMINANCE
from blender_scenes.format import ViewTruth, read_view
from blender_scenes.request import SceneError, SceneRequest, fingerprint
from blender_scenes.variation import ALBEDO, Variation, VariationError, parse

ROOT = Path(__file__).parents[2]
SMALL = ("--resolution", "48", "--views", "2", "--test-views", "1", "--samples", "16")
TRUCK = SceneRequest(scene="truck", ground="checker", light="lamp")
BARE = Variation()


def test_items_become_a_variation() -> None:
    found = parse(["roughness=0.3", "suns=2", "albedo=black"])
    assert found == Variation(roughness=0.3, suns=2, albedo="black")
    assert parse([]) == BARE


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ("gloss=1", "unknown; known: sun_share"),
        ("roughness", "'' is no number"),
        ("roughness=high", "'high' is no number"),
        ("roughness=2", "roughness is 2.0; it must be 0.05 to 1.0"),
        ("roughness=nan", "roughness is nan"),
        ("suns=1.5", "'1.5' is no number"),
        ("albedo=pink", "choose one of white, black"),
    ],
)
def test_nonsense_is_refused_in_words(item: str, words: str) -> None:
    with pytest.raises(VariationError, match=words):
        parse([item])


def test_the_lamp_is_varied_only_where_there_is_one() -> None:
    with pytest.raises(SceneError, match="use --light lamp"):
        replace(TRUCK, light="hdri-sun", variation=Variation(suns=2))
    with pytest.raises(SceneError, match="leave out --vary sun_share"):
        replace(TRUCK, preset="high_illumination", variation=Variation(sun_share=0.5))


def test_fingerprint_changes_with_every_variation() -> None:
    varied = [
        Variation(**change)
        for change in (
            {},
            {"sun_share": 0.0},
            {"sun_size": 15.0},
            {"suns": 2},
            {"roughness": 0.1},
            {"metallic": 1.0},
            {"albedo": "white"},
            {"texture_scale": 4.0},
            {"bounces": 0},
            {"rods": 0.01},
        )
    ]
    hashes = {fingerprint(replace(TRUCK, variation=variation), "1") for variation in varied}
    assert len(hashes) == len(varied)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("varied")


def views(folder: Path, *items: str) -> list[ViewTruth]:
    """Truth of the views of a lorry under a variation."""
    out = folder / ("_".join(items) or "bare")
    if not out.exists():
        options = [word for item in items for word in ("--vary", item)]
        command = [sys.executable, "-m", "blender_scenes", "truck", str(out), *SMALL, *options]
        done = subprocess.run(
            [*command, "--cache", str(folder / "cache")],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        scene = json.loads((out / "truth" / "scene.json").read_text())
        assert Variation(**scene["variation"]) == parse(items)
    return [read_view(out / "truth" / f"{name}.exr") for name in ("train/r_000", "train/r_001")]


def is_ground(truth: ViewTruth) -> np.ndarray:
    return (truth.hit > 0.5) & (truth.position[..., 2] < 1e-3) & (truth.mask > 0.999)


def is_object(truth: ViewTruth) -> np.ndarray:
    return (truth.hit > 0.5) & (truth.position[..., 2] > 0.02) & (truth.mask > 0.999)


class TestRendered:
    pytestmark = pytest.mark.blender

    def test_paint_of_the_object_changes_and_the_ground_keeps_its_own(self, folder: Path) -> None:
        before = views(folder)
        after = views(folder, "roughness=0.3", "metallic=0", "albedo=black")
        for old, new in zip(before, after, strict=True):
            # pixels at an edge average two paints; those well inside follow the rule
            thing, ground = is_object(new), is_ground(new)
            gain, offset = ALBEDO["black"]
            wanted = gain * old.albedo[thing] + offset
            assert np.quantile(np.abs(new.albedo[thing] - wanted).max(axis=1), 0.7) < 2e-3
            assert np.median(new.roughness[thing]) == pytest.approx(0.3, abs=1e-3)
            assert np.quantile(new.metallic[thing], 0.9) == pytest.approx(0.0, abs=1e-3)
            assert np.median(new.roughness[ground]) == pytest.approx(0.75, abs=0.01)
            assert np.quantile(np.abs(new.albedo - old.albedo)[ground].max(axis=1), 0.7) < 2e-3

    def test_two_suns_share_the_light_of_one_and_cast_two_shadows(self, folder: Path) -> None:
        """In the first sun's shadow the second shines; in open ground nothing has changed."""
        one, two = views(folder), views(folder, "suns=2")
        lit, shade = [], []
        for old, new in zip(one, two, strict=True):
            ground = is_ground(old)
            ratio = (new.radiance @ LUMINANCE)[ground] / (old.radiance @ LUMINANCE)[ground]
            seen = old.sun_visibility[ground] > 0.5
            lit.append(ratio[seen])
            shade.append(ratio[~seen])
        lit = np.concatenate(lit)
        # a third of the sun is missing where the second shadow lies
        assert 0.05 < (lit < 0.85).mean() < 0.6
        assert np.median(lit[lit > 0.85]) == pytest.approx(1.0, abs=0.05)
        # the sky's quarter and a third of the sun's three quarters, over the sky's quarter: 2
        assert (np.concatenate(shade) > 1.5).mean() > 0.3
