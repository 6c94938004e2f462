# SPDX-License-Identifier: Apache-2.0
"""Triangles and normal maps of glTF 2.0 files from anybody; all is counted before it is allocated.

Faults are sentences of ours; each says what is wrong with the file, for whoever wrote it.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from robir.capture.gltf_json import COMPRESSED, MeshFaultError, buffer_of, entry, refuse_extension
from robir.capture.images.decode import MAX_PIXELS, SCAN, excess
from robir.jobs.records import check

MOST_FACES = 5_000_000
MOST_CORNERS = 6_000_000  # of all parts of a file together, however often a part is shown
_MOST_NODES = 30_000

_KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WHOLE = (5121, 5123, 5125)  # of these, what indices may be
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6

_FORMATS = ("PNG", "JPEG", "WEBP")  # of pictures of normal maps

Codes = NDArray[np.uint8]
Document = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshPart:
    """Triangles of one material."""

    vertices: NDArray[np.float64]  # (N, 3) float64
    faces: NDArray[np.int64]  # (F, 3) int64
    uvs: NDArray[np.float64] | None = None  # (N, 2) float64, v upwards; None where there are none
    normals: NDArray[np.float64] | None = None  # (N, 3) as in the file, if any
    material: int = -1  # its number; -1 for none


def read_parts(
    document: dict[str, Any], binary: bytes, files: Mapping[str, bytes]
) -> list[tuple[NDArray[np.float64], MeshPart]]:
    """All triangles that the scene shows, each part with its (4, 4) place, by files by name."""
    reader = _Reader(document, binary, files)
    shown = list(_shown(document))
    meshes = document.get("meshes", [])
    faces = corners = 0
    for number, _ in shown:
        for primitive in entry(meshes, number, "a node", "mesh")["primitives"]:
            corners += reader.count(primitive["attributes"].get("POSITION"))
            faces += reader.count(primitive.get("indices", primitive["attributes"].get("POSITION")))
    if faces > 3 * MOST_FACES or corners > MOST_CORNERS:
        raise MeshFaultError(
            f"it shows {faces // 3} faces with {corners} corners; up to {MOST_FACES} faces and "
            f"{MOST_CORNERS} corners are read"
        )
    known: dict[int, list[MeshPart]] = {}
    found = []
    for number, matrix in shown:
        if number not in known:
            primitives = enumerate(meshes[number]["primitives"])
            parts = (reader.part(p, f"primitive {n} of mesh {number}") for n, p in primitives)
            known[number] = [part for part in parts if part is not None]
        found += [(matrix, part) for part in known[number]]
    return found


def _shown(document: dict[str, Any]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Numbers of the meshes that the scene shows, and where."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    if scenes:
        roots = entry(scenes, document.get("scene", 0), "the file", "scene").get("nodes", [])
    else:
        below = {child for node in nodes for child in node.get("children", ())}
        roots = [number for number in range(len(nodes)) if number not in below]
    if len(nodes) > _MOST_NODES:
        raise MeshFaultError(f"it has {len(nodes)} nodes, and up to {_MOST_NODES} are read")
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        number, above = waiting.pop()
        node = entry(nodes, number, "the scene or a node", "node")
        if number in seen:
            raise MeshFaultError(f"node {number} stands in more than one place")
        seen.add(number)
        place = above @ _place(node, number)
        if "mesh" in node:
            yield node["mesh"], place
        waiting += [(child, place) for child in reversed(node.get("children", []))]


def _place(node: dict[str, Any], number: int) -> NDArray[np.float64]:
    lengths = {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}
    for key, length in lengths.items():
        values = node.get(key, [0.0] * length)
        if len(values) != length or not all(abs(value) < 1e30 for value in values):
            raise MeshFaultError(f"the {key} of node {number} is no {length} numbers of sane size")
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    place, turn = np.eye(4), np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    if np.linalg.norm(turn) < 1e-9:
        raise MeshFaultError(f"the rotation of node {number} is none")
    place[:3, :3] = Rotation.from_quat(turn).as_matrix()
    place[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
    place[:3, 3] = node.get("translation", (0, 0, 0))
    return place


class _Reader:
    """Reads primitives of one file."""

    def __init__(self, document: dict[str, Any], binary: bytes, files: Mapping[str, bytes]) -> None:
        """Find the buffers; see `read_parts`."""
        self._document = document
        self._buffers: list[bytes] = []
        for number, buffer in enumerate(document.get("buffers", ())):
            content = buffer_of(buffer["uri"], files) if "uri" in buffer else binary
            if len(content) < buffer["byteLength"]:
                raise MeshFaultError(f"buffer {number} is cut off")
            self._buffers.append(content)

    def count(self, accessor: int | None) -> int:
        """Entries of an accessor, of sane size; 0 for none."""
        if accessor is None:
            return 0
        table = entry(self._document.get("accessors", []), accessor, "a primitive", "accessor")
        if not 0 <= table["count"] <= 3 * MOST_FACES:
            raise MeshFaultError(f"accessor {accessor} has {table['count']} entries")
        return table["count"]

    def part(self, primitive: dict[str, Any], who: str) -> MeshPart | None:
        """Triangles of a primitive; None for lines, points and what has no places."""
        attributes, mode = primitive["attributes"], primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
            return None
        table = self._document["accessors"][attributes["POSITION"]]
        if "bufferView" not in table and "sparse" not in table:
            for name in primitive.get("extensions", {}):
                if name in COMPRESSED:
                    refuse_extension(name)
        for name in attributes.keys() & {"NORMAL", "TEXCOORD_0", "TEXCOORD_1"}:
            if self.count(attributes[name]) != table["count"]:
                raise MeshFaultError(f"{who} has another number of {name} than of places")
        vertices = self._array(attributes["POSITION"], "VEC3", f"the places of {who}")
        faces = self._faces(primitive, mode, len(vertices), who)
        material = primitive.get("material", -1)
        normals = None
        if "NORMAL" in attributes:
            normals = self._array(attributes["NORMAL"], "VEC3", f"the normals of {who}")
        uvs = self._uvs(attributes, material, who)
        return MeshPart(vertices=vertices, faces=faces, uvs=uvs, normals=normals, material=material)

    def _faces(
        self, primitive: dict[str, Any], mode: int, count: int, who: str
    ) -> NDArray[np.int64]:
        if "indices" in primitive:
            order = self._array(primitive["indices"], "SCALAR", f"the indices of {who}", np.int64)
            order = order[:, 0]
        else:
            order = np.arange(count)
        if len(order) and (order.min() < 0 or order.max() >= count):
            raise MeshFaultError(f"a face of {who} has a corner that is not there")
        if mode == _TRIANGLES:
            return order[: len(order) // 3 * 3].reshape(-1, 3)
        number = np.arange(max(0, len(order) - 2))
        if mode == _FAN:
            corners = np.stack([np.zeros_like(number), number + 1, number + 2], axis=1)
        else:
            odd = number % 2
            corners = np.stack([number + odd, number + 1 - odd, number + 2], axis=1)
        return order[corners]

    def _uvs(
        self, attributes: dict[str, int], material: int, who: str
    ) -> NDArray[np.float64] | None:
        """Texture coordinates as the material's texture is laid on by them, v upwards."""
        named = self._texture(material, who)
        moved = _table(_table(named.get("extensions")).get("KHR_texture_transform"))
        layer = moved.get("texCoord", named.get("texCoord", 0))
        accessor = attributes.get(f"TEXCOORD_{layer}")
        if accessor is None or self.count(accessor) != self.count(attributes["POSITION"]):
            return None
        uvs = self._array(accessor, "VEC2", f"the texture coordinates of {who}")
        if moved:
            uvs = _transformed(uvs, moved, who)
        return np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)

    def _texture(self, material: int, who: str) -> dict[str, Any]:
        """What the material says of its colour's texture; empty where it has none."""
        if material < 0:
            return {}
        table = entry(self._document.get("materials", []), material, who, "material")
        return _table(_table(table.get("pbrMetallicRoughness")).get("baseColorTexture"))

    def _array(self, accessor: int, kind: str, who: str, dtype: Any = np.float64) -> NDArray[Any]:
        """Numbers (N, W) of an accessor, dequantised and with its sparse values."""
        self.count(accessor)
        table = self._document["accessors"][accessor]
        if table["type"] != kind:
            raise MeshFaultError(f"{who} are {table['type'][:9]} instead of {kind}")
        if dtype is np.int64 and (table["componentType"] not in _WHOLE or table.get("normalized")):
            raise MeshFaultError(f"{who} are no whole numbers")
        shape = (table["count"], _WIDTHS[kind])
        if "bufferView" in table:
            values = self._view(table, table["componentType"], shape, who).astype(dtype)
        else:
            values = np.zeros(shape, dtype)
        if "sparse" in table:
            sparse = table["sparse"]
            places, numbers = sparse["indices"], sparse["values"]
            if not 0 <= sparse["count"] <= shape[0] or places["componentType"] not in _WHOLE:
                raise MeshFaultError(f"{who} replace {sparse['count']} of {shape[0]} entries")
            rows = self._view(places, places["componentType"], (sparse["count"], 1), who)
            rows = rows[:, 0].astype(np.int64)
            if len(rows) and not 0 <= rows.min() <= rows.max() < shape[0]:
                raise MeshFaultError(f"{who} replace an entry that is not there")
            few = (sparse["count"], shape[1])
            values[rows] = self._view(numbers, table["componentType"], few, who)
        if table.get("normalized") and table["componentType"] != 5126:
            most = np.iinfo(_KINDS[table["componentType"]]).max
            values = np.maximum(values / most, -1.0)
        return values

    def _view(
        self, table: dict[str, Any], component: int, shape: tuple[int, int], who: str
    ) -> NDArray[Any]:
        """Numbers as they lie in a buffer."""
        if component not in _KINDS:
            raise MeshFaultError(f"{who} are numbers of an unknown kind ({component})")
        views = self._document.get("bufferViews", [])
        view = entry(views, table["bufferView"], who, "buffer view")
        buffer = entry(self._buffers, view["buffer"], "a buffer view", "buffer")
        kind = np.dtype(_KINDS[component])
        size = shape[1] * kind.itemsize
        stride = view.get("byteStride", size)
        start, inner = view.get("byteOffset", 0), table.get("byteOffset", 0)
        end = inner + (shape[0] - 1) * stride + size if shape[0] else inner
        if (
            min(start, inner, view["byteLength"]) < 0
            or not size <= stride <= 256
            or end > view["byteLength"]
            or start + view["byteLength"] > len(buffer)
        ):
            raise MeshFaultError(f"{who} lie outside their buffer")
        strides = (stride, kind.itemsize)
        return np.ndarray(shape, kind, buffer, start + inner, strides)


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _transformed(uvs: NDArray[np.float64], moved: dict[str, Any], who: str) -> NDArray[np.float64]:
    """Texture coordinates after KHR_texture_transform: scaled, turned, shifted."""
    form = {"offset?": [float], "scale?": [float], "rotation?": float, "texCoord?": int}
    try:
        check(moved, form, "KHR_texture_transform")
        (across, down), (u, v) = moved.get("scale", (1, 1)), moved.get("offset", (0, 0))
    except ValueError as fault:
        raise MeshFaultError(f"the texture of {who} is laid on by no transform") from fault
    angle = moved.get("rotation", 0.0)
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y = uvs[:, 0] * across, uvs[:, 1] * down
    return np.stack([cosine * x + sine * y + u, cosine * y - sine * x + v], axis=1)


