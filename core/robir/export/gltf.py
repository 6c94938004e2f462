# SPDX-License-Identifier: Apache-2.0
"""Writes a textured mesh as one glTF 2.0 binary file, and as USD beside its textures.

The capture frame is taken as z-up: a point (x, y, z) is written as (x, z, -y), which importers
that expect glTF's y-up (Blender's among them) turn back into (x, y, z) exactly. Texture coordinates
are written from the top, as glTF wants them.

USD is one text file, its material UsdPreviewSurface, which every reader knows. Up is z and the
origin is the object's foot, the middle of its bounds' lower side, as in the asset for Blender.
Texture coordinates over UDIM tiles are as they were handed in; a path names all tiles at once.
"""

from __future__ import annotations

import json
import os
import re
import struct
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir import __version__
from robir.evaluation.layers import load_textures, stored_mesh
from robir.evaluation.metrics import srgb_from_linear
from robir.export.textures import Codes, TexturedPart, Textures, codes, encoded
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import UDIM, JobPaths, of_tile, replacing

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


def _png(image: Codes) -> tuple[bytes, str]:
    return encoded(image, format="PNG"), "image/png"


def write_glb(path: Path, parts: Iterable[TexturedPart], name: str) -> None:
    """Write what `glb_bytes` gives to a file, atomically."""
    content = glb_bytes(parts, name)
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def glb_bytes(
    parts: Iterable[TexturedPart],
    name: str,
    encode: Callable[[Codes], tuple[bytes, str]] = _png,
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
            content, kind_of_file = encode(picture)
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


def _material(part: TexturedPart, name: str, first: int) -> dict[str, Any]:
    """The material of a part whose pictures come from some index on."""
    textures, surface = part.textures, {"index": first + 1}
    maps = {"baseColorTexture": {"index": first}, "metallicRoughnessTexture": surface}
    material: dict[str, Any] = {
        "name": name if part.tile is None else f"{name}.{part.tile}",
        # open surfaces (an object without its underside) show from both sides
        "doubleSided": True,
        "pbrMetallicRoughness": maps | {"metallicFactor": 1.0, "roughnessFactor": 1.0},
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


def _chunks(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    head = struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


_IOR = {True: 1.5, False: 1.0}  # by whether what is no metal reflects (F0 = 0.04)
_FILE = """#usda 1.0
(
    defaultPrim = "{name}"
    metersPerUnit = 1
    upAxis = "Z"
    customLayerData = {{ {facts} }}
)

def Xform "{name}" (kind = "component")
{{
    def Mesh "mesh" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        rel material:binding = </{name}/material>
        uniform bool doubleSided = 1
        uniform token subdivisionScheme = "none"
        float3[] extent = [{extent}]
        int[] faceVertexCounts = [{counts}]
        int[] faceVertexIndices = [{faces}]
        point3f[] points = [{points}]
        normal3f[] normals = [{normals}] (interpolation = "vertex")
        texCoord2f[] primvars:st = [{uvs}] (interpolation = "faceVarying")
        int[] primvars:st:indices = [{uv_faces}]
    }}

    def Material "material"
    {{
        token outputs:surface.connect = </{name}/material/surface.outputs:surface>

        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            float inputs:ior = {ior}
{inputs}
            token outputs:surface
        }}

        def Shader "coordinates"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
{textures}    }}
}}
"""

_INPUT = "            {type} inputs:{input}.connect = </{name}/material/{file}.outputs:{channel}>"

_TEXTURE = """
        def Shader "{file}"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{path}@
            token inputs:sourceColorSpace = "{space}"
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float2 inputs:st.connect = </{name}/material/coordinates.outputs:result>
            {output} outputs:{channel}
        }}
"""

_IMAGES = (
    {"file": "albedo", "input": "diffuseColor", "type": "color3f", "output": "float3",
     "channel": "rgb", "space": "sRGB"},
    {"file": "roughness", "input": "roughness", "type": "float", "output": "float",
     "channel": "r", "space": "raw"},
    {"file": "metallic", "input": "metallic", "type": "float", "output": "float",
     "channel": "r", "space": "raw"},
)  # fmt: skip


def write_usd(paths: JobPaths, facts: Mapping[str, str]) -> None:
    """Write export/asset.usda of a finished result, with facts by name, or a `StorageError`."""
    mesh = stored_mesh(paths)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    points = (mesh.vertices - foot).astype(np.float32)
    name = re.sub(r"^(?=\d)|\W", "_", paths.root.name, flags=re.ASCII)
    tiles = mesh.tiles.tolist()
    first, every = (tiles[0], UDIM) if tiles else (None, None)
    images = [
        image | {"name": name, "path": f"./{os.path.relpath(of_tile(file, every), paths.export)}"}
        for image in _IMAGES
        if of_tile(file := paths.textures / f"{image['file']}.png", first).is_file()
    ]
    text = _FILE.format(
        name=name,
        facts="; ".join(f"string {key} = {json.dumps(facts[key])}" for key in facts),
        extent=_tuples([points.min(axis=0), points.max(axis=0)]),
        counts=_numbers(np.full(len(mesh.faces), 3)),
        faces=_numbers(mesh.faces),
        points=_tuples(points),
        normals=_tuples(mesh.normals),
        uvs=_tuples(mesh.own_uvs()),
        uv_faces=_numbers(mesh.uv_faces),
        ior=_IOR[bool(load_textures(paths).get("specular", 1.0) != 0.0)],
        inputs="\n".join(_INPUT.format(**image) for image in images),
        textures="".join(_TEXTURE.format(**image) for image in images),
    )
    with replacing(paths.usd) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _numbers(values: NDArray[Any]) -> str:
    return ", ".join(map(str, values.ravel().tolist()))


def _tuples(rows: Iterable[NDArray[Any]]) -> str:
    """Rows such as (1, 2, 3), every float32 to the last bit."""
    return ", ".join(f"({', '.join(f'{value:.9g}' for value in row.tolist())})" for row in rows)
