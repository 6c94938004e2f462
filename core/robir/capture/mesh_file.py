# SPDX-License-Identifier: Apache-2.0
"""Reads the user's mesh by trimesh: every triangle of the file as one soup, in the capture's frame.

glTF is y-up by its standard and is turned as our own export is, (x, y, z) to (x, -z, y); all other
formats have no axes of their own and are taken to stand in the capture's frame as they are.
"""

from __future__ import annotations

import io
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.gltf_file import (
    MOST_CORNERS,
    MOST_FACES,
    MeshPart,
    normal_images,
    normal_maps,
    read_parts,
)
from robir.capture.gltf_json import MeshFaultError, opened
from robir.errors import CaptureError
from robir.jobs.names import UnsafeNameError, checked_name, leads_out, read_regular

SUFFIXES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")  # kinds of files that are read here
FOREIGN = (".fbx", ".usd", ".usda", ".usdc", ".usdz", ".abc")  # read by Blender only
MAX_BYTES = 1 << 29  # largest file; five million triangles have a half of it
_MAX_TEXT_BYTES = 1 << 28  # largest file of words; it takes several times its size to read
_Maps = tuple[tuple[NDArray[np.uint8], ...], dict[int, int]]  # normal maps, and whose they are
_NO_MAPS: _Maps = ((), {})

