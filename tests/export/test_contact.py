# SPDX-License-Identifier: Apache-2.0
"""The small picture that stands for a result on a library's contact sheet."""

from __future__ import annotations

import numpy as np
import pytest
from evaluation import sphere_run
from export.test_stage import Recorder, context
from PIL import Image

from robir.capture.store import load_capture
from robir.evaluation.layers import load_textures
from robir.evaluation.metrics import srgb_from_linear
from robir.export import stage
from robir.export.report.pictures import CONTACT_SIDE
from robir.jobs.paths import read_json


@pytest.fixture(scope="module")
def tiles(tmp_path_factory):
    """Middles of the four pictures as (S, S, 3) codes, and the paths of the result."""
    paths = sphere_run.make_run(tmp_path_factory.mktemp("contact") / "out")
    stage.run(context(paths, Recorder(), renders=False))
    with Image.open(paths.contact, formats=["JPEG"]) as image:
        codes = np.asarray(image.convert("RGB")).astype(float)
    assert codes.shape == (CONTACT_SIDE, 4 * CONTACT_SIDE, 3)
    third = slice(CONTACT_SIDE // 3, 2 * CONTACT_SIDE // 3)
    return [tile[third, third] for tile in np.split(codes, 4, axis=1)], paths


def test_photograph_and_rerender_are_alike_where_the_result_is_right(tiles):
    (photo, again, _, _), paths = tiles
    assert np.abs(photo - again).mean() < 3.0
    view = load_capture(paths.stage("capture")).held_out[0]
    inside = view.image_display[view.mask > 127]
    low, high = np.percentile(inside, [0, 100], axis=0)
    assert (photo.mean(axis=(0, 1)) >= low - 3).all()
    assert (photo.mean(axis=(0, 1)) <= high + 3).all()


def test_albedo_and_trust_are_those_of_the_textures(tiles):
    (_, _, albedo, trust), paths = tiles
    arrays = load_textures(paths, "uncertainty", "metallic")
    inside = arrays["inside"] > 0
    expected = 255 * srgb_from_linear(np.median(arrays["albedo_linear"][inside], axis=0))
    assert np.median(albedo, axis=(0, 1)) == pytest.approx(expected, abs=8)
    sure = 255 * np.clip(1.0 - np.median(arrays["uncertainty"][inside]), 0.0, 1.0)
    assert np.median(trust) == pytest.approx(sure, abs=8)
    share = arrays["metallic"][inside].mean()
    assert read_json(paths.report_json)["metal_share"] == pytest.approx(float(share))
