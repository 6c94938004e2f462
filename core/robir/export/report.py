# SPDX-License-Identifier: Apache-2.0
"""The report: one self-contained page, pictures first, and the same numbers as JSON."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir import __version__
from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.evaluation.layers import Layers, view_layers
from robir.evaluation.level_table import LEVEL_HEAD, level_cells, level_notes
from robir.evaluation.light_scores import RecoveredLight
from robir.evaluation.photos import Exposures, mean_scores, photo_scores, read_picture
from robir.evaluation.sheet import (
    BACKGROUND,
    MAX_SIDE,
    cut,
    display_codes,
    layer_pictures,
    over_grey,
    window,
)
from robir.export.environment import light_told
from robir.export.page import page_template
from robir.export.textures import UNCERTAINTY_AT_255
from robir.export.tiles import shown_texture
from robir.export.trust import paint, quality, rivals, shown
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, read_json, replacing, write_json

Array = NDArray[np.floating[Any]]
Picture = NDArray[np.uint8]

CONTACT_SIDE = 160
"""Side of each of the four pictures of `contact.jpg`, pixels."""

_MAX_ROWS = 4
_LEVELS_START, _LEVELS_END = '<section id="levels">', "</section>"
_NOT_MEASURED = (
    "which stage loses the photographs: `robir evaluate OUT` says it, here too",
    "albedo, roughness, normals and light against truth: `robir evaluate OUT --truth CAPTURE` "
    "does that for rendered captures",
    "the object's underside and whatever no camera saw",
)


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
    arrays: dict[str, Array]
    light: RecoveredLight
    tone_curve: dict[str, Any]
    choices: list[dict[str, Any]]
    evidence: list[dict[str, Any]]
    last_word: dict[str, Any] | None
    exposure: dict[str, Any]
    rendering: Rendering
    seconds: Callable[[], dict[str, float]]


def write_report(paths: JobPaths, products: Products) -> dict[str, Any]:
    """Write report/index.html, report/report.json and report/contact.jpg.

    Returns:
        The JSON's content.
    """
    views = products.capture.held_out or products.capture.train
    own = _own_rerenders(paths)
    shown = _shown_views(views, products.rendering)
    cameras = [_fine(view.camera) for view in shown]
    layers = view_layers(products.mesh, products.arrays, cameras, sub_pixels=1)
    rows = [
        _row(view, seen, own, products.rendering) for view, seen in zip(shown, layers, strict=True)
    ]
    _write_contact(paths.contact, shown[0], layers[0], own, products.rendering)
    numbers = _numbers(paths, products, own)
    write_json(paths.report_json, numbers)
    text = page_template("robir.export", "report.html").render(
        rows=rows,
        numbers=numbers,
        tone_plot=_inline(paths.tone_plot.read_bytes()),
        environment=_inline_picture(_environment_picture(products.light)),
        textures=[
            (name, _inline_picture(picture))
            for name in ("albedo", "roughness", "metallic", "coverage", "uncertainty")
            if (picture := shown_texture(paths, name)) is not None
        ],
        tiles=products.mesh.tiles.tolist(),
        relit_with=products.rendering.relit_with,
    )
    with replacing(paths.report) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return numbers


def show_levels(paths: JobPaths, levels: dict[str, Any]) -> None:
    """Put the levels' table and pictures into a report that is there already.

    Args:
        paths: Result folder; without a report nothing happens.
        levels: As `robir.evaluation.levels.level_scores` gives them.
    """
    if not paths.report.is_file():
        return
    section = page_template("robir.export", "levels.html").render(
        head=LEVEL_HEAD,
        rows=level_cells(levels),
        notes=level_notes(levels),
        strip=_inline(paths.levels_strip.read_bytes()) if levels["views"] else "",
    )
    page = paths.report.read_text(encoding="utf-8")
    before, mark, after = page.partition(_LEVELS_START)
    if mark:
        after = after.partition(_LEVELS_END)[2]
    else:  # a report of an older version
        before, mark, after = page.partition("<h2>")
        after = mark + after
    with replacing(paths.report) as temporary:
        temporary.write_text(before + section + after, encoding="utf-8")


def _own_rerenders(paths: JobPaths) -> dict[str, Picture]:
    return stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)


def _shown_views(views: tuple[View, ...], rendering: Rendering) -> list[View]:
    """Rendered views where there are any, else evenly chosen ones."""
    rendered = [view for view in views if view.name in rendering.rerenders]
    if rendered:
        return rendered[:_MAX_ROWS]
    picked = np.linspace(0, len(views) - 1, min(_MAX_ROWS, len(views))).round().astype(int)
    return [views[index] for index in picked]


def _row(
    view: View, layers: Layers, own: dict[str, Picture], rendering: Rendering
) -> dict[str, Any]:
    """Pictures of one view as data addresses, cut to the object; None where there is none."""
    again, how = _rerender(view, own, rendering)
    relit = rendering.relit.get(view.name)
    pictures = {
        "photo": np.dstack([view.image_display, view.mask]),
        "rerender": again,
        **{name: np.dstack([p, _alpha(layers)]) for name, p in layer_pictures(layers).items()},
        "relit": None if relit is None else read_picture(relit),
    }
    frame = window(view.mask)
    shown = {
        name: None if picture is None else _inline_picture(cut(picture, frame))
        for name, picture in pictures.items()
    }
    return {"name": view.name, "rerender_by": how if again is not None else "", **shown}


def _rerender(
    view: View, own: dict[str, Picture], rendering: Rendering
) -> tuple[Picture | None, str]:
    """A view rendered again and by what: Cycles where there is such a picture."""
    if view.name in rendering.rerenders:
        return read_picture(rendering.rerenders[view.name]), "Cycles"
    return own.get(view.name), "our own renderer"


def _alpha(layers: Layers) -> Picture:
    return np.where(layers.hit, 255, 0).astype(np.uint8)


def _write_contact(
    path: Path, view: View, layers: Layers, own: dict[str, Picture], rendering: Rendering
) -> None:
    """Write a view's photograph, re-render, albedo and trust as one small picture.

    Trust is white where albedo is certain, black where its standard error reaches one natural-log
    unit.
    """
    alpha, frame = _alpha(layers), window(view.mask)
    pictures = [np.dstack([view.image_display, view.mask]), _rerender(view, own, rendering)[0]]
    pictures.append(np.dstack([layer_pictures(layers)["albedo"], alpha]))
    if layers.uncertainty is not None:
        pictures.append(np.dstack([display_codes(1.0 - layers.uncertainty), alpha]))
    sheet = Image.new("RGB", (4 * CONTACT_SIDE, CONTACT_SIDE), (BACKGROUND,) * 3)
    for index, picture in enumerate(pictures):
        if picture is not None:
            tile = Image.fromarray(over_grey(cut(picture, frame)))
            tile = tile.resize((CONTACT_SIDE, CONTACT_SIDE), Image.Resampling.LANCZOS)
            sheet.paste(tile, (index * CONTACT_SIDE, 0))
    with replacing(path) as temporary:
        sheet.save(temporary, format="JPEG", quality=88)


def _fine(camera: Camera) -> Camera:
    """The camera with enough pixels for smooth outlines on the page."""
    factor = max(1, round(MAX_SIDE / max(camera.width, camera.height)))
    return camera.resized(factor * camera.width, factor * camera.height)


def _numbers(paths: JobPaths, products: Products, own: dict[str, Picture]) -> dict[str, Any]:
    """Contents of report.json."""
    capture, rendering = products.capture, products.rendering
    by_name = {view.name: view for view in capture.views}
    run = read_json(paths.run)
    exposures = Exposures.of(products.exposure, products.tone_curve, products.mesh)
    held_out = mean_scores(
        [photo_scores(image, by_name[name]) for name, image in own.items() if name in by_name]
    )
    cycles = mean_scores(
        [
            photo_scores(
                exposures.as_photographed(read_picture(file), by_name[name]), by_name[name]
            )
            for name, file in rendering.rerenders.items()
        ]
    )
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
        "preset": run["preset"],
        "seed": run["seed"],
        "trust": quality(
            capture,
            products.mesh,
            products.arrays,
            held_out["psnr"],
            rivals(products.tone_curve["candidates"])
            | paint(products.evidence)
            | shown(products.last_word),
        ),
        "held_out": held_out,
        "cycles": cycles,
        "tone_curve": curve,
        "choices": {choice["choice"]: choice for choice in products.choices},
        "light_level": light_told(products.evidence, "level"),
        "light_hue": light_told(products.evidence, "hue"),
        "exposure": exposure_summary(products.exposure),
        "light": _light_summary(products.light),
        "mesh": {"faces": len(products.mesh.faces), "vertices": len(products.mesh.vertices)},
        **_texture_sizes(products),
        "seen_share": _seen_share(products.arrays),
        "metal_share": float(products.arrays["metallic"][products.arrays["inside"] > 0].mean()),
        "uncertainty": _uncertainty(products.arrays),
        "warnings": run["warnings"],
        "missing": list(rendering.missing),
        "not_measured": list(_NOT_MEASURED),
        "seconds": seconds
        | {"export": _rounded(products.seconds()), "rendering": _rounded(rendering.seconds)},
    }


def exposure_summary(exposure: dict[str, Any]) -> dict[str, Any]:
    """How photographs were exposed, for report.json.

    Args:
        exposure: "steps" (log2) of each channel by the view's name, empty where all are alike, and
            "corner_steps" by which the corners of all are darker than the middle, and
            "other_light", names of the photographs that were left out for it; "slope_steps" of
            each where they are in lights of their own.

    Returns:
        "is_even"; "own_lights"; "other_light"; "spread_steps", standard deviation of the exposures;
        "views" by name, brightest first, each with its "exposure" (mean of the channels) and the
        "white_balance" of red and blue against green, in steps; "corner_steps".
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