# end of the name of a material that stands for a UDIM tile; "Material.001" is none
_TILE = re.compile(r"\.(1(?:00[1-9]|0[1-9][0-9]|[1-9][0-9]{2})|2000)$")
_OUTSIDE = 1e-3  # of a texture's side: as far as texture coordinates may leave it by rounding
_UNUSED_OF_OBJ = re.compile(rb"(?m)^[ \t]*(?:usemtl|mtllib|[gos])[ \t][^\n]*$")
_ZERO_OF_OBJ = re.compile(rb"(?m)^[ \t]*f[ \t](?:[^\n]*[ \t])?0+(?:[/ \t\r\n]|\Z)")
_PLY_COUNTS = re.compile(rb"(?m)^element[ \t]+\S+[ \t]+(\S+)")
_OFF_COUNTS = re.compile(rb"\AOFF\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Detail:
    """Normal maps of tangent space, over a mesh's own normals and texture coordinates."""

    maps: tuple[NDArray[np.uint8], ...]  # (H, W, 3) codes, green towards larger v, repeating
    of_face: NDArray[np.int32]  # (Nf,) int32, which map a face has; -1 for none


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Triangles as a file has them."""

    vertices: NDArray[np.float64]  # (Nv, 3), the capture's frame or, placed, the unit frame
    faces: NDArray[np.int32]  # (Nf, 3) int32, in the file's order
    uvs: NDArray[np.float64]  # (Nv, 2) float64, v upwards; NaN for vertices without any
    normals: NDArray[np.float64] | None = None  # (Nv, 3) unit, with a normal map
    detail: Detail | None = None  # normal maps over these normals; None if the file has none
    notes: tuple[str, ...] = ()  # sentences for the user

    def noted(self, *notes: str) -> Given:
        """The same with more to tell."""
        return replace(self, notes=(*self.notes, *notes))


def mesh_parts(path: Path) -> dict[str, bytes]:
    """Contents of the files that a mesh consists of, its own under the empty name."""
    suffix = path.suffix.lower()
    if suffix in FOREIGN:
        raise CaptureError(_way_by_blender(path))
    if suffix not in SUFFIXES:
        raise CaptureError(
            f"{path} is no mesh that can be read ({suffix or 'no suffix'}); give one of "
            f"{', '.join(SUFFIXES)}; of {', '.join(FOREIGN)} Blender can make a GLB"
        )
    try:
        most = _MAX_TEXT_BYTES if suffix in (".obj", ".off") else MAX_BYTES
        parts = {"": read_regular(path, most)}
        if suffix == ".gltf":
            document, _ = opened(parts[""], is_binary=False)
            pictures = list(_normal_pictures(document))
            for entry in (*document.get("buffers", ()), *pictures):
                uri = entry.get("uri", "")
                if uri and not uri.startswith("data:"):
                    part = path.parent / checked_name(uri)
                    if leads_out(part, [path.parent]):
                        raise MeshFaultError(f"{uri} lies outside its folder")  # noqa: TRY301
                    if part.exists() or entry not in pictures:
                        parts[uri] = read_regular(part, MAX_BYTES)
            if sum(map(len, parts.values())) > MAX_BYTES:
                raise MeshFaultError(f"its files have more than {MAX_BYTES} bytes")  # noqa: TRY301
    except (OSError, UnsafeNameError, MeshFaultError) as fault:
        raise _unreadable(path, fault) from fault
    return parts


@np.errstate(invalid="ignore", over="ignore")  # corners that are no numbers stay none
def read_mesh(path: Path) -> Given:
    """All triangles of a file, whatever objects and materials they belong to."""
    parts = mesh_parts(path)
    suffix = path.suffix.lower()
    content = parts.pop("")
    try:
        if suffix in (".gltf", ".glb"):
            document, binary = opened(content, is_binary=suffix == ".glb")
            found = read_parts(document, binary, parts)
            maps, notes = _normal_maps(document, binary, parts)
            given = replace(_merged(found, maps, _named_tiles(document, found)), notes=notes)
            normals = None if given.normals is None else _z_up(given.normals)
            given = replace(given, vertices=_z_up(given.vertices), normals=normals)
        else:
            given = _merged(_pieces(content, suffix), _NO_MAPS, {})
    except MeshFaultError as fault:
        raise _unreadable(path, fault) from fault
    return _sound(given, path)


def _unreadable(path: Path, fault: Exception) -> CaptureError:
    reason = fault.strerror or fault if isinstance(fault, OSError) else fault
    return CaptureError(f"the mesh {path} cannot be read: {reason}; check the file")


def _pieces(content: bytes, suffix: str) -> list[tuple[NDArray[np.float64], MeshPart]]:
    """Triangles of the kinds of files that trimesh reads, with nothing but them in these."""
    import trimesh  # here, because few runs are given a mesh and it takes a second to load

    if suffix == ".obj":
        if _ZERO_OF_OBJ.search(content):
            raise MeshFaultError("a face has the corner 0, and the first is 1")
        content = _UNUSED_OF_OBJ.sub(b"", content)
    counted = {".ply": _PLY_COUNTS.findall(content[: 1 << 16])}
    if suffix == ".off" and (counts := _OFF_COUNTS.search(content)):
        counted[suffix] = list(counts.groups())
    for count in counted.get(suffix, ()):
        if not count.isdigit() or int(count[:20]) > len(content):
            raise MeshFaultError(f"its header counts {count[:20].decode('ascii', 'replace')}")
    words: dict[str, Any] = {"skip_materials": True} if suffix in (".obj", ".ply") else {}
    try:
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix[1:], resolver={}, process=False, **words
        )
        pieces = [scene.graph[node] for node in scene.graph.nodes_geometry]
        return [
            (matrix, _part_of(scene.geometry[name]))
            for matrix, name in pieces
            if len(getattr(scene.geometry[name], "faces", ()))
        ]
    except MeshFaultError:
        raise
    except Exception as fault:  # a foreign parser on foreign bytes may raise anything
        raise MeshFaultError(f"it is cut off or no {suffix[1:].upper()} file") from fault


def _part_of(piece: Any) -> MeshPart:
    vertices = np.asarray(piece.vertices, np.float64)
    faces = np.asarray(piece.faces, np.int64)
    if len(faces) > MOST_FACES or len(vertices) > 3 * MOST_CORNERS:
        raise MeshFaultError(f"it has {len(faces)} faces, and up to {MOST_FACES} are read")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshFaultError("a face has a corner that is not there")
    if vertices.shape[1:] != (3,):
        raise MeshFaultError("a corner has not three numbers")
    uv = getattr(piece.visual, "uv", None)
    fits = uv is not None and np.shape(uv) == (len(vertices), 2)
    return MeshPart(
        vertices=vertices, faces=faces, uvs=np.asarray(uv, np.float64) if fits else None
    )


def _way_by_blender(path: Path) -> str:
    """What to do with a file that only Blender reads; the GLB goes where the user is."""
    python, file, glb = map(shlex.quote, (sys.executable, str(path), f"{path.stem}.glb"))
    return (
        f"{path} can be read by Blender only; make a GLB of it with `{python} -m "
        f"robir_addon.headless mesh {file} {glb}`, or with the extension in Blender by `blender -b "
        f"--command robir_scene mesh {file} {glb}`, and give that: --mesh {glb}"
    )


def _z_up(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def _merged(
    pieces: list[tuple[NDArray[np.float64], MeshPart]],
    maps: _Maps,
    corners_of: dict[int, tuple[int, int]],
) -> Given:
    """One soup of all pieces that have faces, each at its place and in its material's tile."""
    vertices, faces, uvs, normals, of_face, count = [], [], [], [], [], 0
    for matrix, piece in pieces:
        if not len(piece.faces):
            continue
        turned = np.linalg.det(matrix[:3, :3]) < 0
        faces.append((piece.faces[:, ::-1] if turned else piece.faces) + count)
        vertices.append(piece.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        uvs.append(np.full((len(piece.vertices), 2), np.nan) if piece.uvs is None else piece.uvs)
        if corners_of:
            uvs[-1] = uvs[-1] + corners_of[piece.material]
        if maps[0]:
            of_face.append(np.full(len(piece.faces), maps[1].get(piece.material, -1), np.int32))
            normals.append(_turned_normals(piece, matrix))
        count += len(piece.vertices)
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


def _turned_normals(piece: MeshPart, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals of a piece at its place; where the file has none, the mean of its faces'."""
    normals = piece.normals
    if normals is None:
        a, b, c = np.moveaxis(piece.vertices[piece.faces], 1, 0)
        own, normals = np.cross(b - a, c - a), np.zeros_like(piece.vertices)
        for corner in range(3):
            np.add.at(normals, piece.faces[:, corner], own)
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-30:  # pressed flat: its faces have no area
        return np.zeros_like(normals)
    turned = normals @ np.linalg.inv(matrix[:3, :3])
    return turned / np.linalg.norm(turned, axis=1, keepdims=True).clip(1e-30)


def _named_tiles(
    document: dict[str, Any], pieces: list[tuple[NDArray[np.float64], MeshPart]]
) -> dict[int, tuple[int, int]]:
    """Where the UDIM tile of each material of a glTF begins, by its name; empty unless all are."""
    names = document.get("materials", ())
    corners_of: dict[int, tuple[int, int]] = {}
    for _, piece in pieces if names else ():
        if not len(piece.faces):
            continue
        uv, number = piece.uvs, piece.material
        found = _TILE.search(names[number].get("name", "")) if number >= 0 else None
        if found is None or uv is None or np.min(uv) < -_OUTSIDE or np.max(uv) > 1 + _OUTSIDE:
            return {}
        row, column = divmod(int(found[1]) - 1001, 10)
        corners_of[number] = (column, row)
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
    document: dict[str, Any], binary: bytes, parts: dict[str, bytes]
) -> tuple[_Maps, tuple[str, ...]]:
    """The normal maps of a glTF file, or a sentence about why they cannot be taken."""
    try:
        return normal_maps(document, binary, parts), ()
    except Exception as fault:  # whatever is wrong with them, the mesh may still be good
        reason = fault if isinstance(fault, MeshFaultError) else "it is damaged"
        return _NO_MAPS, (f"The mesh's normal map is not passed on to the result ({reason}).",)
