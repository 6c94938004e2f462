# SPDX-License-Identifier: Apache-2.0
"""Islands grow by what was asked, codes and colour states are what the files promise."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from evaluation import sphere_run
from PIL import Image

from robir.errors import StorageError
from robir.export import textures


def island(size=64):
    inside = np.zeros((size, size), bool)
    inside[20:40, 16:50] = True
    rows, columns = np.mgrid[:size, :size]
    image = np.stack([rows, columns, rows + columns], axis=-1) / 128.0
    return np.where(inside[..., None], image, 0.0), inside


def test_islands_grow_with_the_nearest_texel():
    image, inside = island()
    filled = textures.grown(image, inside, 8)
    assert filled[inside] == pytest.approx(image[inside])
    assert filled[30, 8] == pytest.approx(image[30, 16])  # 8 texels off
    assert filled[12, 30] == pytest.approx(image[20, 30])
    assert filled[30, 57] == pytest.approx(image[30, 49])
    mean = image[inside].mean(axis=0)
    assert filled[30, 7] == pytest.approx(mean)
    assert filled[0, 0] == pytest.approx(mean)
    # corners are as near as they are in the plane, brute force over all texels inside
    spots = np.argwhere(inside)
    for texel in ((15, 12), (44, 54), (36, 51)):
        distance = np.linalg.norm(spots - texel, axis=1)
        ties = [image[tuple(s)] for s in spots[distance == distance.min()]]
        assert any(filled[texel] == pytest.approx(t) for t in ties)


@pytest.mark.parametrize(("size", "margin"), [(256, 8), (2048, 8), (4096, 16)])
def test_margin_follows_the_size(size, margin):
    inside = np.zeros((size, 64), bool)  # as high as the texture is, narrow to be quick
    inside[:, :32] = True
    flat = np.ones((size, 64), np.float32)
    ramp = np.where(inside, np.linspace(0, 1, size, dtype=np.float32)[:, None], 0.0)
    arrays = {
        "inside": inside,
        "albedo_linear": np.repeat(flat[..., None], 3, axis=-1),
        "roughness": ramp,
        "metallic": 0 * flat,
        "coverage": 3 * flat,
        "uncertainty": flat,
    }
    row = textures.finished_textures(arrays, 12).roughness[-1]
    assert np.count_nonzero(row > 0.99) == 32 + margin


def test_files_carry_their_colour_state(tmp_path):
    arrays = sphere_run.sphere_textures()
    done = textures.finished_textures(arrays, 12)
    for name in ("metallic.png", "normal.png"):
        (tmp_path / name).write_bytes(b"old")
    textures.write_textures(done, tmp_path)
    inside = arrays["inside"]
    names = {file.name for file in tmp_path.iterdir()}
    assert names == {
        "albedo.png",
        "albedo.exr",
        "roughness.png",
        "coverage.png",
        "uncertainty.png",
    }
    with Image.open(tmp_path / "albedo.png") as image:
        albedo = np.array(image)
    # 0.6 linear is 203 in sRGB by the standard's formula, not 153
    expected = np.round(255 * (1.055 * 0.6 ** (1 / 2.4) - 0.055))
    assert albedo[inside][:, 0].max() == expected == 203
    channels = OpenEXR.File(str(tmp_path / "albedo.exr")).channels()
    linear = next(iter(channels.values())).pixels
    assert linear.dtype == np.float16
    assert linear[inside].astype(float) == pytest.approx(arrays["albedo_linear"][inside], abs=1e-3)
    with Image.open(tmp_path / "roughness.png") as image:
        assert image.mode == "L"
        assert set(np.unique(np.array(image)[inside])) == {round(0.4 * 255), round(0.7 * 255)}
    with Image.open(tmp_path / "coverage.png") as image:
        coverage = np.array(image)
    assert set(np.unique(coverage[inside])) == {round(255 * 6 / 12)}
    assert not coverage[~inside].any()


def test_a_normal_map_is_written_and_read_as_it_is(tmp_path):
    bumps = np.random.default_rng(0).integers(0, 256, (16, 24, 3)).astype(np.uint8)
    done = textures.finished_textures(sphere_run.sphere_textures(), 12)
    textures.write_textures(replace(done, normal_map=bumps), tmp_path)
    path = tmp_path / "normal.png"
    assert (textures.stored_normal_map(path) == bumps).all()
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(StorageError, match=r"normal\.png cannot be read"):
        textures.stored_normal_map(path)
    assert textures.stored_normal_map(tmp_path / "none.png") is None
