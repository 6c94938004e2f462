# SPDX-License-Identifier: Apache-2.0
"""The small picture that stands for a result on a library's contact sheet."""

from __future__ import annotations

import numpy as np
import pytest
from evaluation import sphere_run
from export.test_stage import Recorder, context
from PIL import Image

from robir.capture.store import load_capture
from robir.export import stage
from robir.export.report.pictures import CONTACT_SIDE


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
