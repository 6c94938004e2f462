# SPDX-License-Identifier: Apache-2.0
"""What the report is made of, and its numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir import __version__
from robir.capture.capture import Capture
from robir.evaluation.light import RecoveredLight
from robir.evaluation.photos import Exposures, mean_scores, photo_scores, read_picture
from robir.export.exchange import light_told
from robir.export.textures import UNCERTAINTY_AT_255, TexturedPart
from robir.export.trust import paint, quality, rivals, shown
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, read_json

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendering:
    """What Blender made for the report."""

    rerenders: dict[str, Path] = field(default_factory=dict)  # Cycles, held-out views
    relit: dict[str, Path] = field(default_factory=dict)  # Cycles, another light
    relit_with: str = ""  # name of that light
    missing: tuple[str, ...] = ()  # sentences on what could not be made and how to get it
    # "wall" and "cpu" spent in Blender
    seconds: dict[str, float] = field(default_factory=lambda: {"wall": 0.0, "cpu": 0.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class Products:
    """What the report shows."""

    capture: Capture  # the photographs, those under another light left out
    mesh: Mesh  # the surface, capture frame
    parts: tuple[TexturedPart, ...]  # the asset as its GLB file has it
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


Picture = NDArray[np.uint8]

_NOT_MEASURED = (
    "which stage loses the photographs: `robir evaluate OUT` says it, here too",
    "albedo, roughness, normals and light against truth: `robir evaluate OUT --truth CAPTURE` "
    "does that for rendered captures",
    "the object's underside and whatever no camera saw",
)


def report_numbers(paths: JobPaths, products: Products, own: dict[str, Picture]) -> dict[str, Any]:
    """Contents of report.json."""
    capture, rendering = products.capture, products.rendering
    by_name = {view.name: view for view in capture.views}
    run = read_json(paths.run)
    exposures = Exposures.of(products.exposure, products.tone_curve, products.mesh)
    held_out = mean_scores(
        [photo_scores(image, by_name[name]) for name, image in own.items() if name in by_name]
    )
    files = [(by_name[name], read_picture(file)) for name, file in rendering.rerenders.items()]
    shots = [(view, exposures.as_photographed(picture, view)) for view, picture in files]
    cycles = mean_scores([photo_scores(picture, view) for view, picture in shots])
    arrays, tiles = products.arrays, products.mesh.tiles.tolist()
    inside = arrays["inside"] > 0
    left_open = rivals(products.tone_curve["candidates"])
    left_open |= paint(products.evidence) | shown(products.last_word)
    curve = {name: value for name, value in products.tone_curve.items() if name != "samples"}
    seconds = {stage: run["seconds"][stage] for stage in run["seconds"] if stage != "export"}
    return {
        "robir_version": __version__,
        "capture": {
            "source": str(capture.source),
            "format": capture.format,
            "train_views": len(capture.train),
            "held_out_views": len(capture.held_out),
            "image_size": [capture.views[0].camera.width, capture.views[0].camera.height],
        },
        "device": run["device"],
        "seed": run["seed"],
        "trust": quality(capture, products.mesh, products.arrays, held_out["psnr"], left_open),
        "held_out": held_out,
        "cycles": cycles,
        "tone_curve": curve,
        "choices": {choice["choice"]: choice for choice in products.choices},
        "light_level": light_told(products.evidence, "level"),
        "light_hue": light_told(products.evidence, "hue"),
        "exposure": exposure_summary(products.exposure),
        "light": _light_summary(products.light),
        "mesh": {"faces": len(products.mesh.faces), "vertices": len(products.mesh.vertices)},
        "texture_size": inside.shape[0] // products.mesh.cells,  # texels along a side
        **({"tiles": tiles} if tiles else {}),
        "seen_share": float((arrays["coverage"][inside] > 0).mean()) if inside.any() else 0.0,
        "metal_share": float(arrays["metallic"][inside].mean()),
        "uncertainty": _uncertainty(products.arrays),
        "warnings": run["warnings"],
        "missing": list(rendering.missing),
        "not_measured": list(_NOT_MEASURED),
        "seconds": seconds
        | {"export": _rounded(products.seconds()), "rendering": _rounded(rendering.seconds)},
    }


def exposure_summary(exposure: dict[str, Any]) -> dict[str, Any]:
    """How photographs were exposed, for report.json, by the contents of exposure.json.

    "is_even"; "own_lights"; "other_light"; "spread_steps", standard deviation of the exposures in
    stops; "views" by name, brightest first, each with its "exposure" (mean of the channels) and the
    "white_balance" of red and blue against green, in stops; "corner_steps".
    """
    views = {
        name: {
            "exposure": round(sum(rgb) / 3, 3),
            "white_balance": [round(rgb[0] - rgb[1], 3), round(rgb[2] - rgb[1], 3)],
        }
        for name, rgb in sorted(exposure["steps"].items(), key=lambda item: -sum(item[1]))
    }
    spread = float(np.std([view["exposure"] for view in views.values()])) if views else 0.0
    return {
        "is_even": not views,
        "own_lights": bool(exposure["slope_steps"]),
        "other_light": exposure["other_light"],
        "spread_steps": round(spread, 3),
        "corner_steps": round(exposure["corner_steps"], 3),
        "views": views,
    }


def _light_summary(light: RecoveredLight) -> dict[str, Any]:
    """Counts, and the sharp lobes by elevation, azimuth and share of the whole power."""
    power = light.power()
    suns = []
    for index in np.nonzero(light.is_sharp)[0]:
        x, y, z = (float(value) for value in light.lobes.axis[index])
        suns.append(
            {
                "axis": [x, y, z],
                "elevation_degrees": float(np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))),
                "azimuth_degrees": float(np.degrees(np.arctan2(y, x))),
                "power_share": float(power[index] / max(power.sum(), 1e-12)),
            }
        )
    suns.sort(key=lambda sun: -sun["power_share"])
    return {"lobes": len(power), "sharp": suns}


def _uncertainty(arrays: dict[str, Array]) -> dict[str, Any]:
    """What uncertainty.png holds, and its median over what a training view saw."""
    seen = arrays["inside"].astype(bool) & (arrays["coverage"] > 0)
    return {
        "quantity": "standard error of the natural logarithm of albedo, up to one factor a channel",
        "at_code_255": UNCERTAINTY_AT_255,
        "median": float(np.median(arrays["uncertainty"][seen])) if seen.any() else None,
    }


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in seconds.items()}
