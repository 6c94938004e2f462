# SPDX-License-Identifier: Apache-2.0
"""Reads the user's mesh by trimesh: every triangle of the file as one soup, in the capture's frame.

glTF is y-up by its standard and is turned as our own export is, (x, y, z) to (x, -z, y); all other
formats have no axes of their own and are taken to stand in the capture's frame as they are.
"""

from __future__ import annotations

import io
import json
import re
import shlex
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.images.normal_map import normal_images, normal_maps
from robir.capture.images.regular import regular
from robir.errors import CaptureError
from robir.jobs.names import checked_name, leads_out

SUFFIXES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Kinds of files that are read here."""

FOREIGN = (".fbx", ".usd", ".usda", ".usdc", ".usdz")
"""Kinds of files that only Blender reads; the add-on makes a GLB of them."""

MAX_BYTES = 1 << 31
"""Largest file; ten million triangles have a tenth of it."""

_Maps = tuple[tuple[NDArray[np.uint8], ...], dict[int, int]]
"""Normal maps, and which of them each material has; see `normal_maps`."""

_NO_MAPS: _Maps = ((), {})

_TILE = re.compile(r"\.(1(?:00[1-9]|0[1-9][0-9]|[1-9][0-9]{2})|2000)$")
"""End of the name of a material that stands for a UDIM tile; "Material.001" is none."""

_OUTSIDE = 1e-3
"""Of a texture's side: as far as texture coordinates may leave it by rounding."""

_JSON, _BINARY = b"JSON", b"BIN\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class Detail:
    """Normal maps of tangent space, over a mesh's own normals and texture coordinates.

    Attributes:
        maps: (H, W, 3) codes each, row 0 at v = 1, green towards larger v; they repeat outside
            0..1.
        of_face: (Nf,) int32, which map a face has; -1 for none.
    """

    maps: tuple[NDArray[np.uint8], ...]
    of_face: NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Triangles as a file has them.

    Attributes:
        vertices: (Nv, 3) float64, the capture's frame and unit or, placed, the unit frame.
        faces: (Nf, 3) int32, in the file's order.
        uvs: (Nv, 2) float64, v upwards; NaN for vertices without any.
        normals: (Nv, 3) float64, unit; None where there is no normal map.
        detail: Normal maps over these normals; None if the file has none.
        notes: Sentences for the user.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    uvs: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None
    detail: Detail | None = None
    notes: tuple[str, ...] = ()

    def noted(self, *notes: str) -> Given:
        """The same with more to tell."""
        return replace(self, notes=(*self.notes, *notes))


def mesh_parts(path: Path) -> dict[str, bytes]:
    """Contents of the files that a mesh consists of, its own under the empty name.

    Raises:
        CaptureError: If the file is of no known kind, cannot be read, or names what lies elsewhere.
    """
    suffix = path.suffix.lower()
    if suffix in FOREIGN:
        raise CaptureError(_way_by_blender(path))
    if suffix not in SUFFIXES:
        raise CaptureError(
            f"{path} is no mesh that can be read ({suffix or 'no suffix'}); give one of "
            f"{', '.join(SUFFIXES)}; of {', '.join(FOREIGN)} Blender can make a GLB"
        )
    try:
        parts = {"": _content(path)}
        if suffix == ".gltf":
            document = json.loads(parts[""])
            pictures = list(_normal_pictures(document))
            for entry in (*document.get("buffers", ()), *pictures):
                uri = str(entry.get("uri", ""))
                if uri and not uri.startswith("data:"):
                    part = path.parent / checked_name(uri)
                    if leads_out(part, [path.parent]):
                        raise ValueError(f"{uri} lies outside its folder")  # noqa: TRY301
                    if part.exists() or entry not in pictures:
                        parts[uri] = _content(part)
    except (OSError, ValueError, AttributeError, TypeError, RecursionError) as fault:
        raise CaptureError(f"the mesh {path} cannot be read ({fault}); check the file") from fault
    return parts


