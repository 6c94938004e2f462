# SPDX-License-Identifier: Apache-2.0
"""Tone curve families, from linear Rec.709 radiance to sRGB display codes and back: the one door.

`families()` lists the candidates, simplest first; `curve_from_name` rebuilds one from what
tone_curve.json holds. See tone_curve.py for the conventions all of them share.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
import torch

from robir.errors import ConfigError
from robir.maths.tone_curve import (
    DISPLAY_POWER,
    MAX_LINEAR,
    SATURATION_LEVEL,
    AbstractToneCurve,
    PoweredToneCurve,
    linear_from_srgb,
    powered,
    srgb_from_linear,
)
from robir.maths.tone_formula import (
    AcesToneCurve,
    CameraToneCurve,
    KhronosNeutralToneCurve,
    StandardToneCurve,
)
from robir.maths.tone_table import AgxToneCurve, FilmicToneCurve, load_tables

__all__ = [
    "MAX_LINEAR",
    "SATURATION_LEVEL",
    "AbstractToneCurve",
    "AcesToneCurve",
    "AgxToneCurve",
    "CameraToneCurve",
    "FilmicToneCurve",
    "KhronosNeutralToneCurve",
    "PoweredToneCurve",
    "StandardToneCurve",
    "as_samples",
    "cube_text",
    "curve_from_name",
    "families",
    "linear_from_srgb",
    "powered",
    "srgb_from_linear",
]

_NUM_SHAPER = 16384
_LOG_KNEE = 2.0**-8


@functools.cache
def families() -> tuple[AbstractToneCurve, ...]:
    """Candidate curves, simplest first: by tables they need, then by free parameters.

    RobIR's ACES stands at its start value; fit its tone_gamma.
    """
    tables = load_tables()
    return (
        StandardToneCurve(),
        CameraToneCurve(),
        FilmicToneCurve(tables),
        KhronosNeutralToneCurve(),
        AgxToneCurve(tables),
        AcesToneCurve(),
    )


def curve_from_name(name: str, parameters: Mapping[str, float] | None = None) -> AbstractToneCurve:
    """Curve of a family name and its parameters, as tone_curve.json holds them.

    Every family takes `display_power` beside its own, see `PoweredToneCurve`. `ConfigError` if the
    family is unknown or the parameters are not its own.
    """
    known = {curve.name: curve for curve in families()}
    if name not in known:
        raise ConfigError(f"tone curve family '{name}' is unknown; known are {', '.join(known)}")
    curve, given = known[name], dict(parameters or {})
    power = given.pop(DISPLAY_POWER, 1.0)
    if set(given) - set(curve.parameters):
        raise ConfigError(
            f"tone curve {name}: parameters {sorted(given)} given, it has "
            f"{sorted(curve.parameters)}; remove the others"
        )
    return powered(type(curve)(**given) if given else curve, power)


def as_samples(curve: AbstractToneCurve, count: int) -> dict[str, list[float]]:
    """Grey samples of a curve, even in log2 from 2^-10 to MAX_LINEAR, for JSON and plots.

    "linear" (grey radiance) and "display" (code 0..1, mean of the channels).
    """
    linear = 2.0 ** np.linspace(-10.0, np.log2(MAX_LINEAR), count)
    grey = torch.from_numpy(linear)[:, None].expand(-1, 3)
    display = curve.display_from_linear(grey).mean(-1)
    return {"linear": linear.tolist(), "display": display.tolist()}


def cube_text(curve: AbstractToneCurve, size: int) -> str:
    """The curve as a .cube file that OpenColorIO and DaVinci Resolve read.

    One file, two parts: a 1-D shaper over linear input 0..MAX_LINEAR, then a size^3 table over the
    shaper's 0..1, red fastest. Curves that treat channels apart are their own shaper and the table
    repeats its input; others get s = log2(1 + 256 x) / log2(1 + 256 MAX_LINEAR) and are sampled.
    Input is linear Rec.709, output sRGB display codes.
    """
    linear = torch.linspace(0.0, MAX_LINEAR, _NUM_SHAPER, dtype=torch.float64)
    axis = torch.linspace(0.0, 1.0, size, dtype=torch.float64)
    blue, green, red = torch.meshgrid(axis, axis, axis, indexing="ij")
    nodes = torch.stack([red, green, blue], dim=-1).reshape(-1, 3)
    if curve.mixes_channels:
        span = np.log2(1.0 + MAX_LINEAR / _LOG_KNEE)
        shaper = (torch.log2(1.0 + linear / _LOG_KNEE) / span)[:, None].expand(-1, 3)
        nodes = curve.display_from_linear((torch.exp2(nodes * span) - 1.0) * _LOG_KNEE)
    else:
        shaper = curve.display_from_linear(linear[:, None].expand(-1, 3))
    header = [
        # OpenColorIO's reader of two-part files knows comments, but no TITLE.
        f"# {curve.name}: linear Rec.709 to sRGB display",
        f"LUT_1D_SIZE {_NUM_SHAPER}",
        f"LUT_1D_INPUT_RANGE 0.0 {MAX_LINEAR}",
        f"LUT_3D_SIZE {size}",
        "LUT_3D_INPUT_RANGE 0.0 1.0",
    ]
    rows = torch.cat([shaper, nodes]).tolist()
    return "\n".join(header + [f"{r:.6f} {g:.6f} {b:.6f}" for r, g, b in rows]) + "\n"
