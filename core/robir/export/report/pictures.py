# SPDX-License-Identifier: Apache-2.0
"""The report's pictures of views, the small one for a contact sheet, and what its 3D viewer shows.

The viewer is <model-viewer> 4.4.0 as npm ships it (`model_viewer/`, Apache-2.0). It takes data
addresses, so that the page needs neither a network nor files beside it.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.evaluation.layers import Layers
from robir.evaluation.light import RecoveredLight
from robir.evaluation.photos import (
    BACKGROUND,
    cut,
    display_codes,
    layer_pictures,
    over_grey,
    read_picture,
    window,
)
from robir.export.gltf import glb_bytes
from robir.export.report.numbers import Rendering
from robir.export.textures import Codes, TexturedPart, encoded
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, replacing
from robir.maths.vectors import equirect_directions

Picture = NDArray[np.uint8]

CONTACT_SIDE = 160  # side of each of the four pictures of `contact.jpg`, pixels
_SIDE = 560  # longer side of a view's picture, pixels: as much as an enlarged one shows
_MAX_ROWS = 4
_QUALITY, _FINE_QUALITY = 86, 95
_COMPARED = ("photo", "rerender", "albedo", "roughness")


def own_rerenders(paths: JobPaths) -> dict[str, Picture]:
    """Our own renderer's pictures of held-out views by name."""
    return stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)


def shown_views(views: tuple[View, ...], rendering: Rendering) -> list[View]:
    """Rendered views, relit ones first, and for want of them evenly chosen others."""
    rendered = [view for view in views if view.name in rendering.rerenders]
    rendered.sort(key=lambda view: view.name not in rendering.relit)
    del rendered[_MAX_ROWS:]
    others = [view for view in views if view.name not in rendering.rerenders]
    count = min(_MAX_ROWS - len(rendered), len(others))
    picked = np.linspace(0, len(others) - 1, count).round().astype(int)
    return [*rendered, *(others[index] for index in picked)]


def row_of_view(
    view: View, layers: Layers, own: dict[str, Picture], rendering: Rendering, beside: Path
) -> dict[str, Any]:
    """Pictures of one view as data addresses, cut to the object; None where there is none.

    What the add-on compares is written to `beside` as one picture.
    """
    again, how = _rerender(view, own, rendering)
    relit = rendering.relit.get(view.name)
    pictures = {
        "photo": np.dstack([view.image_display, view.mask]),
        "rerender": again,
        **{name: np.dstack([p, _alpha(layers)]) for name, p in layer_pictures(layers).items()},
        "relit": None if relit is None else read_picture(relit),
    }
    frame = window(view.mask)

    def webp(picture: Picture) -> str:
        return data_address("image/webp", encoded(picture, format="WEBP", quality=_QUALITY))

    whole = {n: None if p is None else cut(p, frame, _SIDE) for n, p in pictures.items()}
    _write_beside(beside, [whole[name] for name in _COMPARED])
    shown = {name: None if picture is None else webp(picture) for name, picture in whole.items()}
    return {"name": view.name, "rerender_by": how if again is not None else "", **shown}


def _write_beside(path: Path, pictures: list[Picture | None]) -> None:
    """Write square pictures beside each other, all as wide as the widest; where none is, nothing.

    Small photographs are shown larger, so that the textures show more than they do.
    """
    side = max(len(picture) for picture in pictures if picture is not None)
    row = Image.new("RGBA", (len(pictures) * side, side))
    for index, picture in enumerate(pictures):
        if picture is not None:
            tile = Image.fromarray(picture).resize((side, side), Image.Resampling.NEAREST)
            row.paste(tile, (index * side, 0))
    with replacing(path) as temporary:
        row.save(temporary, format="WEBP", quality=_FINE_QUALITY, exact=True)


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
    return data_address("image/png", encoded(picture, format="PNG"))


