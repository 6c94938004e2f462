# SPDX-License-Identifier: Apache-2.0
"""Level and hue of the recovered light, against closed forms."""

from __future__ import annotations

import json

import numpy as np
import pytest
from evaluation import sphere_run

from robir_bench.truth.evaluate import evaluate
from robir_bench.truth.light import level_and_hue

ROWS = 64
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
UP, ASIDE = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]


def uniform(*radiance: float) -> np.ndarray:
    return np.broadcast_to(np.array(radiance, float), (ROWS, 2 * ROWS, 3)).copy()


def test_level_is_the_logarithm_of_the_ratio_and_hue_its_spread_over_the_channels():
    normals = np.array([UP, ASIDE])
    found = level_and_hue(uniform(2.0, 2.0, 2.0), uniform(1.0, 1.0, 1.0), normals)
    assert found == pytest.approx({"level_log_error": np.log(2.0), "hue_log_error": 0.0})
    ratio = np.array([2.0, 1.0, 0.5])
    found = level_and_hue(uniform(*ratio), uniform(1.0, 1.0, 1.0), normals)
    assert found["level_log_error"] == pytest.approx(np.log(ratio @ LUMINANCE))
    # of ln 2, 0 and -ln 2
    assert found["hue_log_error"] == pytest.approx(np.log(2.0) * np.sqrt(2.0 / 3.0))


def test_light_counts_as_it_falls_on_what_is_seen():
    """A half space of radiance 1 above gives a surface that faces up pi, one facing aside pi / 2.

    The other half of what lies before the latter is the lower half space, here of radiance 3.
    """
    above, both = uniform(1.0, 1.0, 1.0), uniform(1.0, 1.0, 1.0)
    above[ROWS // 2 :] = 0.0
    both[ROWS // 2 :] = 3.0
    for normals, ratio in (([UP], 1.0), ([ASIDE], 4.0), ([UP, ASIDE], (1.0 + 2.0) / 1.5)):
        found = level_and_hue(both, above, np.array(normals))
        assert found["level_log_error"] == pytest.approx(np.log(ratio), abs=2e-3)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return sphere_run.make_truth(tmp_path_factory.mktemp("truth") / "capture")


def rewritten(truth, folder, **changes):
    """The same truth with other entries in its scene.json."""
    out = folder / "capture"
    out.mkdir()
    for child in truth.iterdir():
        if child.name != "truth":
            (out / child.name).symlink_to(child)
    (out / "truth").mkdir()
    for child in (truth / "truth").iterdir():
        if child.name != "scene.json":
            (out / "truth" / child.name).symlink_to(child)
    scene = json.loads((truth / "truth" / "scene.json").read_text())
    (out / "truth" / "scene.json").write_text(json.dumps(scene | changes))
    return out


def test_a_perfect_light_has_no_error_and_exposure_is_a_part_of_the_level(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    found = evaluate(paths, truth)["light"]
    assert found["level_log_error"] == pytest.approx(0.0, abs=0.03)
    assert found["hue_log_error"] == pytest.approx(0.0, abs=0.01)
    brighter = evaluate(paths, rewritten(truth, tmp_path, exposure=1.0))["light"]
    assert brighter["level_log_error"] - found["level_log_error"] == pytest.approx(-np.log(2.0))