def _texture_sizes(products: Products) -> dict[str, Any]:
    """Texels along a side of a texture, and the numbers of the tiles where there are such."""
    side = products.arrays["inside"].shape[0] // products.mesh.cells
    tiles = products.mesh.tiles.tolist()
    return {"texture_size": side} | ({"tiles": tiles} if tiles else {})


def _seen_share(arrays: dict[str, Array]) -> float:
    """Share of the surface's texels that at least one training view saw."""
    inside = arrays["inside"].astype(bool)
    return float((arrays["coverage"][inside] > 0).mean()) if inside.any() else 0.0


def _uncertainty(arrays: dict[str, Array]) -> dict[str, Any]:
    """What uncertainty.png holds, and its median over what a training view saw."""
    seen = arrays["inside"].astype(bool) & (arrays["coverage"] > 0)
    return {
        "quantity": "standard error of the natural logarithm of albedo, up to one factor a channel",
        "at_code_255": UNCERTAINTY_AT_255,
        "median": float(np.median(arrays["uncertainty"][seen])) if seen.any() else None,
    }


def _environment_picture(light: RecoveredLight) -> Picture:
    """The environment with its median at mid-grey; suns burn out."""
    image = light.environment(128)
    grey = max(float(np.median(image.mean(axis=-1))), 1e-6)
    return display_codes((0.18 * image / grey / (1.0 + 0.18 * image / grey)) ** (1 / 2.2))


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in seconds.items()}


def _inline_picture(picture: Picture) -> str:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG")
    return _inline(stream.getvalue())


def _inline(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