def data_address(kind: str, content: bytes) -> str:
    """A file of a media type as an address that holds all of it."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


Array = NDArray[np.floating[Any]]

VIEWER_SCRIPT = Path(__file__).parent / "model_viewer" / "model-viewer.min.js"

_MOST_TEXELS = 1024  # along a side of a texture of the copy: a page shows no more
_JPEG_QUALITY = 88
_ROWS = 64  # of an environment picture; reflections of a page's size need no more


@dataclass(frozen=True, slots=True)
class _Lamp:
    """A round patch of even radiance."""

    azimuth: float  # degrees from +X towards +Y
    elevation: float  # degrees
    radius: float  # degrees
    radiance: tuple[float, float, float]  # linear Rec.709


@dataclass(frozen=True, slots=True)
class _Light:
    """A light of our own: radiance at the nadir, horizon and zenith, and lamps."""

    name: str
    below: tuple[float, float, float]
    horizon: tuple[float, float, float]
    above: tuple[float, float, float]
    lamps: tuple[_Lamp, ...]


_LIGHTS = (
    _Light(
        "Studio", (0.15, 0.15, 0.15), (0.3, 0.3, 0.3), (0.5, 0.5, 0.5),
        (
            _Lamp(40.0, 45.0, 26.0, (14.0, 13.4, 12.6)),
            _Lamp(150.0, 25.0, 22.0, (4.0, 4.3, 4.8)),
            _Lamp(-80.0, 35.0, 18.0, (7.0, 7.0, 7.0)),
        ),
    ),
    _Light(
        "Sunny day", (0.25, 0.22, 0.18), (0.8, 0.9, 1.0), (0.35, 0.55, 1.0),
        (_Lamp(-35.0, 48.0, 4.0, (380.0, 350.0, 300.0)),),
    ),
    _Light(
        "Evening", (0.05, 0.05, 0.07), (0.55, 0.3, 0.2), (0.1, 0.14, 0.32),
        (
            _Lamp(120.0, 9.0, 8.0, (90.0, 42.0, 14.0)),
            _Lamp(-60.0, 30.0, 25.0, (0.5, 0.7, 1.4)),
        ),
    ),
)  # fmt: skip


def embedded_asset(parts: Iterable[TexturedPart]) -> str:
    """The asset as a data address, its textures as JPEG and no larger than a page shows."""
    return data_address("model/gltf-binary", glb_bytes(parts, "asset", _jpeg))


def _jpeg(image: Codes) -> tuple[bytes, str]:
    picture = Image.fromarray(image)
    picture.thumbnail((_MOST_TEXELS, _MOST_TEXELS))
    return encoded(np.asarray(picture), format="JPEG", quality=_JPEG_QUALITY), "image/jpeg"


def embedded_lights(light: RecoveredLight) -> list[tuple[str, str]]:
    """Names of the lights, the recovered one first, and each as the address of a Radiance file."""
    made = [("Recovered", light.environment(_ROWS))]
    made += [(one.name, _environment(one)) for one in _LIGHTS]
    return [(name, _radiance(image)) for name, image in made]


def start_orbit(camera: Camera, mesh: Mesh) -> str:
    """Whence the viewer looks first, as it is written there: as the first photograph does."""
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    x, y, z = camera.camera_to_world[:3, 3] - middle
    around = math.degrees(math.atan2(x, -y))
    down = math.degrees(math.atan2(math.hypot(x, y), z))
    return f"{around:.1f}deg {down:.1f}deg auto"


def _environment(light: _Light) -> Array:
    """Lat-long radiance (_ROWS, 2 _ROWS, 3) in Blender's world frame."""
    directions = equirect_directions(_ROWS).numpy()
    height = directions[..., 2:]
    horizon = np.array(light.horizon)
    pole = np.where(height > 0, np.array(light.above), np.array(light.below))
    image = horizon + (pole - horizon) * np.abs(height) ** 0.5
    texel = 90.0 / _ROWS
    for lamp in light.lamps:
        around, up = math.radians(lamp.azimuth), math.radians(lamp.elevation)
        axis = [math.cos(up) * math.cos(around), math.cos(up) * math.sin(around), math.sin(up)]
        angle = np.degrees(np.arccos(np.clip(directions @ np.array(axis), -1.0, 1.0)))
        # an edge as wide as two texels keeps a small lamp's energy wherever it falls
        share = np.clip(0.5 + (lamp.radius - angle) / (2 * texel), 0.0, 1.0)[..., None]
        image = image + share * np.array(lamp.radiance)
    return image


def _radiance(image: Array) -> str:
    """A Radiance picture, its mean over the sphere 1, so that all lights are about as bright."""
    edges = np.sin(np.pi * (0.5 - np.arange(len(image) + 1) / len(image)))
    share = (edges[:-1] - edges[1:])[:, None, None] / (2 * image.shape[1])
    mean = float((image * share).sum() / 3)
    codes = np.ascontiguousarray(image[..., ::-1] / max(mean, 1e-9), np.float32)
    done, encoded = cv2.imencode(".hdr", codes)
    assert done
    # the viewer knows the format by the address's end
    return data_address("image/vnd.radiance", encoded.tobytes()) + "#.hdr"
