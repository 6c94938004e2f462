# SPDX-License-Identifier: Apache-2.0
"""The tangent-space normal map that a glTF file gives its mesh, where it has one for all of it."""

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


def normal_image(document: Document) -> Document | None:
    """Entry of the image that holds a mesh's normal map; None if its materials name none.

    Args:
        document: JSON of a glTF file.

    Raises:
        ValueError: If there are several, or one that does not lie on the mesh's first texture
            coordinates as they are; says which.
    """
    named = _named(document)
    if named is None:
        return None
    texture = document["textures"][named["index"]]
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    return document["images"][texture.get("source", webp.get("source"))]


def normal_map(document: Document, binary: bytes, parts: Mapping[str, bytes]) -> Codes | None:
    """The map itself, (H, W, 3), green towards larger v, its strength applied.

    Args:
        document: JSON of a glTF file.
        binary: Binary chunk of a GLB file, or nothing.
        parts: Contents of files beside it by the names that it uses.

    Raises:
        ValueError: As `normal_image`; or if the picture is missing or too large.
        OSError: If it cannot be decoded.
    """
    image, named = normal_image(document), _named(document)
    if image is None or named is None:
        return None
    with Image.open(io.BytesIO(_content(image, document, binary, parts)), formats=_FORMATS) as file:
        if file.width * file.height > MAX_PIXELS:
            raise ValueError(f"it has {file.width} by {file.height} pixels")
        codes = np.array(file.convert("RGB"))
    strength = float(named.get("scale", 1.0))
    if strength == 1.0:
        return codes
    normal = codes / 127.5 - 1
    normal[..., :2] *= strength
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return np.rint(127.5 * (normal + 1)).astype(np.uint8)


def _named(document: Document) -> Document | None:
    """What the materials of all triangles say of their normal map, if they say the same."""
    primitives = [part for mesh in document.get("meshes", ()) for part in mesh["primitives"]]
    used = {part.get("material") for part in primitives}
    materials = document.get("materials", ())
    named = [None if k is None else materials[k].get("normalTexture") for k in used]
    first = next((one for one in named if one is not None), None)
    if first is None:
        return None
    if any(one != first for one in named):
        raise ValueError("its materials have different ones, or some have none")
    if first.get("texCoord", 0) != 0 or "KHR_texture_transform" in first.get("extensions", {}):
        raise ValueError("it has texture coordinates of its own")
    return first


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
