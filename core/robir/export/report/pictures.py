# SPDX-License-Identifier: Apache-2.0
"""The report's pictures of views, cut to the object, and the small one for a contact sheet."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.evaluation.layers import Layers
from robir.evaluation.light_scores import RecoveredLight
from robir.evaluation.photos import read_picture
from robir.evaluation.sheet import BACKGROUND, cut, display_codes, layer_pictures, over_grey, window
from robir.export.report.numbers import Rendering
from robir.jobs.paths import JobPaths, replacing

Picture = NDArray[np.uint8]

CONTACT_SIDE = 160  # side of each of the four pictures of `contact.jpg`, pixels
_SIDE = 560  # longer side of a view's picture, pixels: as much as an enlarged one shows
_MAX_ROWS = 4
_QUALITY = 86


def own_rerenders(paths: JobPaths) -> dict[str, Picture]:
    """Our own renderer's pictures of held-out views by name."""
    return stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)


def shown_views(views: tuple[View, ...], rendering: Rendering) -> list[View]:
    """Rendered views where there are any, relit ones first, else evenly chosen ones."""
    rendered = [view for view in views if view.name in rendering.rerenders]
    rendered.sort(key=lambda view: view.name not in rendering.relit)
    if rendered:
        return rendered[:_MAX_ROWS]
    picked = np.linspace(0, len(views) - 1, min(_MAX_ROWS, len(views))).round().astype(int)
    return [views[index] for index in picked]


def row_of_view(
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
        name: None if picture is None else _inline_webp(cut(picture, frame, _SIDE))
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


def write_contact(
    path: Path, view: View, layers: Layers, own: dict[str, Picture], rendering: Rendering
) -> None:
    """Write a photograph, its re-render, albedo, and relit or trust (white is sure) in small."""
    alpha, frame = _alpha(layers), window(view.mask)
    pictures = [np.dstack([view.image_display, view.mask]), _rerender(view, own, rendering)[0]]
    pictures.append(np.dstack([layer_pictures(layers)["albedo"], alpha]))
    if view.name in rendering.relit:
        pictures.append(read_picture(rendering.relit[view.name]))
    elif layers.uncertainty is not None:
        pictures.append(np.dstack([display_codes(1.0 - layers.uncertainty), alpha]))
    sheet = Image.new("RGB", (4 * CONTACT_SIDE, CONTACT_SIDE), (BACKGROUND,) * 3)
    for index, picture in enumerate(pictures):
        if picture is not None:
            tile = Image.fromarray(over_grey(cut(picture, frame)))
            tile = tile.resize((CONTACT_SIDE, CONTACT_SIDE), Image.Resampling.LANCZOS)
            sheet.paste(tile, (index * CONTACT_SIDE, 0))
    with replacing(path) as temporary:
        sheet.save(temporary, format="JPEG", quality=88)


def fine(camera: Camera) -> Camera:
    """The camera with enough pixels for smooth outlines on the page."""
    factor = max(1, round(_SIDE / max(camera.width, camera.height)))
    return camera.resized(factor * camera.width, factor * camera.height)


def environment_picture(light: RecoveredLight) -> Picture:
    """The environment with its median at mid-grey; suns burn out."""
    image = light.environment(128)
    grey = max(float(np.median(image.mean(axis=-1))), 1e-6)
    return display_codes((0.18 * image / grey / (1.0 + 0.18 * image / grey)) ** (1 / 2.2))


def inline_lossless(picture: Picture) -> str:
    """A picture of numbers as a data address."""
    return data_address("image/png", _encoded(picture, format="PNG"))


def data_address(kind: str, content: bytes) -> str:
    """A file of a media type as an address that holds all of it."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


def _inline_webp(picture: Picture) -> str:
    return data_address("image/webp", _encoded(picture, format="WEBP", quality=_QUALITY))


def _encoded(picture: Picture, **how: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, **how)
    return stream.getvalue()
