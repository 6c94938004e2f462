# SPDX-License-Identifier: Apache-2.0
"""Tone curves given by tables: Blender 4.5's Filmic and AgX.

The tables in tone_tables.npz are samples of the transforms, made by `robir_bench.tone_tabulate`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.maths import tetrahedral as lattice
from robir.maths.tetrahedral import ColourLattice, Planes
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

Tables = Mapping[str, NDArray[Any]]
_Rows = tuple[tuple[float, ...], ...]


@functools.cache
def load_tables() -> Tables:
    """Arrays of tone_tables.npz by name, read once."""
    with np.load(TABLES_PATH, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _rows(matrix: NDArray[Any]) -> _Rows:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def _mix(matrix: _Rows, rgb: Planes) -> Planes:
    """Product of a constant 3 x 3 matrix with planar colours."""
    return tuple(row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2] for row in matrix)


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

    The inverse starts from a fitted table and takes damped Newton steps on the forward table: codes
    come back within 0.0016, above linear 4 within 0.012 where a channel has all but run into white.
    The table's values are called code: display light to the power 1 / 2.4.
    """

    name = "agx"
    blender_view_transform = "AgX"
    mixes_channels = True
    _damping = 1e-4
    _reach = 1.5
    _tolerance = 1.5e-3
    _restarts = (0.03, 0.1, 0.3)

    def __init__(self, tables: Tables) -> None:
        """Read the `agx_*` arrays of the tables."""
        nodes = torch.from_numpy(tables["agx_lattice"].astype(np.float32) / 65535.0)
        low, high = LOG2_RANGE_AGX
        size = nodes.shape[0]
        self._per_stop = (size - 1) / (high - low)
        self._lattice = ColourLattice.from_nodes(nodes)
        self._inverse = ColourLattice.from_nodes(
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
        table = self._lattice.like(rgb_display)
        light = linear_from_srgb(rgb_display.clamp(0.0, 1.0)).reshape(-1, 3)
        found = chunked(self._first_guess(rgb_display), light)
        code = light.pow(1.0 / 2.4)
        found, error = self._descend(table, found, code, 1)
        for blend in self._restarts:
            hard = (error.detach() > self._tolerance**2).nonzero()[:, 0]
            old = found[hard]
            # Where a channel has run into black or white its slope is gone; less saturated
            # colours lie off those plateaus.
            start = torch.lerp(old, old.mean(-1, keepdim=True), blend)
            new, new_error = self._descend(table, start, code[hard], 8)
            better = new_error < error[hard]
            found = found.index_put((hard,), torch.where(better[:, None], new, old))
            error = error.index_put((hard,), torch.minimum(new_error, error[hard]))
        return found.reshape(rgb_display.shape)

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

    def _first_guess(self, like: Tensor) -> Callable[[Planes], Planes]:
        """Function from display light to radiance by the fitted inverse table."""
        inverse, grey = self._inverse.like(like), self._grey.to(like)
        scale = (inverse.size - 1) / self.grey_nodes

        def guess(light: Planes) -> Planes:
            near = self._outset_position(light, grey)
            rest = lattice.interpolate(inverse, each(lambda x: x * scale, near))
            inset = self._light((near[0] + rest[0], near[1] + rest[1], near[2] + rest[2]))
            return each(_bounded, _mix(self._uninset, inset))

        return guess

    def _descend(
        self, table: ColourLattice, start: Tensor, code: Tensor, num_steps: int
    ) -> tuple[Tensor, Tensor]:
        """Best radiance (N, 3) found from a start, and its squared error (N,)."""

        def descend(planes: Planes) -> Planes:
            return self._descend_planes(table, planes[:3], planes[3:], num_steps)

        found = chunked(descend, torch.cat([start, code], dim=-1))
        return found[..., :3], found[..., 3]

    def _descend_planes(
        self, table: ColourLattice, start: Planes, code: Planes, num_steps: int
    ) -> Planes:
        """Damped Newton steps, each halved while it makes things worse; radiance and error."""
        best, trial = start, start
        least = torch.full_like(code[0], torch.inf)
        for step in range(num_steps + 1):
            moved, error = lattice.step_towards(
                table, self._position(trial), code, self._damping, self._reach
            )
            better = error < least
            best = _chosen(better, trial, best)
            least = torch.minimum(error, least)
            if step < num_steps:
                ahead = each(_bounded, _mix(self._narrow, self._light(moved)))
                back = tuple(0.5 * (t + b) for t, b in zip(trial, best, strict=True))
                trial = _chosen(better, ahead, back)
        return *best, least

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


def _chosen(first_if: Tensor, first: Planes, second: Planes) -> Planes:
    return tuple(torch.where(first_if, a, b) for a, b in zip(first, second, strict=True))
