# SPDX-License-Identifier: Apache-2.0
"""Writes the report's page, its numbers and the small picture for a contact sheet."""

from __future__ import annotations

import base64
import hashlib
import re
from typing import Any

from markupsafe import Markup

from robir.evaluation.layers import view_layers
from robir.evaluation.levels import LEVEL_HEAD, level_cells, level_notes
from robir.export.page import page_template
from robir.export.report.numbers import Products, report_numbers
from robir.export.report.pictures import (
    VIEWER_SCRIPT,
    data_address,
    embedded_asset,
    embedded_lights,
    environment_picture,
    fine,
    inline_lossless,
    own_rerenders,
    row_of_view,
    shown_views,
    start_orbit,
    write_contact,
)
from robir.export.textures import shown_texture
from robir.jobs.paths import JobPaths, replacing, write_json

_LEVELS_START, _LEVELS_END = '<section id="levels">', "</section>"
_SCRIPT = re.compile(r"<script[^>]*>(.*?)</script>", re.DOTALL)
_ALLOWED = "HASHES"  # stands for the scripts that may run, until they are known


def write_report(paths: JobPaths, products: Products) -> dict[str, Any]:
    """Write report/ and what the add-on compares; the content of report.json."""
    views = products.capture.held_out or products.capture.train
    own = own_rerenders(paths)
    shown = shown_views(views, products.rendering)
    cameras = [fine(view.camera) for view in shown]
    layers = view_layers(products.mesh, products.arrays, cameras, sub_pixels=1)
    rows = [
        row_of_view(view, seen, own, products.rendering, paths.comparison(view.name))
        for view, seen in zip(shown, layers, strict=True)
    ]
    write_contact(paths.contact, shown[0], layers[0], own, products.rendering)
    numbers = report_numbers(paths, products, own)
    write_json(paths.report_json, numbers)
    text = page_template("robir.export", "report.html").render(
        rows=rows,
        numbers=numbers,
        tone_plot=data_address("image/png", paths.tone_plot.read_bytes()),
        environment=inline_lossless(environment_picture(products.light)),
        textures=[
            (name, inline_lossless(picture))
            for name in ("albedo", "roughness", "metallic", "coverage", "uncertainty")
            if (picture := shown_texture(paths, name)) is not None
        ],
        tiles=products.mesh.tiles.tolist(),
        relit_with=products.rendering.relit_with,
        asset=embedded_asset(products.parts),
        orbit=start_orbit(shown[0].camera, products.mesh),
        lights=embedded_lights(products.light),
        viewer=Markup(VIEWER_SCRIPT.read_text(encoding="utf-8")),  # noqa: S704 - our own file
        files=_files(paths),
        allowed=_ALLOWED,
    )
    with replacing(paths.report) as temporary:
        temporary.write_text(text.replace(_ALLOWED, _hashes(text), 1), encoding="utf-8")
    return numbers


def _hashes(page: str) -> str:
    """The page's own scripts as a Content-Security-Policy names them: no other one ever runs."""
    scripts = _SCRIPT.findall(page)
    digests = (hashlib.sha256(script.encode("utf-8")).digest() for script in scripts)
    return " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in digests)


def _files(paths: JobPaths) -> list[dict[str, str]]:
    """What the result holds to download: each file's label, size and place from the page."""
    named = [
        ("3D model, GLB", paths.asset),
        ("Blender scene", paths.scene),
        ("light, EXR", paths.environment),
        *(
            (file.name.rpartition(".")[0] + ", " + file.suffix[1:].upper(), file)
            for file in sorted(paths.textures.glob("*.*"))
        ),
    ]
    return [
        {
            "label": label,
            "size": _size(file.stat().st_size),
            "place": f"../{file.relative_to(paths.root).as_posix()}",
        }
        for label, file in named
        if file.is_file()
    ]


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{max(1, round(count / 1e3))} kB"


def show_levels(paths: JobPaths, levels: dict[str, Any]) -> None:
    """Put the table and pictures of `level_scores` into a report that is there already, if any."""
    if not paths.report.is_file():
        return
    section = page_template("robir.export", "levels.html").render(
        head=LEVEL_HEAD,
        rows=level_cells(levels),
        notes=level_notes(levels),
        strip=data_address("image/png", paths.levels_strip.read_bytes()) if levels["views"] else "",
    )
    page = paths.report.read_text(encoding="utf-8", errors="replace")
    before, mark, after = page.partition(_LEVELS_START)
    if mark:
        after = after.partition(_LEVELS_END)[2]
    else:  # a report of an older version
        before, mark, after = page.partition("<h2>")
        after = mark + after
    with replacing(paths.report) as temporary:
        temporary.write_text(before + section + after, encoding="utf-8")