def read_mesh(path: Path) -> Given:
    """All triangles of a file, whatever objects and materials they belong to.

    Raises:
        CaptureError: If it cannot be read, or holds no usable triangle; says which.
    """
    import trimesh  # here, because few runs are given a mesh and it takes a second to load

    parts = mesh_parts(path)
    suffix = path.suffix.lower().removeprefix(".")
    content = parts.pop("")
    try:
        maps, notes, document = _NO_MAPS, (), {}
        if suffix in ("gltf", "glb"):
            document, rest = _opened(content, is_binary=suffix == "glb")
            maps, notes = _normal_maps(document, rest, parts)
            content = _without_pictures(document, rest, is_binary=suffix == "glb")
        words: dict[str, Any] = {"skip_materials": True} if suffix in ("obj", "ply") else {}
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix, resolver=parts, process=False, **words
        )
        pieces = [scene.graph[node] for node in scene.graph.nodes_geometry]
        found = [(matrix, scene.geometry[name]) for matrix, name in pieces]
        given = replace(_merged(found, maps, _named_tiles(document, found)), notes=notes)
    except Exception as fault:  # a foreign parser on foreign bytes may raise anything
        raise CaptureError(
            f"the mesh {path} cannot be read ({fault or type(fault).__name__}); check the file"
        ) from fault
    if suffix in ("gltf", "glb"):
        normals = None if given.normals is None else _z_up(given.normals)
        given = replace(given, vertices=_z_up(given.vertices), normals=normals)
    return _sound(given, path)


def _way_by_blender(path: Path) -> str:
    """What to do with a file that only Blender reads; the GLB goes where the user is."""
    python, file, glb = map(shlex.quote, (sys.executable, str(path), f"{path.stem}.glb"))
    return (
        f"{path} can be read by Blender only; make a GLB of it with `{python} -m "
        f"robir_addon.headless mesh {file} {glb}`, or with the extension in Blender by `blender -b "
        f"--command robir_scene mesh {file} {glb}`, and give that: --mesh {glb}"
    )


def _content(path: Path) -> bytes:
    with regular(path, MAX_BYTES) as file:
        return file.read()


def _z_up(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def _merged(
    pieces: list[tuple[Any, Any]], maps: _Maps, corners_of: dict[int, tuple[int, int]]
) -> Given:
    """One soup of all pieces that have faces, each at its place and in its material's tile."""
    vertices, faces, uvs, normals, of_face, count = [], [], [], [], [], 0
    for matrix, piece in pieces:
        if len(getattr(piece, "faces", ())) == 0:
            continue
        own = np.asarray(piece.vertices, np.float64)
        corners = np.asarray(piece.faces, np.int64)
        if corners.min() < 0 or corners.max() >= len(own):
            raise ValueError("a face has a corner that is not there")
        turned = np.linalg.det(matrix[:3, :3]) < 0
        faces.append((corners[:, ::-1] if turned else corners) + count)
        with np.errstate(invalid="ignore"):  # corners that are no numbers stay none
            vertices.append(own @ matrix[:3, :3].T + matrix[:3, 3])
        uv = getattr(piece.visual, "uv", None)
        fits = uv is not None and np.shape(uv) == (len(own), 2)
        uvs.append(np.asarray(uv, np.float64) if fits else np.full((len(own), 2), np.nan))
        if corners_of:
            uvs[-1] += corners_of[_material(piece)]
        if maps[0]:
            of_face.append(np.full(len(corners), maps[1].get(_material(piece), -1), np.int32))
            normal = np.asarray(piece.vertex_normals, np.float64) @ np.linalg.inv(matrix[:3, :3])
            normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-30))
        count += len(own)
    if not faces:
        return Given(
            vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int32), uvs=np.zeros((0, 2))
        )
    return Given(
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces).astype(np.int32),
        uvs=np.concatenate(uvs),
        normals=np.concatenate(normals) if maps[0] else None,
        detail=Detail(maps=maps[0], of_face=np.concatenate(of_face)) if maps[0] else None,
    )


def _material(piece: Any) -> int:
    """Number of the material of a part of a glTF file, which `_bare` has made its name."""
    name = getattr(getattr(piece.visual, "material", None), "name", None)
    return int(name) if name is not None else -1


