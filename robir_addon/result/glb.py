# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the mesh of an asset.glb that RobIR wrote, back into the capture's frame (numpy only)."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.errors import ResultError

# what reading a damaged asset raises
_DAMAGE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
    struct.error,
)  # fmt: skip
_TYPES = {5126: np.float32, 5125: np.uint32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


_TILES = range(1001, 2001)  # numbers that UDIM tiles may have: ten a row, from u = v = 0


@dataclass(frozen=True)
class GlbMesh:
    """Triangles with what each corner carries."""

    name: str  # of the mesh
    vertices: np.ndarray  # (N, 3) positions, capture frame; seams of the texture are closed
    faces: np.ndarray  # (F, 3) indices into vertices
    corner_normals: np.ndarray  # (F, 3, 3) unit
    corner_uvs: np.ndarray  # (F, 3, 2), v upwards, over the tiles where there are such
    tiles: np.ndarray  # (F,) number of the UDIM tile that a face lies in; 0 where there are none
    specular: float  # 1 where what is no metal reflects as any paint, 0 where it does not


def read_glb(path: Path) -> GlbMesh:
    """Read an asset."""
    try:
        document, binary = _chunks(path.read_bytes())
        mesh = document["meshes"][0]
        parts = [_part(document, binary, primitive) for primitive in mesh["primitives"]]
        places, normals, uvs, tiles = (
            np.concatenate(arrays) for arrays in zip(*parts, strict=True)
        )
        extensions = document["materials"][0].get("extensions", {})
        specular = float(extensions.get("KHR_materials_specular", {}).get("specularFactor", 1.0))
        name = str(mesh["name"])
    except _DAMAGE as fault:
        text = (
            "{file} cannot be read as RobIR's asset ({fault}); run `robir reconstruct` with "
            "--resume to export it again"
        )
        raise ResultError(text, file=path, fault=fault) from fault
    place = np.maximum(tiles - _TILES.start, 0)  # where each tile begins; 0 where there are none
    vertices, welded = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
    return GlbMesh(
        name=name,
        vertices=vertices,
        faces=welded.reshape(-1, 3).astype(np.int32),
        corner_normals=normals,
        corner_uvs=uvs + np.stack([place % 10, place // 10], axis=-1).astype(np.float32)[:, None],
        tiles=tiles,
        specular=specular,
    )


def _part(
    document: dict[str, Any], binary: memoryview, primitive: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places, normals and texture coordinates of the corners of faces, (F, 3, ...), and tiles."""
    arrays = {
        name: _array(document, binary, index) for name, index in primitive["attributes"].items()
    }
    corners = _array(document, binary, primitive["indices"]).reshape(-1, 3)
    count = len(arrays["POSITION"])
    lengths = {len(arrays[key]) for key in ("NORMAL", "TEXCOORD_0")}
    if lengths != {count} or not len(corners) or corners.max() >= count:
        raise ValueError("its vertices do not fit together")
    extras = document["materials"][primitive["material"]].get("extras", {})
    tile = extras.get("udim", 0)
    if tile and tile not in _TILES:
        raise ValueError(f"there is no tile {tile!r}")
    uv = arrays["TEXCOORD_0"][corners]
    return (
        _z_up(arrays["POSITION"])[corners],
        _z_up(arrays["NORMAL"])[corners],
        np.stack([uv[..., 0], 1.0 - uv[..., 1]], axis=-1),
        np.full(len(corners), tile, np.int64),
    )


def _chunks(content: bytes) -> tuple[dict[str, Any], memoryview]:
    """The JSON document and the binary chunk."""
    magic, version, total = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2 or total != len(content):
        raise ValueError("not a whole glTF 2 binary file")
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), memoryview(content)[20 + length + 8 :]


def _array(document: dict[str, Any], binary: memoryview, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    width = _WIDTHS[accessor["type"]]
    values = np.frombuffer(
        binary, _TYPES[accessor["componentType"]], accessor["count"] * width, view["byteOffset"]
    )
    return values.reshape(-1, width) if width > 1 else values


def _z_up(points: np.ndarray) -> np.ndarray:
    """From glTF's y-up, the exact inverse of what the exporter did."""
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
