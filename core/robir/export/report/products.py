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
    """What Blender made for the report.

    Attributes:
        rerenders: Cycles pictures of held-out views by name.
        relit: Cycles pictures under another light by view's name.
        relit_with: Name of that light.
        missing: Sentences on what could not be made and how to get it.
        seconds: "wall" and "cpu" spent in Blender.
    """

    rerenders: dict[str, Path] = field(default_factory=dict)
    relit: dict[str, Path] = field(default_factory=dict)
    relit_with: str = ""
    missing: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=lambda: {"wall": 0.0, "cpu": 0.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class Products:
    """What the report shows.

    Attributes:
        capture: The photographs, those under another light left out.
        mesh: The surface, capture frame.
        parts: The asset as its GLB file has it.
        arrays: Textures as the appearance stage left them.
        light: Recovered light.
        tone_curve: Contents of export/tone_curve.json.
        choices: Contents of the choices.json of geometry and appearance.
        evidence: Contents of the evidence.json of appearance.
        last_word: Of its last_word.json; None where photographs were not heard.
        exposure: Contents of the appearance stage's exposure.json.
        rendering: Blender's part.
        seconds: "wall" and "cpu" that the export itself has taken so far, asked for at the end.
    """

    capture: Capture
    mesh: Mesh
    parts: tuple[Part, ...]
    arrays: dict[str, Array]
    light: RecoveredLight
    tone_curve: dict[str, Any]
    choices: list[dict[str, Any]]
    evidence: list[dict[str, Any]]
    last_word: dict[str, Any] | None
    exposure: dict[str, Any]
    rendering: Rendering
    seconds: Callable[[], dict[str, float]]
