# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear pictures through a recovered tone curve that is none of Blender's view transforms."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ResultError


@dataclass(frozen=True)
class ToneTable:
    """A two-part .cube file: a curve a channel, then a lattice over its output.

    Attributes:
        reach: Largest linear value of the shaper; more is cut off.
        shaper: (N, 3) curves over 0..reach.
        lattice: (M, M, M, 3) display codes, indexed [blue, green, red] over the shaper's 0..1.
    """

    reach: float
    shaper: np.ndarray
    lattice: np.ndarray

    def display(self, linear: np.ndarray) -> np.ndarray:
        """Display codes 0..1 of linear Rec.709 values (..., 3)."""
        grid = np.linspace(0.0, self.reach, len(self.shaper))
        shaped = [np.interp(linear[..., c], grid, self.shaper[:, c]) for c in range(3)]
        last = len(self.lattice) - 1
        place = np.clip(np.stack(shaped, axis=-1), 0.0, 1.0) * last
        low = np.minimum(place.astype(np.int64), last - 1)
        part = place - low
        total = np.zeros(linear.shape)
        for corner in range(8):
            step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
            red, green, blue = np.moveaxis(low + step, -1, 0)
            weight = np.prod(np.where(step == 1, part, 1.0 - part), axis=-1)
            total += weight[..., None] * self.lattice[blue, green, red]
        return np.clip(total, 0.0, 1.0)


def read_tone_table(path: Path) -> ToneTable:
    """Read a tone_curve.cube of RobIR's."""
    header: dict[str, list[str]] = {}
    rows = []
    try:
        for line in path.read_text(encoding="ascii").splitlines():
            words = line.split()
            if not words or words[0] == "#":
                continue
            if words[0].startswith("LUT_"):
                header[words[0]] = words[1:]
            else:
                rows.append([float(word) for word in words])
        count, size = int(header["LUT_1D_SIZE"][0]), int(header["LUT_3D_SIZE"][0])
        values = np.array(rows)
        return ToneTable(
            reach=float(header["LUT_1D_INPUT_RANGE"][1]),
            shaper=values[:count],
            lattice=values[count:].reshape(size, size, size, 3),
        )
    except (OSError, ValueError, KeyError, IndexError) as fault:
        raise ResultError(
            "{file} cannot be read as a tone curve ({fault}); export the result again",
            file=path,
            fault=fault,
        ) from fault