def normal_images(document: Document) -> list[Document]:
    """Entries of the images that hold a glTF's normal maps; none if its materials name none."""
    return [_image(document, named) for named in _named(document)[0]]


def normal_maps(
    document: Document, binary: bytes, parts: Mapping[str, bytes]
) -> tuple[tuple[Codes, ...], dict[int, int]]:
    """The maps (H, W, 3), green towards larger v, and by number which of them a material has."""
    distinct, of_material = _named(document)
    maps, pixels = [], 0
    for named in distinct:
        content = _content(_image(document, named), document, binary, parts)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the size is looked at here
                file = Image.open(io.BytesIO(content), formats=_FORMATS)
            with file:
                pixels += file.width * file.height
                scans = content.count(SCAN) if file.format == "JPEG" else 1
                if what := excess(file.size, scans):
                    raise MeshFaultError(f"it {what}")
                if pixels > MAX_PIXELS:
                    raise MeshFaultError("with the others it has too many pixels")
                codes = np.array(file.convert("RGB"))
        except (OSError, SyntaxError, Image.DecompressionBombError) as fault:
            raise MeshFaultError("it is no picture that can be read, or damaged") from fault
        maps.append(_scaled(codes, float(named.get("scale", 1.0))))
    return tuple(maps), of_material


def _scaled(codes: Codes, strength: float) -> Codes:
    """A map whose bumps are so many times as steep."""
    if strength == 1.0:
        return codes
    if not math.isfinite(strength):
        raise MeshFaultError("its strength is no number")
    for row in codes:  # one after another, for a whole map may have a hundred million texels
        normal = row / 127.5 - 1
        normal[..., :2] *= strength
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        row[:] = np.rint(127.5 * (normal + 1))
    return codes


