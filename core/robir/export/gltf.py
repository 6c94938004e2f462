# SPDX-License-Identifier: Apache-2.0
"""Writes a textured mesh as one glTF 2.0 binary file.

The capture frame is taken as z-up: a point (x, y, z) is written as (x, z, -y), which importers
that expect glTF's y-up (Blender's among them) turn back into (x, y, z) exactly. Texture coordinates
are written from the top, as glTF wants them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir import __version__
from robir.evaluation.metrics import srgb_from_linear
from robir.export.textures import Codes, Part, Textures, codes, encoded
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import replacing

_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_SPECULAR = "KHR_materials_specular"


class _Buffer:
    """The binary chunk, grown piece by piece, with the tables that describe it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add_view(self, content: bytes, target: int | None = None) -> int:
        self.data.extend(b"\0" * (-len(self.data) % 4))
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append(view | ({} if target is None else {"target": target}))
        self.data.extend(content)
        return len(self.views) - 1

    def add_array(self, values: NDArray[Any], kind: str, is_position: bool = False) -> int:
        component = _FLOAT if values.dtype == np.float32 else _UINT
        accessor: dict[str, Any] = {
            "bufferView": self.add_view(
                values.tobytes(), _INDICES if kind == "SCALAR" else _VERTICES
            ),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if is_position:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(path: Path, parts: Iterable[Part], name: str) -> None:
    """Write what `glb_bytes` gives to a file, atomically."""
    content = glb_bytes(parts, name)
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def glb_bytes(
    parts: Iterable[Part],
    name: str,
    encode: Callable[[Codes], tuple[bytes, str]] = lambda image: (
        encoded(image, format="PNG"),
        "image/png",
    ),
) -> bytes:
    """A mesh whose unwrapped parts each have a material, as a glTF binary file, capture frame.

    glTF knows no UDIM tiles: every tile is a primitive of the one mesh, with texture coordinates in
    0..1 and a material that is named after it and bears its number as "udim" in its extras. Base
    colour is an sRGB picture; roughness and metallic are G and B of a linear one. Specular other
    than 1 needs an extension, which viewers that lack it pass over. `encode` gives a picture's file
    and its media type.
    """
    buffer = _Buffer()
    primitives: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    for part in parts:
        primitives.append(_primitive(buffer, part.mesh) | {"material": len(materials)})
        materials.append(_material(part, name, len(images)))
        for kind, picture in _pictures(part.textures).items():
            label = kind if part.tile is None else f"{kind}.{part.tile}"
            content, kind_of_file = (encode or _png)(picture)
            view = buffer.add_view(content)
            images.append({"bufferView": view, "mimeType": kind_of_file, "name": label})
    document = {
        "asset": {"version": "2.0", "generator": f"RobIR {__version__}"},
        "extras": {"robir_version": __version__},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": primitives}],
        "materials": materials,
        "textures": [{"sampler": 0, "source": index} for index in range(len(images))],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": images,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data) + -len(buffer.data) % 4}],
    }
    if any("extensions" in material for material in materials):
        document["extensionsUsed"] = [_SPECULAR]
    return _chunks(document, bytes(buffer.data))


def _primitive(buffer: _Buffer, mesh: Mesh) -> dict[str, Any]:
    """Triangles with what their corners carry."""
    corners, vertex, uv = _welded(mesh)
    from_top = np.stack([mesh.uvs[uv, 0], 1.0 - mesh.uvs[uv, 1]], axis=1)
    attributes = {
        "POSITION": buffer.add_array(_y_up(mesh.vertices[vertex]), "VEC3", is_position=True),
        "NORMAL": buffer.add_array(_y_up(_unit(mesh.normals[vertex])), "VEC3"),
        "TEXCOORD_0": buffer.add_array(from_top.astype(np.float32), "VEC2"),
    }
    indices = buffer.add_array(corners.astype(np.uint32).ravel(), "SCALAR")
    return {"attributes": attributes, "indices": indices}


def _pictures(textures: Textures) -> dict[str, Codes]:
    """What a material embeds, in this order."""
    shown = {
        "albedo": codes(srgb_from_linear(textures.albedo_linear)),
        "metallic_roughness": _surface_codes(textures),
    }
    return shown if textures.normal_map is None else shown | {"normal": textures.normal_map}


def _material(part: Part, name: str, first: int) -> dict[str, Any]:
    """The material of a part whose pictures come from some index on."""
    textures = part.textures
    material: dict[str, Any] = {
        "name": name if part.tile is None else f"{name}.{part.tile}",
        # open surfaces (an object without its underside) show from both sides
        "doubleSided": True,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": first},
            "metallicRoughnessTexture": {"index": first + 1},
            "metallicFactor": 1.0,
            "roughnessFactor": 1.0,
        },
    }
    if textures.specular != 1.0:
        material["extensions"] = {_SPECULAR: {"specularFactor": textures.specular}}
    if textures.normal_map is not None:
        material["normalTexture"] = {"index": first + 2}
    if part.tile is not None:
        material["extras"] = {"udim": part.tile}
    return material


def _welded(mesh: Mesh) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Faces over distinct (vertex, texture coordinate) pairs, and the two indices of each pair."""
    pairs = np.stack([mesh.faces.ravel(), mesh.uv_faces.ravel()], axis=1)
    distinct, corners = np.unique(pairs, axis=0, return_inverse=True)
    return corners.reshape(-1, 3), distinct[:, 0], distinct[:, 1]


def _y_up(points: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


def _unit(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    return (normals / np.maximum(length, 1e-12)).astype(np.float32)


def _surface_codes(textures: Textures) -> Codes:
    roughness = codes(textures.roughness)
    metallic = np.zeros_like(roughness) if textures.metallic is None else codes(textures.metallic)
    # red is free for occlusion, which we have no use for: full
    return np.stack([np.full_like(roughness, 255), roughness, metallic], axis=-1)


def _png(image: Codes) -> tuple[bytes, str]:
    return encoded(image, format="PNG"), "image/png"


def _chunks(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
