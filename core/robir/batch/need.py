# SPDX-License-Identifier: Apache-2.0
"""How much main memory a capture will need, told beforehand from its photographs and settings.

Peak = what torch and the libraries take, and the largest of what the stages add to it: cells of the
finest distance field, texels of the appearance, kept pixels of the photographs. The factors are
rounded up from measured peaks, see docs/batch.md.
"""

from __future__ import annotations

import os

from robir.batch.plan import Entry, Plan, parse_size

_BASE = 700 << 20
_BYTES_PER_CELL = 145
_BYTES_PER_TEXEL = 125
_BYTES_PER_FURTHER_TEXEL = 45
_FEW_TEXELS = 4096**2
_BYTES_PER_PIXEL = 8
_BYTES_PER_RAY = 16

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".heic", ".dng")
_FRAMES = 60  # photographs that a video is taken to give


def memory_needed(plan: Plan, entry: Entry) -> int:
    """Bytes of main memory; what the plan says goes before the estimate."""
    if entry.memory:
        return parse_size(entry.memory)
    config = entry.config()
    cells = max(config.geometry.level_cells) ** 3
    texels = config.appearance.texture_size**2
    pixels = _photographs(plan, entry) * config.capture.max_side**2
    rays = config.transport.num_surfels * config.transport.num_directions
    further = max(0, texels - _FEW_TEXELS)
    textures = (texels - further) * _BYTES_PER_TEXEL + further * _BYTES_PER_FURTHER_TEXEL
    largest = max(cells * _BYTES_PER_CELL, rays * _BYTES_PER_RAY, textures)
    return _BASE + largest + pixels * _BYTES_PER_PIXEL


def _photographs(plan: Plan, entry: Entry) -> int:
    """Pictures in the capture, masks and truth left out; a video's frames are guessed."""
    source = plan.captures / entry.path
    if source.is_file() and source.suffix.lower() not in (".json", ".npz", ".npy"):
        return _FRAMES
    count = 0
    for _, folders, names in os.walk(source if source.is_dir() else source.parent):
        folders[:] = [name for name in folders if name not in ("truth", "masks")]
        count += sum(name.lower().endswith(_SUFFIXES) for name in names)
    return count