def _named(document: Document) -> tuple[list[Document], dict[int, int]]:
    """What the materials of triangles say of normal maps, and which of it each material says."""
    primitives = [part for mesh in document.get("meshes", ()) for part in mesh["primitives"]]
    used = {part["material"] for part in primitives if part.get("material") is not None}
    distinct: list[Document] = []
    of_material: dict[int, int] = {}
    for material in sorted(used):
        table = entry(document.get("materials", []), material, "a face", "material")
        named = table.get("normalTexture")
        if named is None:
            continue
        if not isinstance(named, dict):
            raise MeshFaultError("it is named by no table")
        if named.get("texCoord", 0) != 0 or "KHR_texture_transform" in named.get("extensions", {}):
            raise MeshFaultError("it has texture coordinates of its own")
        if named not in distinct:
            distinct.append(named)
        of_material[material] = distinct.index(named)
    return distinct, of_material


def _image(document: Document, named: Document) -> Document:
    texture = entry(document.get("textures", []), named.get("index"), "it", "texture")
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    source = texture.get("source", webp.get("source"))
    return entry(document.get("images", []), source, "its texture", "image")


def _content(
    image: Document, document: Document, binary: bytes, parts: Mapping[str, bytes]
) -> bytes:
    uri = image.get("uri")
    if uri is None:
        view = entry(document.get("bufferViews", []), image.get("bufferView"), "it", "buffer view")
        start = view.get("byteOffset", 0)
        buffer = entry(document.get("buffers", []), view["buffer"], "its buffer view", "buffer")
        source = binary if "uri" not in buffer else buffer_of(buffer["uri"], parts)
        if min(start, view["byteLength"]) < 0:
            raise MeshFaultError("its buffer view lies outside the buffer")
        return source[start : start + view["byteLength"]]
    return buffer_of(uri, parts)
