# SPDX-License-Identifier: Apache-2.0
"""Tone curves given by tables: Blender 4.5's Filmic and AgX.

The tables in tone_tables.npz are samples of the transforms, made by tone_tabulate.py.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.maths import lattice
from robir.maths.lattice import Lattice, Planes
from robir.maths.tone_curve import (
    MAX_LINEAR,
    AbstractToneCurve,
    chunked,
    each,
    linear_from_srgb,
    srgb_from_linear,
)

TABLES_PATH = Path(__file__).with_name("tone_tables.npz")
LOG2_RANGE_FILMIC = (-12.473931188, 4.026068812)
LOG2_RANGE_AGX = (-12.47393, 12.5260688117)

Tables = Mapping[str, NDArray[np.generic]]
_Rows = tuple[tuple[float, ...], ...]


@functools.cache
def load_tables() -> Tables:
    """Arrays of tone_tables.npz by name, read once."""
    with np.load(TABLES_PATH, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _rows(matrix: NDArray[np.generic]) -> _Rows:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def _mix(matrix: _Rows, rgb: Planes) -> Planes:
    """Product of a constant 3 x 3 matrix with planar colours."""
    mixed = [row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2] for row in matrix]
    return mixed[0], mixed[1], mixed[2]


class FilmicToneCurve(AbstractToneCurve):
    """Blender's Filmic, per channel, from a table over log2 radiance.

    Per channel to 0.002 up to linear 8; above, Blender also desaturates, which is left out. The
    darkest inverse is 2^-12.47, which stands for code 0.
    """

    name = "filmic"
    blender_view_transform = "Filmic"

    def __init__(self, tables: Tables) -> None:
        """Read `filmic_display` from the tables."""
        self._display = torch.from_numpy(np.ascontiguousarray(tables["filmic_display"]))
        low, high = LOG2_RANGE_FILMIC
        self._low = low
        self._per_stop = (self._display.shape[0] - 1) / (high - low)

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        position = (torch.log2(rgb_linear.clamp_min(2.0**self._low)) - self._low) * self._per_stop
        return lattice.interpolate_1d(self._display.to(rgb_linear), position)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        table = self._display.to(rgb_display)
        position = lattice.invert_1d(table, rgb_display)
        return torch.exp2(position / self._per_stop + self._low).clamp(max=MAX_LINEAR)


class AgxToneCurve(AbstractToneCurve):
    """Blender's AgX: logarithms in wide primaries, a 3-D table, tetrahedral interpolation.

    The inverse starts from a fitted table in coordinates where AgX is almost per channel, and takes
    damped Newton steps on the forward table; the better of start and steps is kept. The table's
    values are called code: display light to the power 1 / 2.4.
    """

    name = "agx"
    blender_view_transform = "AgX"
    mixes_channels = True
    _num_steps = 2
    _damping = 1e-4
    _reach = 1.5

    def __init__(self, tables: Tables) -> None:
        """Read the `agx_*` arrays of the tables."""
        nodes = torch.from_numpy(tables["agx_lattice"].astype(np.float32) / 65535.0)
        low, high = LOG2_RANGE_AGX
        size = nodes.shape[0]
        self._per_stop = (size - 1) / (high - low)
        self._lattice = Lattice.from_nodes(nodes)
        self._inverse = Lattice.from_nodes(
            torch.from_numpy(tables["agx_inverse"].astype(np.float32) / 1024.0)
        )
        self._wide = _rows(tables["agx_matrix"])
        self._narrow = _rows(np.linalg.inv(tables["agx_matrix"]))
        self._inset = _rows(tables["agx_inset"])
        self._uninset = _rows(np.linalg.inv(tables["agx_inset"]))
        self._outset = _rows(tables["agx_outset"])
        index = torch.arange(size)
        diagonal = nodes[index, index, index].mean(-1)
        self._grey = diagonal[: int((diagonal < 1.0).sum()) + 1]

    @property
    def grey_nodes(self) -> int:
        """Index of the node at which grey reaches white."""
        return self._grey.shape[0] - 1

    def display_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        return srgb_from_linear(self.code_from_linear(rgb_linear).pow(2.4)).clamp(max=1.0)

    def linear_from_display(self, rgb_display: Tensor) -> Tensor:
        """See AbstractToneCurve."""
        forward, inverse = self._lattice.like(rgb_display), self._inverse.like(rgb_display)
        grey = self._grey.to(rgb_display)
        scale = (inverse.size - 1) / self.grey_nodes

        def invert(display: Planes) -> Planes:
            light = each(linear_from_srgb, display)
            code = each(lambda x: x.pow(1.0 / 2.4), light)
            guess = self._outset_position(light, grey)
            rest = lattice.interpolate(inverse, each(lambda x: x * scale, guess))
            inset = self._light((guess[0] + rest[0], guess[1] + rest[1], guess[2] + rest[2]))
            found = each(_bounded, _mix(self._uninset, inset))
            return self._refined(forward, found, code)

        return chunked(invert, rgb_display.clamp(0.0, 1.0))

    def code_from_linear(self, rgb_linear: Tensor) -> Tensor:
        """Display light to the power 1 / 2.4, which the table holds, (..., 3)."""
        table = self._lattice.like(rgb_linear)
        return chunked(lambda rgb: lattice.interpolate(table, self._position(rgb)), rgb_linear)

    def inset_position(self, rgb_linear: Tensor) -> Tensor:
        """Position on the grey curve, in nodes, of radiance in the inset primaries; for fitting."""
        return chunked(lambda rgb: self._node(_mix(self._inset, rgb)), rgb_linear)

    def outset_position(self, code: Tensor) -> Tensor:
        """Position on the grey curve, in nodes, of codes without the outset; for fitting."""
        grey = self._grey.to(code)
        return chunked(
            lambda rgb: self._outset_position(each(lambda x: x.pow(2.4), rgb), grey), code
        )

    def grey_code(self, position: Tensor) -> Tensor:
        """Code of the grey curve at a position in nodes; for fitting."""
        return lattice.interpolate_1d(self._grey.to(position), position)

    def _refined(self, table: Lattice, found: Planes, code: Planes) -> Planes:
        """Damped Newton steps on the forward table; a step that makes things worse is undone."""
        best, least = found, None
        for step in range(self._num_steps + 1):
            position = self._position(found)
            moved, error = lattice.step_towards(table, position, code, self._damping, self._reach)
            if least is None:
                best, least = found, error
            else:
                better = error < least
                kept = [torch.where(better, new, old) for new, old in zip(found, best, strict=True)]
                best, least = (kept[0], kept[1], kept[2]), torch.minimum(error, least)
            if step < self._num_steps:
                found = each(_bounded, _mix(self._narrow, self._light(moved)))
        return best

    def _outset_position(self, light: Planes, grey: Tensor) -> Planes:
        mixed = _mix(self._outset, light)
        return each(lambda x: lattice.invert_1d(grey, x.pow(1.0 / 2.4)), mixed)

    def _position(self, rgb: Planes) -> Planes:
        return self._node(_mix(self._wide, rgb))

    def _node(self, light: Planes) -> Planes:
        low = LOG2_RANGE_AGX[0]
        return each(lambda x: (torch.log2(x.clamp_min(2.0**low)) - low) * self._per_stop, light)

    def _light(self, position: Planes) -> Planes:
        return each(lambda x: torch.exp2(x / self._per_stop + LOG2_RANGE_AGX[0]), position)


def _bounded(linear: Tensor) -> Tensor:
    return linear.clamp(0.0, MAX_LINEAR)
