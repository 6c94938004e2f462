# SPDX-License-Identifier: Apache-2.0
"""Constants of modules that are changed by name, for the length of a run."""

from __future__ import annotations

import numpy as np
import pytest

from robir import constants
from robir.config import RunConfig, resolve
from robir.constants import changed, of_setting
from robir.errors import ConfigError
from robir.geometry import hull
from robir.geometry.ground import backdrop
from robir.geometry.stereo.fusion import choose_sources
from robir.pipeline.ledger import stage_fingerprints
from robir_bench.plan import METHODS, BenchRun, with_constants

REVISIONS = dict.fromkeys(("capture", "geometry", "transport", "appearance", "export"), 1)


def test_a_changed_constant_changes_what_a_function_finds_until_the_end_of_the_block():
    angle = np.radians(np.arange(0, 360, 10))
    eyes = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    with changed(["geometry.stereo.fusion._SOURCES=2"]):
        assert len(choose_sources(eyes)[0]) == 2
        assert constants.applied == ["geometry.stereo.fusion._SOURCES=2"]
    assert len(choose_sources(eyes)[0]) == 4
    assert constants.applied == []


def test_a_shared_constant_changes_wherever_it_was_imported():
    with changed(["geometry.hull.HULL_VIEWS=5"]):
        assert hull.HULL_VIEWS == backdrop.HULL_VIEWS == 5
    assert hull.HULL_VIEWS == backdrop.HULL_VIEWS == 48


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("geometry.ground.plane._TRIAL=3", "no '_TRIAL'; did you mean _TRIALS"),
        ("geometry.grund.plane._TRIALS=3", "no module .* did you mean geometry.ground.plane"),
        ("geometry.ground.plane._TRIALS=3.5", "the constant is 600; Expected `int`"),
        ("geometry.stereo.sweep._PENALTIES=[1, true]", "Expected `float`"),
        ("geometry.ground.plane._TRIALS=many", "'many' is no value of TOML"),
        ("_TRIALS", "no module ''"),
    ],
)
def test_what_is_no_constant_is_refused(change, words):
    with pytest.raises(ConfigError, match=words), changed([change]):
        pass


def test_a_stage_and_those_after_it_run_again_where_its_constants_change():
    usual = stage_fingerprints(RunConfig(), REVISIONS, "capture")
    config = resolve(RunConfig(), None, ['constants=["geometry.fit.optimise._BAND=1"]'])
    found = stage_fingerprints(config, REVISIONS, "capture")
    assert [stage for stage in usual if usual[stage] == found[stage]] == ["capture"]
    config = resolve(RunConfig(), None, ['constants=["maths.vectors.X=1"]'])
    found = stage_fingerprints(config, REVISIONS, "capture")
    assert not [stage for stage in usual if usual[stage] == found[stage]]


def test_a_sweep_keeps_the_constants_of_a_method(tmp_path):
    (own,) = METHODS["no far pairs"]
    run = BenchRun(capture=tmp_path, method="ours", seed=0, settings=(own,))
    (swept,) = with_constants([run], ["geometry.fit.descent._DOUBT=1"])
    assert resolve(RunConfig(), None, swept.settings).constants == (
        "appearance.light.solver._FAR=0.0",
        "geometry.fit.descent._DOUBT=1",
    )


@pytest.mark.parametrize(
    ("setting", "constant"),
    [
        ("geometry.ground.plane.trials", "geometry.ground.plane._TRIALS"),
        ("geometry.refine.noise", "geometry.refine.correlation._NOISE"),
        ("geometry.stereo.noise", "geometry.stereo.sweep._NOISE"),
        ("transport.ray_offset", "transport.baked.RAY_OFFSET"),
        ("geometry.nothing", None),
    ],
)
def test_a_setting_of_before_is_found_among_the_constants(setting, constant):
    assert of_setting(setting) == constant


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("geometry.ground.plane.trials=9", "is no setting any more.*--constant geometry.ground.pl"),
        ("geometry.stereo.image_side=90", "is called geometry.stereo_side now"),
    ],
)
def test_settings_of_before_are_refused_by_name(assignment, words):
    with pytest.raises(ConfigError, match=words):
        resolve(RunConfig(), None, [assignment])
