# SPDX-License-Identifier: Apache-2.0
"""What the report is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Capture
from robir.evaluation.light_scores import RecoveredLight
from robir.export.tiles import Part
from robir.geometry.mesh.triangles import Mesh

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendering:
    """What Blender made for the report."""

    # Cycles pictures of held-out views by name
    rerenders: dict[str, Path] = field(default_factory=dict)
    # Cycles pictures under another light by view's name
    relit: dict[str, Path] = field(default_factory=dict)
    relit_with: str = ""  # name of that light
    missing: tuple[str, ...] = ()  # sentences on what could not be made and how to get it
    # "wall" and "cpu" spent in Blender
    seconds: dict[str, float] = field(default_factory=lambda: {"wall": 0.0, "cpu": 0.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class Products:
    """What the report shows."""

    capture: Capture  # the photographs, those under another light left out
    mesh: Mesh  # the surface, capture frame
    parts: tuple[Part, ...]  # the asset as its GLB file has it
    arrays: dict[str, Array]  # textures as the appearance stage left them
    light: RecoveredLight  # recovered light
    tone_curve: dict[str, Any]  # contents of export/tone_curve.json
    choices: list[dict[str, Any]]  # contents of the choices.json of geometry and appearance
    evidence: list[dict[str, Any]]  # contents of the evidence.json of appearance
    last_word: dict[str, Any] | None  # of its last_word.json; None where photographs were not heard
    exposure: dict[str, Any]  # contents of the appearance stage's exposure.json
    rendering: Rendering  # Blender's part
    # "wall" and "cpu" that the export itself has taken so far, asked for at the end
    seconds: Callable[[], dict[str, float]]
