# SPDX-License-Identifier: Apache-2.0
"""Samples Blender's Filmic and AgX view transforms into tone_tables.npz.

    python -m robir_bench.tone_tabulate .../colormanagement/config.ocio

Needs the `opencolorio` package; the library itself only reads the tables. Written are, all as
facts about the output of the transforms, none as a copy of their source:

* `filmic_display` (1025,): display code of a grey, log2 evenly over LOG2_RANGE_FILMIC.
* `agx_matrix` (3, 3): linear Rec.709 to the wide-gamut primaries in which AgX takes logarithms.
* `agx_lattice` (57, 57, 57, 3) uint16: code / 65535 with code = display light ** (1 / 2.4), over
  the log2 range LOG2_RANGE_AGX of those primaries, at the transform's own nodes. Nodes that no
  non-negative Rec.709 colour can touch are 0.
* `agx_inset`, `agx_outset` (3, 3) and `agx_inverse` (n, n, n, 3) int16: a first guess of the
  inverse. AgX is nearly, per channel, one grey curve between two matrices; u = position on the grey
  curve of (outset @ display light) differs from t = log2(inset @ linear) by little, and
  `agx_inverse` / 1024 is t - u in nodes, fitted to random colours with a smoothness term.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import PyOpenColorIO
import scipy.sparse
import scipy.sparse.linalg
import torch
from numpy.typing import NDArray

from robir.maths import tetrahedral as lattice
from robir.maths import tone_table
from robir.maths.tone_curve import linear_from_srgb

Array = NDArray[np.float64]

_NODES_FILMIC = 1025
_NODES_AGX = 57
_NODES_INVERSE = 29
_NUM_SAMPLES = 400_000
_SMOOTHNESS = 2e-3
# Non-negative Rec.709 colours differ by at most 3.1 stops between the wide primaries, 7 nodes.
_BAND = 9
# Found by minimising mean |t - u| over random colours; rounding them costs nothing.
_INSET = ((0.5755, 0.3441, 0.0804), (0.1433, 0.7591, 0.0976), (0.0886, 0.1778, 0.7336))
_OUTSET = ((0.5894, 0.3582, 0.0524), (0.1346, 0.8461, 0.0193), (0.0894, 0.1849, 0.7257))


class _Transform:
    """A view transform of the sRGB display, applied to (N, 3) arrays."""

    def __init__(
        self, config: PyOpenColorIO.Config, view: str, source: str = "Linear Rec.709"
    ) -> None:
        """Compile the transform from a linear colour space to display codes."""
        group = PyOpenColorIO.GroupTransform()
        display = PyOpenColorIO.DisplayViewTransform(src=source, display="sRGB", view=view)
        group.appendTransform(display)
        self._cpu = config.getProcessor(group).getDefaultCPUProcessor()

    def __call__(self, linear: Array) -> Array:
        """Display codes clipped to 0..1."""
        pixels = np.ascontiguousarray(linear, dtype=np.float32).copy()
        self._cpu.applyRGB(pixels)
        return np.clip(pixels.astype(np.float64), 0.0, 1.0)


def _filmic_table(config: PyOpenColorIO.Config) -> Array:
    low, high = tone_table.LOG2_RANGE_FILMIC
    grey = 2.0 ** np.linspace(low, high, _NODES_FILMIC)
    display = _Transform(config, "Filmic")(np.repeat(grey[:, None], 3, axis=1)).mean(axis=1)
    # Flat ends would make the inverse undefined; a slope of 1e-7 a node is far below a code.
    return np.maximum.accumulate(display + 1e-7 * np.arange(_NODES_FILMIC))


def _wide_primaries(config: PyOpenColorIO.Config) -> Array:
    processor = config.getProcessor("Linear Rec.709", "Linear FilmLight E-Gamut")
    pixels = np.eye(3, dtype=np.float32)
    processor.getDefaultCPUProcessor().applyRGB(pixels)
    return pixels.T.astype(np.float64)


def _agx_lattice(config: PyOpenColorIO.Config) -> NDArray[np.uint16]:
    low, high = tone_table.LOG2_RANGE_AGX
    index = np.indices((_NODES_AGX,) * 3).reshape(3, -1).T
    wide = 2.0 ** (low + (high - low) * index / (_NODES_AGX - 1))
    display = _Transform(config, "AgX", "Linear FilmLight E-Gamut")(wide)
    light = linear_from_srgb(torch.from_numpy(display)).numpy()
    code = np.round(65535.0 * light ** (1.0 / 2.4))
    code[np.ptp(index, axis=1) > _BAND] = 0.0
    return code.reshape(_NODES_AGX, _NODES_AGX, _NODES_AGX, 3).astype(np.uint16)


def _random_colours(rng: np.random.Generator) -> Array:
    """Half of them independent channels, half saturated: both ends of what a picture holds."""
    half = _NUM_SAMPLES // 2
    free = 2.0 ** rng.uniform(-12.0, 4.1, (half, 3))
    hue = rng.uniform(0.0, 1.0, (half, 3)) ** 4
    hue /= hue.max(axis=1, keepdims=True)
    return np.concatenate([free, hue * 2.0 ** rng.uniform(-10.0, 4.1, (half, 1))])


def _second_differences(size: int) -> scipy.sparse.csr_matrix:
    """Rows that take the second difference of node values along each axis."""
    nodes = np.arange(size**3).reshape(size, size, size)
    blocks = []
    for axis in range(3):
        along = np.moveaxis(nodes, axis, 0)
        stencil = np.stack([along[:-2].ravel(), along[1:-1].ravel(), along[2:].ravel()], axis=1)
        rows = np.repeat(np.arange(len(stencil)), 3)
        values = np.tile([1.0, -2.0, 1.0], len(stencil))
        shape = (len(stencil), size**3)
        blocks.append(scipy.sparse.csr_matrix((values, (rows, stencil.ravel())), shape=shape))
    return scipy.sparse.vstack(blocks).tocsr()


def _agx_inverse(curve: tone_table.AgxToneCurve, rng: np.random.Generator) -> NDArray[np.int16]:
    linear = torch.from_numpy(_random_colours(rng))
    position = curve.inset_position(linear)
    guess = curve.outset_position(curve.code_from_linear(linear))
    scale = (_NODES_INVERSE - 1) / curve.grey_nodes
    corners, weights = lattice.corner_weights(tuple((guess * scale).unbind(-1)), _NODES_INVERSE)
    rows = np.repeat(np.arange(_NUM_SAMPLES), 4)
    shape = (_NUM_SAMPLES, _NODES_INVERSE**3)
    design = scipy.sparse.csr_matrix(
        (weights.numpy().ravel(), (rows, corners.numpy().ravel())), shape
    )
    smooth = _second_differences(_NODES_INVERSE)
    code = curve.grey_code(position)
    slope = (curve.grey_code(position + 0.5) - curve.grey_code(position - 0.5)).numpy()
    difference = (position - guess).numpy()
    residual = np.empty((_NODES_INVERSE**3, 3))
    for channel in range(3):
        # Errors count as display codes: the flat ends of the curve carry no information.
        weight = scipy.sparse.diags(slope[:, channel] / code.max().item())
        left, right = weight @ design, weight @ difference[:, channel]
        normal = left.T @ left + _SMOOTHNESS * (smooth.T @ smooth)
        normal = (normal + 1e-9 * scipy.sparse.eye(_NODES_INVERSE**3)).tocsr()
        jacobi = scipy.sparse.diags(1.0 / normal.diagonal())
        residual[:, channel], _ = scipy.sparse.linalg.cg(
            normal, left.T @ right, rtol=1e-6, maxiter=1000, M=jacobi
        )
    rounded = np.clip(np.round(1024.0 * residual), -32767, 32767).astype(np.int16)
    return rounded.reshape(_NODES_INVERSE, _NODES_INVERSE, _NODES_INVERSE, 3)


def tabulate(config_path: Path) -> dict[str, NDArray[np.generic]]:
    """All arrays of tone_tables.npz, by name, from the config.ocio of Blender 4.5."""
    config = PyOpenColorIO.Config.CreateFromFile(str(config_path))
    tables: dict[str, NDArray[np.generic]] = {
        "filmic_display": _filmic_table(config).astype(np.float32),
        "agx_matrix": _wide_primaries(config),
        "agx_lattice": _agx_lattice(config),
        "agx_inset": np.array(_INSET),
        "agx_outset": np.array(_OUTSET),
        "agx_inverse": np.zeros((_NODES_INVERSE,) * 3 + (3,), dtype=np.int16),
    }
    curve = tone_table.AgxToneCurve(tables)
    tables["agx_inverse"] = _agx_inverse(curve, np.random.default_rng(0))
    return tables


def main() -> None:
    """Command line: one configuration path, one optional output path."""
    parser = argparse.ArgumentParser(description="Regenerate tone_tables.npz.")
    parser.add_argument("config", type=Path, help="config.ocio of Blender 4.5")
    parser.add_argument("-o", "--output", type=Path, default=tone_table.TABLES_PATH)
    arguments = parser.parse_args()
    beside = arguments.output.with_suffix(".partial.npz")
    np.savez_compressed(beside, **tabulate(arguments.config))
    beside.replace(arguments.output)


if __name__ == "__main__":
    main()
