# SPDX-License-Identifier: Apache-2.0
"""Writes a textured mesh as one glTF 2.0 binary file.

The capture frame is taken as z-up: a point (x, y, z) is written as (x, z, -y), which importers
that expect glTF's y-up (Blender's among them) turn back into (x, y, z) exactly. Texture coordinates
are written from the top, as glTF wants them.
"""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir import __version__
from robir.evaluation.metrics import srgb_from_linear
from robir.export.textures import Codes, Textures, codes
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


def write_glb(path: Path, mesh: Mesh, textures: Textures, name: str) -> None:
    """Write a mesh with its material.

    Args:
        path: File to replace.
        mesh: Unwrapped, in the capture's own frame and unit.
        textures: Base colour is embedded as an sRGB PNG; roughness and metallic as one linear PNG
            with roughness in G and metallic in B. Specular other than 1 needs an extension, which
            viewers that lack it pass over.
        name: Name of node, mesh and material.
    """
    buffer = _Buffer()
    corners, vertex, uv = _welded(mesh)
    attributes = {
        "POSITION": buffer.add_array(_y_up(mesh.vertices[vertex]), "VEC3", is_position=True),
        "NORMAL": buffer.add_array(_y_up(_unit(mesh.normals[vertex])), "VEC3"),
        "TEXCOORD_0": buffer.add_array(_from_top(mesh.uvs[uv]), "VEC2"),
    }
    indices = buffer.add_array(corners.astype(np.uint32).ravel(), "SCALAR")
    albedo = buffer.add_view(_png(codes(srgb_from_linear(textures.albedo_linear))))
    surface = buffer.add_view(_png(_surface_codes(textures)))
    primitive = {"attributes": attributes, "indices": indices, "material": 0}
    document = {
        "asset": {"version": "2.0", "generator": f"RobIR {__version__}"},
        "extras": {"robir_version": __version__},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "materials": [_material(name, textures.specular)],
        "textures": [{"sampler": 0, "source": 0}, {"sampler": 0, "source": 1}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [
            {"bufferView": albedo, "mimeType": "image/png", "name": "albedo"},
            {"bufferView": surface, "mimeType": "image/png", "name": "metallic_roughness"},
        ],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data) + -len(buffer.data) % 4}],
    }
    if textures.normal_map is not None:
        view = buffer.add_view(_png(textures.normal_map))
        document["images"].append({"bufferView": view, "mimeType": "image/png", "name": "normal"})
        document["textures"].append({"sampler": 0, "source": 2})
        document["materials"][0]["normalTexture"] = {"index": 2}
        document["buffers"][0]["byteLength"] = len(buffer.data) + -len(buffer.data) % 4
    if textures.specular != 1.0:
        document["extensionsUsed"] = [_SPECULAR]
    _write_chunks(path, document, bytes(buffer.data))


def _material(name: str, specular: float) -> dict[str, Any]:
    material: dict[str, Any] = {
        "name": name,
        # open surfaces (an object without its underside) show from both sides
        "doubleSided": True,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0},
            "metallicRoughnessTexture": {"index": 1},
            "metallicFactor": 1.0,
            "roughnessFactor": 1.0,
        },
    }
    if specular != 1.0:
        material["extensions"] = {_SPECULAR: {"specularFactor": specular}}
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


def _from_top(uvs: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1).astype(np.float32)


def _surface_codes(textures: Textures) -> Codes:
    roughness = codes(textures.roughness)
    metallic = np.zeros_like(roughness) if textures.metallic is None else codes(textures.metallic)
    # red is free for occlusion, which we have no use for: full
    return np.stack([np.full_like(roughness, 255), roughness, metallic], axis=-1)


def _png(image: Codes) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG")
    return stream.getvalue()


def _write_chunks(path: Path, document: dict[str, Any], binary: bytes) -> None:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)
