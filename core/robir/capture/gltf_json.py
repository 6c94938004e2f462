# SPDX-License-Identifier: Apache-2.0
"""The JSON of glTF 2.0 files from anybody: bounded, of one form, and without unknown extensions."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Mapping
from typing import Any

from robir.jobs.records import check

_MOST_TOKENS = 4_000_000
_JSON_BYTES = 1 << 26  # a file of a million nodes has a tenth of these
_VIEW = {"bufferView": int, "byteOffset?": int}
# what is read of a file; see `robir.jobs.records`
_FORM = {
    "asset": {"version": str},
    "extensionsRequired?": [str], "scene?": int, "scenes?": [{"nodes?": [int]}],
    "nodes?": [
        {"mesh?": int, "children?": [int], "matrix?": [float], "translation?": [float],
         "rotation?": [float], "scale?": [float]}
    ],
    "meshes?": [
        {"primitives": [
            {"attributes": {...: int}, "indices?": int, "mode?": int, "material?": int,
             "extensions?": {}}
        ]}
    ],
    "accessors?": [
        {"bufferView?": int, "byteOffset?": int, "componentType": int, "normalized?": bool,
         "count": int, "type": str,
         "sparse?": {"count": int, "indices": _VIEW | {"componentType": int}, "values": _VIEW}}
    ],
    "bufferViews?": [{"buffer": int, "byteOffset?": int, "byteLength": int, "byteStride?": int}],
    "buffers?": [{"uri?": str, "byteLength": int}],
    "materials?": [{"name?": str}],
    "textures?": [{}], "images?": [{"uri?": str, "bufferView?": int}],
}  # fmt: skip
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")
# beginnings of the names of extensions that change no triangle, or that are read
_HARMLESS += ("KHR_mesh_quantization", "KHR_xmp", "EXT_lights_")
COMPRESSED = {
    "KHR_draco_mesh_compression": "compressed with Draco",
    "EXT_meshopt_compression": "compressed with meshopt",
    "KHR_meshopt_compression": "compressed with meshopt",
}


class MeshFaultError(ValueError):
    """A mesh file is damaged or too large; the message says where."""


def opened(content: bytes, *, is_binary: bool) -> tuple[dict[str, Any], bytes]:
    """The JSON of a glTF file and the binary chunk of a GLB, or a `MeshFaultError`."""
    text, binary = _chunks(content) if is_binary else (content, b"")
    if len(text) > _JSON_BYTES or sum(text.count(sign) for sign in b"{[,") > _MOST_TOKENS:
        raise MeshFaultError(f"its JSON has {len(text)} bytes and too many entries")
    try:
        document = json.loads(text.decode("utf-8"))
    except RecursionError:
        raise MeshFaultError("its JSON is nested too deeply") from None
    except ValueError as fault:
        raise MeshFaultError("its JSON is cut off or damaged") from fault
    try:
        check(document, _FORM, "file")
    except ValueError as fault:
        raise MeshFaultError(f"its JSON is no glTF: {fault}") from fault
    if not document["asset"]["version"].startswith("2."):
        raise MeshFaultError(f"it is glTF {document['asset']['version'][:9]!r} and 2.0 is read")
    for name in document.get("extensionsRequired", ()):
        refuse_extension(name)
    return document, binary


def buffer_of(uri: str, files: Mapping[str, bytes]) -> bytes:
    """Contents of a buffer or picture that a file names or holds as text."""
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2])
        except binascii.Error:
            raise MeshFaultError("a buffer that it holds as text is damaged") from None
    if uri not in files:
        raise MeshFaultError(f"{uri[:80]} is not there")
    return files[uri]


def _chunks(content: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB."""
    if len(content) < 20 or content[:4] != b"glTF":
        raise MeshFaultError("it does not begin as a GLB does")
    version, total = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise MeshFaultError(f"it is a GLB of version {version}, and 2 is read")
    if total > len(content):
        raise MeshFaultError(f"it is cut off: it has {len(content)} of {total} bytes")
    chunks, at = {}, 12
    while at + 8 <= total:
        length, kind = struct.unpack_from("<I4s", content, at)
        if at + 8 + length > total:
            raise MeshFaultError("a chunk of it is longer than the file")
        chunks.setdefault(kind, content[at + 8 : at + 8 + length])
        at += 8 + length
    if b"JSON" not in chunks:
        raise MeshFaultError("it has no JSON")
    return chunks[b"JSON"], chunks.get(b"BIN\0", b"")


def refuse_extension(name: str) -> None:
    """Refuse what a file cannot be understood without."""
    if not name.startswith(_HARMLESS):
        what = COMPRESSED.get(name, f"written with {name[:60]}")
        raise MeshFaultError(f"it is {what}, which is not read; export it without that")


def entry(entries: list[Any], index: Any, who: str, what: str) -> Any:
    """An entry of a list of the file by its number."""
    if not isinstance(index, int) or not 0 <= index < len(entries):
        raise MeshFaultError(f"{who} names {what} {index}, which is not there")
    return entries[index]