def _named_tiles(
    document: dict[str, Any], pieces: list[tuple[Any, Any]]
) -> dict[int, tuple[int, int]]:
    """Where the UDIM tile begins that each material of a glTF file stands for, by its number.

    glTF has no such tiles: Blender and we write a material for each, its name ending in the tile's
    number, and move texture coordinates to 0..1. Empty unless all materials are of that kind.
    """
    solid = [piece for _, piece in pieces if len(getattr(piece, "faces", ()))]
    names = document.get("materials", ())
    corners_of: dict[int, tuple[int, int]] = {}
    for piece in solid if names else ():
        uv, material = getattr(piece.visual, "uv", None), _material(piece)
        found = _TILE.search(str(names[material].get("name", ""))) if material >= 0 else None
        if found is None or uv is None or np.min(uv) < -_OUTSIDE or np.max(uv) > 1 + _OUTSIDE:
            return {}
        row, column = divmod(int(found[1]) - 1001, 10)
        corners_of[material] = (column, row)
    return corners_of if len(set(corners_of.values())) > 1 else {}


def _sound(given: Given, path: Path) -> Given:
    """The triangles that have an area, or a refusal where there are none."""
    if not len(given.faces):
        raise CaptureError(f"the mesh {path} is empty: it has no faces; export it again")
    finite = np.isfinite(given.vertices).all(1)
    usable = finite[given.faces].all(1)
    if not usable.any():
        raise CaptureError(f"the mesh {path} has no corner that is a number; export it again")
    corners = given.vertices[given.faces[usable]]
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if np.linalg.norm(doubled, axis=1).max() <= 1e-12 * extent**2:
        raise CaptureError(f"no face of the mesh {path} has an area; export it again")
    if usable.all():
        return given
    detail = given.detail
    given = replace(
        given,
        faces=given.faces[usable],
        vertices=np.where(finite[:, None], given.vertices, 0.0),
        detail=detail and replace(detail, of_face=detail.of_face[usable]),
    )
    return given.noted(
        f"{(~usable).sum()} of {len(usable)} faces of the mesh have corners that are no numbers; "
        "they were left out."
    )


def _normal_pictures(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The pictures beside a glTF file that are needed, if there are any."""
    try:
        images = normal_images(document)
    except (ValueError, LookupError, TypeError, AttributeError):
        return  # told when the mesh is read
    yield from (image for image in images if isinstance(image, dict))


def _normal_maps(
    document: dict[str, Any], rest: bytes, parts: dict[str, bytes]
) -> tuple[_Maps, tuple[str, ...]]:
    """The normal maps of a glTF file, or a sentence about why they cannot be taken."""
    try:
        return normal_maps(document, rest[8:], parts), ()
    except Exception as fault:  # whatever is wrong with them, the mesh may still be good
        reason = fault or type(fault).__name__
        return _NO_MAPS, (f"The mesh's normal map is not passed on to the result ({reason}).",)


def _opened(content: bytes, *, is_binary: bool) -> tuple[dict[str, Any], bytes]:
    """The JSON of a glTF file, and what follows it in a GLB."""
    if not is_binary:
        return json.loads(content), b""
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[20 + length :]


def _without_pictures(document: dict[str, Any], rest: bytes, *, is_binary: bool) -> bytes:
    """A glTF file for a parser that shall not look at pictures, in which foreign bytes may hide."""
    text = json.dumps(_bare(document)).encode()
    if not is_binary:
        return text
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<I4s", len(text), _JSON) + text + rest


def _bare(document: dict[str, Any]) -> dict[str, Any]:
    kept = {k: v for k, v in document.items() if k not in ("images", "textures", "samplers")}
    # texture coordinates are read for primitives with a material only
    count = len(document.get("materials", ()))
    kept["materials"] = [*({"name": str(index)} for index in range(count)), {}]
    for mesh in kept.get("meshes", ()):
        for primitive in mesh["primitives"]:
            primitive.setdefault("material", count)
    return kept
