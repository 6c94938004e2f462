# SPDX-License-Identifier: Apache-2.0
"""Environment maps from anybody: light, or a sentence, before Blender sees them."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest

from robir.errors import UsageError
from robir.evaluation.light import refuse_light
from robir.export.textures import write_exr


def written(path, channels, compression=OpenEXR.ZIP_COMPRESSION):
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


def light(value=1.0):
    image = np.ones((8, 16, 3), np.float32)
    image[2, 3, 1] = value
    return image


def test_light_is_taken(tmp_path):
    for value in (60_000.0, -1e-3):  # the latter of a colour outside of Rec.709
        write_exr(tmp_path / "light.exr", light(value))
        refuse_light(tmp_path / "light.exr")
    (tmp_path / "light.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n")
    refuse_light(tmp_path / "light.hdr")


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1e38])
def test_numbers_that_no_light_has(tmp_path, value):
    write_exr(tmp_path / "light.exr", light(value))
    with pytest.raises(UsageError, match=r"light\.exr is no light: its channel G"):
        refuse_light(tmp_path / "light.exr")


def test_a_map_without_colours(tmp_path):
    with pytest.raises(UsageError, match="no colours, only Z"):
        refuse_light(written(tmp_path / "depth.exr", {"Z": np.ones((8, 16), np.float32)}))


def test_damaged_chunks(tmp_path):
    """Blender dies of these without a sentence."""
    path = written(
        tmp_path / "light.exr", {"RGB": np.random.default_rng(0).random((64, 128, 3), np.float32)}
    )
    content = bytearray(path.read_bytes())
    content[1000:] = b"\xff" * (len(content) - 1000)
    path.write_bytes(content)
    with pytest.raises(UsageError, match="cut off or damaged"):
        refuse_light(path)
    path.write_bytes(content[:300])
    with pytest.raises(UsageError, match="cut off or damaged"):
        refuse_light(path)


def test_more_texels_than_there_is_memory_for(tmp_path):
    """A few kilobytes on the disk."""
    path = written(tmp_path / "light.exr", {"Y": np.zeros((9000, 16_000), np.float16)})
    with pytest.raises(UsageError, match="16000 by 9000 pixels"):
        refuse_light(path)
    (tmp_path / "light.hdr").write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 9000 +X 16000\n"
    )
    with pytest.raises(UsageError, match="9000 by 16000"):
        refuse_light(tmp_path / "light.hdr")
    (tmp_path / "light.hdr").write_bytes(b"GIF89a")
    with pytest.raises(UsageError, match="header"):
        refuse_light(tmp_path / "light.hdr")
