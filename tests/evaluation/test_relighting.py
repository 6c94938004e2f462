# SPDX-License-Identifier: Apache-2.0
"""Relit pictures beside the true scene under the same light."""

from __future__ import annotations

import numpy as np
import pytest
from evaluation import sphere_run
from PIL import Image

from robir.evaluation.metrics import srgb_from_linear
from robir_bench.truth.evaluate import evaluate, relit_picture
from robir_bench.truth.files import load_truth

# radiance of a white surface under the second light, which is even
LIGHT = np.array([0.9, 0.5, 0.2])


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    folder = sphere_run.make_truth(tmp_path_factory.mktemp("truth") / "capture")
    relit = folder / "truth" / "relit"
    relit.mkdir()
    for view in load_truth(folder).views:
        radiance = view.albedo * LIGHT
        planes = {f"radiance.{axis}": radiance[..., i] for i, axis in enumerate("RGB")}
        sphere_run.save_planes(relit / f"{view.name}.exr", planes | {"mask": view.hit})
    (folder / "truth" / "second_light.exr").write_bytes(b"nobody reads it here")
    return folder


def relight(paths, truth, factor=(1.0, 1.0, 1.0), side=sphere_run.SIZE) -> None:
    """Pictures of the result under the second light, through its Standard curve."""
    paths.renders.mkdir()
    for view in load_truth(truth).views:
        shown = srgb_from_linear(view.albedo * LIGHT * np.array(factor))
        codes = np.round(255 * np.dstack([shown, view.hit])).astype(np.uint8)
        Image.fromarray(codes).resize((side, side)).save(relit_picture(paths, view.name))


def test_a_perfect_result_relights_perfectly(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    relight(paths, truth)
    found = evaluate(paths, truth)["relighting"]
    assert found["views"] == 3
    for alignment, decibel in found["psnr_srgb"].items():
        assert decibel > 50, alignment


def test_a_wrong_brightness_fails_raw_only(truth, tmp_path):
    paths = sphere_run.make_run(tmp_path / "out")
    relight(paths, truth, factor=(0.6, 0.7, 0.8))
    found = evaluate(paths, truth)["relighting"]
    assert found["psnr_srgb"]["raw"] < 25
    assert found["psnr_srgb"]["per_channel_lsq"] > 45
    assert found["scale"]["per_channel_lsq"] == pytest.approx([1 / 0.6, 1 / 0.7, 1 / 0.8], rel=0.02)


def test_pictures_are_undone_by_the_curve_they_went_through(truth, tmp_path):
    """Of the same codes another curve makes another radiance."""
    paths = sphere_run.make_run(tmp_path / "out")
    relight(paths, truth)
    file = paths.stage("appearance") / "tone_curve.json"
    file.write_text(file.read_text().replace('"family": "standard"', '"family": "filmic"', 1))
    assert evaluate(paths, truth)["relighting"]["psnr_srgb"]["raw"] < 30
