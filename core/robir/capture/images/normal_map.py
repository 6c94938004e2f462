# SPDX-License-Identifier: Apache-2.0
"""The tangent-space normal maps that the materials of a glTF file give its mesh."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.images.decode import MAX_PIXELS

Codes = NDArray[np.uint8]
Document = dict[str, Any]

_FORMATS = ("PNG", "JPEG", "WEBP")


MOST_PIXELS = 4 * MAX_PIXELS
"""Of all normal maps of a file together."""


def normal_images(document: Document) -> list[Document]:
    """Entries of the images that hold a mesh's normal maps; none if its materials name none.

    Args:
        document: JSON of a glTF file.

    Raises:
        ValueError: If one does not lie on the mesh's first texture coordinates as they are.
    """
    return [_image(document, named) for named in _named(document)[0]]


def normal_maps(
    document: Document, binary: bytes, parts: Mapping[str, bytes]
) -> tuple[tuple[Codes, ...], dict[int, int]]:
    """The maps themselves, (H, W, 3) each, green towards larger v, their strength applied.

    Args:
        document: JSON of a glTF file.
        binary: Binary chunk of a GLB file, or nothing.
        parts: Contents of files beside it by the names that it uses.

    Returns:
        The maps, no two of the same texture and strength, and which of them each material has, by
        its number; materials without one are missing.

    Raises:
        ValueError: As `normal_images`; or if a picture is missing or too large.
        OSError: If one cannot be decoded.
    """
    distinct, of_material = _named(document)
    maps, pixels = [], 0
    for named in distinct:
        content = _content(_image(document, named), document, binary, parts)
        with Image.open(io.BytesIO(content), formats=_FORMATS) as file:
            size = file.width * file.height
            if size > MAX_PIXELS:
                raise ValueError(f"it has {file.width} by {file.height} pixels")
            pixels += size
            if pixels > MOST_PIXELS:
                raise ValueError(f"its parts have more than {MOST_PIXELS} pixels together")
            codes = np.array(file.convert("RGB"))
        maps.append(_scaled(codes, float(named.get("scale", 1.0))))
    return tuple(maps), of_material


def _scaled(codes: Codes, strength: float) -> Codes:
    """A map whose bumps are so many times as steep."""
    if strength == 1.0:
        return codes
    normal = codes / 127.5 - 1
    normal[..., :2] *= strength
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return np.rint(127.5 * (normal + 1)).astype(np.uint8)


def _named(document: Document) -> tuple[list[Document], dict[int, int]]:
    """What the materials of triangles say of normal maps, and which of it each material says."""
    primitives = [part for mesh in document.get("meshes", ()) for part in mesh["primitives"]]
    used = {part["material"] for part in primitives if part.get("material") is not None}
    distinct: list[Document] = []
    of_material: dict[int, int] = {}
    for material in sorted(used):
        named = document["materials"][material].get("normalTexture")
        if named is None:
            continue
        if named.get("texCoord", 0) != 0 or "KHR_texture_transform" in named.get("extensions", {}):
            raise ValueError("it has texture coordinates of its own")
        if named not in distinct:
            distinct.append(named)
        of_material[material] = distinct.index(named)
    return distinct, of_material


def _image(document: Document, named: Document) -> Document:
    """Entry of the image that a material's normal texture shows."""
    texture = document["textures"][named["index"]]
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    return document["images"][texture.get("source", webp.get("source"))]


def _content(
    image: Document, document: Document, binary: bytes, parts: Mapping[str, bytes]
) -> bytes:
    uri = image.get("uri")
    if uri is None:
        view = document["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        buffer = document["buffers"][view["buffer"]].get("uri")
        source = binary if buffer is None else _of_uri(buffer, parts)
        return source[start : start + view["byteLength"]]
    return _of_uri(uri, parts)


def _of_uri(uri: str, parts: Mapping[str, bytes]) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    if uri not in parts:
        raise ValueError(f"{uri} is not there")
    return parts[uri]
