# SPDX-License-Identifier: Apache-2.0
"""What the report's 3D viewer shows: a copy of the asset and the lights to choose from.

The viewer is <model-viewer> 4.4.0 as npm ships it (`model_viewer/`, Apache-2.0). It takes data
addresses, so that the page needs neither a network nor files beside it.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.camera import Camera
from robir.evaluation.light_scores import RecoveredLight
from robir.export.gltf import glb_bytes
from robir.export.report.pictures import data_address
from robir.export.textures import Codes, Part
from robir.geometry.mesh.triangles import Mesh
from robir.maths.vectors import equirect_directions

Array = NDArray[np.floating[Any]]

VIEWER_SCRIPT = Path(__file__).parent / "model_viewer" / "model-viewer.min.js"

_MOST_TEXELS = 1024  # along a side of a texture of the copy: a page shows no more
_QUALITY = 88
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


def embedded_asset(parts: Iterable[Part]) -> str:
    """The asset as a data address, its textures as JPEG and no larger than a page shows."""
    return data_address("model/gltf-binary", glb_bytes(parts, "asset", _jpeg))


def _jpeg(image: Codes) -> tuple[bytes, str]:
    picture = Image.fromarray(image)
    picture.thumbnail((_MOST_TEXELS, _MOST_TEXELS))
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=_QUALITY)
    return stream.getvalue(), "image/jpeg"


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
