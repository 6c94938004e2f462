# SPDX-License-Identifier: GPL-3.0-or-later
"""The recovered tone curve as the scene's view transform, or as a table where it is none."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import Sentence
from ..errors import ResultError
from ..words import told


def match_view_transform(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> tuple[str, ...]:
    """Show the scene as the photographs do; a sentence where this Blender has no such curve."""
    wanted, settings = tone_curve["blender_view_transform"], scene.view_settings
    settings.look = "None"
    settings.exposure = tone_curve["exposure"]
    try:
        settings.view_transform = wanted or "Standard"
    except TypeError:  # not in this Blender's list
        settings.view_transform, wanted = "Standard", None
    settings.gamma = _gamma(tone_curve) if wanted else 1.0
    if wanted:
        return ()
    return (
        Sentence(
            "the recovered tone curve ({family}) is none of Blender's view transforms: the "
            "viewport shows Standard; rendered files go through export/tone_curve.cube",
            family=tone_curve["family"],
        ),
    )


def view_transform_differs(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> bool:
    """Whether the scene is shown through another curve than the photographs."""
    settings, named = scene.view_settings, tone_curve["blender_view_transform"]
    if (settings.view_transform, settings.look) != (named or "Standard", "None"):
        return True
    gamma = _gamma(tone_curve) if named else 1.0
    distance = max(abs(settings.exposure - tone_curve["exposure"]), abs(settings.gamma - gamma))
    return distance > 1e-4


def view_name(tone_curve: dict[str, Any]) -> str:
    """The recovered curve in the terms of Blender's colour management."""
    named, gamma = tone_curve["blender_view_transform"], _gamma(tone_curve)
    if not named:
        return told("another curve")
    return named if gamma == 1.0 else told("{name} with gamma {gamma:g}", name=named, gamma=gamma)


def _gamma(tone_curve: dict[str, Any]) -> float:
    """Blender's gamma, which comes after the view transform; curves written earlier have none."""
    return tone_curve.get("blender_gamma", 1.0)


@dataclass(frozen=True)
class ToneTable:
    """A two-part .cube file: a curve a channel, then a lattice over its output."""

    reach: float  # largest linear value of the shaper; more is cut off
    shaper: np.ndarray  # (N, 3) curves over 0..reach
    lattice: np.ndarray  # (M, M, M, 3) codes, indexed [blue, green, red] over the shaper's 0..1

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
