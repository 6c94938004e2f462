# SPDX-License-Identifier: Apache-2.0
"""Reads the user's mesh by trimesh: every triangle of the file as one soup, in the capture's frame.

glTF is y-up by its standard and is turned as our own export is, (x, y, z) to (x, -z, y); all other
formats have no axes of their own and are taken to stand in the capture's frame as they are.
"""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.images.regular import regular
from robir.errors import CaptureError
from robir.jobs.names import checked_name, leads_out

SUFFIXES = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Kinds of files that are read here."""

MAX_BYTES = 1 << 31
"""Largest file; ten million triangles have a tenth of it."""

_JSON, _BINARY = b"JSON", b"BIN\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Triangles as a file has them.

    Attributes:
        vertices: (Nv, 3) float64, the capture's frame and unit or, placed, the unit frame.
        faces: (Nf, 3) int32, in the file's order.
        uvs: (Nv, 2) float64, v upwards; NaN for vertices without any.
        notes: Sentences for the user.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    uvs: NDArray[np.float64]
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
    if suffix not in SUFFIXES:
        raise CaptureError(
            f"{path} is no mesh that can be read ({suffix or 'no suffix'}); give one of "
            f"{', '.join(SUFFIXES)}"
        )
    try:
        parts = {"": _content(path)}
        if suffix == ".gltf":
            for buffer in json.loads(parts[""]).get("buffers", ()):
                uri = str(buffer.get("uri", ""))
                if uri and not uri.startswith("data:"):
                    part = path.parent / checked_name(uri)
                    if leads_out(part, [path.parent]):
                        raise ValueError(f"{uri} lies outside its folder")  # noqa: TRY301
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
        if suffix in ("gltf", "glb"):
            content = _without_pictures(content, is_binary=suffix == "glb")
        words: dict[str, Any] = {"skip_materials": True} if suffix in ("obj", "ply") else {}
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix, resolver=parts, process=False, **words
        )
        pieces = [scene.graph[node] for node in scene.graph.nodes_geometry]
        given = _merged([(matrix, scene.geometry[name]) for matrix, name in pieces])
    except Exception as fault:  # a foreign parser on foreign bytes may raise anything
        raise CaptureError(
            f"the mesh {path} cannot be read ({fault or type(fault).__name__}); check the file"
        ) from fault
    if suffix in ("gltf", "glb"):
        x, y, z = given.vertices.T
        given = replace(given, vertices=np.stack([x, -z, y], axis=1))
    return _sound(given, path)


def _content(path: Path) -> bytes:
    with regular(path, MAX_BYTES) as file:
        return file.read()


def _merged(pieces: list[tuple[Any, Any]]) -> Given:
    """One soup of all pieces that have faces, each at its place."""
    vertices, faces, uvs, count = [], [], [], 0
    for matrix, piece in pieces:
        if len(getattr(piece, "faces", ())) == 0:
            continue
        own = np.asarray(piece.vertices, np.float64)
        corners = np.asarray(piece.faces, np.int64)
        if corners.min() < 0 or corners.max() >= len(own):
            raise ValueError("a face has a corner that is not there")
        turned = np.linalg.det(matrix[:3, :3]) < 0
        faces.append((corners[:, ::-1] if turned else corners) + count)
        vertices.append(own @ matrix[:3, :3].T + matrix[:3, 3])
        uv = getattr(piece.visual, "uv", None)
        fits = uv is not None and np.shape(uv) == (len(own), 2)
        uvs.append(np.asarray(uv, np.float64) if fits else np.full((len(own), 2), np.nan))
        count += len(own)
    if not faces:
        return Given(
            vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int32), uvs=np.zeros((0, 2))
        )
    return Given(
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces).astype(np.int32),
        uvs=np.concatenate(uvs),
    )


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
    given = replace(
        given, faces=given.faces[usable], vertices=np.where(finite[:, None], given.vertices, 0.0)
    )
    return given.noted(
        f"{(~usable).sum()} of {len(usable)} faces of the mesh have corners that are no numbers; "
        "they were left out."
    )


def _without_pictures(content: bytes, *, is_binary: bool) -> bytes:
    """A glTF file without its pictures, which nobody needs and which foreign bytes may hide in."""
    if not is_binary:
        return json.dumps(_bare(json.loads(content))).encode()
    magic, version, _ = struct.unpack_from("<4sII", content)
    (length,) = struct.unpack_from("<I", content, 12)
    text = json.dumps(_bare(json.loads(content[20 : 20 + length]))).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sII", magic, version, 20 + len(text) + len(rest))
    return head + struct.pack("<I4s", len(text), _JSON) + text + rest


def _bare(document: dict[str, Any]) -> dict[str, Any]:
    kept = {k: v for k, v in document.items() if k not in ("images", "textures", "samplers")}
    # texture coordinates are read for primitives with a material only
    kept["materials"] = [{}] * max(1, len(document.get("materials", ())))
    for mesh in kept.get("meshes", ()):
        for primitive in mesh["primitives"]:
            primitive.setdefault("material", 0)
    return kept
