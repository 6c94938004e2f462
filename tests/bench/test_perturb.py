# SPDX-License-Identifier: Apache-2.0
"""Each way to spoil a capture against what it promises, on a rendered capture of a sphere."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
import torch
from evaluation import sphere_run
from PIL import Image

from robir.errors import ConfigError
from robir.evaluation.light import read_exr
from robir.maths import tone
from robir_bench.stability.perturb import Perturbation
from robir_bench.truth.files import load_truth
from robir_bench.truth.light import true_curve
from robir_bench.truth.metrics import linear_from_srgb


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """The sphere's capture with radiance in its truth, as the scene generators leave it."""
    folder = sphere_run.make_truth(tmp_path_factory.mktemp("perturb") / "sphere")
    for split in ("train", "test"):
        for file in sorted((folder / split).glob("*.png")):
            codes = np.asarray(Image.open(file)) / 255.0
            truth = folder / "truth" / split / f"{file.stem}.exr"
            planes = read_exr(truth)
            radiance = linear_from_srgb(codes[..., :3])
            planes |= {f"radiance.{axis}": radiance[..., i] for i, axis in enumerate("RGB")}
            sphere_run.save_planes(truth, planes)
    return folder


def spoil(source, out, factor, value, seed=0):
    folder = out / "spoilt"
    Perturbation(source=source, factor=factor, value=value).make(folder, seed)
    return folder


def table(folder, split="train"):
    return json.loads((folder / f"transforms_{split}.json").read_text())


def pictures(folder, split="train"):
    names = [frame["file_path"] for frame in table(folder, split)["frames"]]
    return [np.asarray(Image.open(folder / f"{name}.png")) for name in names]


def poses(folder, split="train"):
    return np.array([frame["transform_matrix"] for frame in table(folder, split)["frames"]])


def test_fewer_views_are_a_subset_of_more_and_far_apart(source, tmp_path):
    everything = table(source)["frames"]
    three, two = (
        table(spoil(source, tmp_path / str(n), "views", float(n)))["frames"] for n in (3, 2)
    )
    assert len(three) == 3
    assert len(two) == 2
    assert all(frame in everything for frame in three)
    assert all(frame in three for frame in two)
    place = poses(tmp_path / "2" / "spoilt")[:, :3, 3]
    every = poses(source)[:, :3, 3]
    widest = max(np.linalg.norm(every - place[0], axis=1))
    assert np.linalg.norm(place[0] - place[1]) == pytest.approx(widest)
    assert len(list((tmp_path / "3" / "spoilt" / "train").iterdir())) == 3


def test_pose_noise_has_its_root_mean_square(source, tmp_path):
    angles = []
    for seed in range(40):
        folder = spoil(source, tmp_path / str(seed), "pose noise", 2.0, seed)
        before, after = poses(source), poses(folder)
        np.testing.assert_allclose(after[:, :3, 3], before[:, :3, 3])
        turn = np.einsum("vji,vjk->vik", before[:, :3, :3], after[:, :3, :3])
        angles.append(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    found = np.degrees(np.sqrt(np.mean(np.square(angles))))
    assert found == pytest.approx(2.0, rel=0.06)  # of 240 cameras


@pytest.mark.parametrize("power", [0.5, 2.0])
def test_retoned_pictures_are_powers_and_the_truth_says_so(source, tmp_path, power):
    folder = spoil(source, tmp_path, "retone", power)
    for split in ("train", "test"):
        for before, after in zip(pictures(source, split), pictures(folder, split), strict=True):
            expected = 255 * (before[..., :3] / 255) ** power
            np.testing.assert_allclose(after[..., :3], expected, atol=0.5)
            np.testing.assert_array_equal(after[..., 3], before[..., 3])
    curve = true_curve(load_truth(folder).scene)
    original = load_truth(source).scene
    assert "display_power" not in original
    assert curve.parameters == true_curve(original).parameters | {"display_power": power}


@pytest.mark.parametrize("kind", ["dilate", "erode", "holes"])
def test_masks_grow_shrink_or_get_holes(source, tmp_path, kind):
    folder = spoil(source, tmp_path, "mask", f"{kind} 2")
    for split in ("train", "test"):
        for before, after in zip(pictures(source, split), pictures(folder, split), strict=True):
            np.testing.assert_array_equal(before[..., :3], after[..., :3])
            old, new = before[..., 3] > 127, after[..., 3] > 127
            area = np.count_nonzero(new) - np.count_nonzero(old)
            if kind == "dilate":
                assert np.all(new[old])
                rows = np.flatnonzero(old.any(axis=1))
                assert np.flatnonzero(new.any(axis=1))[[0, -1]].tolist() == [
                    rows[0] - 2,
                    rows[-1] + 2,
                ]
            else:
                assert np.all(old[new])
            assert (area > 0) == (kind == "dilate")
    if kind == "holes":
        lost = old & ~new
        assert 0 < np.count_nonzero(lost) <= 2 * np.pi * (0.04 * 64 + 1) ** 2


def test_tone_makes_the_pictures_of_the_other_curve_and_says_so(source, tmp_path):
    folder = spoil(source, tmp_path, "tone", "filmic")
    assert load_truth(folder).scene["view_transform"] == "Filmic"
    assert load_truth(source).scene["view_transform"] == "Standard"
    filmic, standard = (tone.curve_from_name(name) for name in ("filmic", "standard"))
    before, after = pictures(source)[0], pictures(folder)[0]
    inside = before[..., 3] > 0
    linear = standard.linear_from_display(torch.from_numpy(before[inside][:, :3] / 255.0))
    codes = 255 * filmic.display_from_linear(linear).numpy()
    assert np.abs(codes - after[inside][:, :3]).max() < 0.51


def test_jpeg_really_goes_through_a_jpeg(source, tmp_path):
    folder = spoil(source, tmp_path, "jpeg", 20.0)
    before, after = pictures(source)[1], pictures(folder)[1]
    stream = io.BytesIO()
    Image.fromarray(before[..., :3]).save(stream, "JPEG", quality=20)
    np.testing.assert_array_equal(np.asarray(Image.open(stream)), after[..., :3])
    np.testing.assert_array_equal(before[..., 3], after[..., 3])
    assert np.abs(before[..., :3].astype(int) - after[..., :3]).max() > 8


@pytest.mark.parametrize(
    ("factor", "value"),
    [
        ("fog", 1.0),
        ("views", 0.0),
        ("views", "many"),
        ("mask", "melt 3"),
        ("mask", "dilate"),
        ("tone", "sepia"),
        ("jpeg", 100.0),
        ("noise", -0.1),
    ],
)
def test_values_that_make_no_sense_are_refused(tmp_path, factor, value):
    with pytest.raises(ConfigError, match=factor):
        Perturbation(source=tmp_path, factor=factor, value=value)
