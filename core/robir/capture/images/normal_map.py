# SPDX-License-Identifier: Apache-2.0
"""The tangent-space normal maps that the materials of a glTF file give its mesh."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.gltf_json import MeshFaultError, buffer_of, entry
from robir.capture.images.decode import MAX_DECODED, MAX_PIXELS, MAX_SIDE, SCAN

Codes = NDArray[np.uint8]
Document = dict[str, Any]

_FORMATS = ("PNG", "JPEG", "WEBP")


def normal_images(document: Document) -> list[Document]:
    """Entries of the images that hold a glTF's normal maps; none if its materials name none."""
    return [_image(document, named) for named in _named(document)[0]]


def normal_maps(
    document: Document, binary: bytes, parts: Mapping[str, bytes]
) -> tuple[tuple[Codes, ...], dict[int, int]]:
    """The maps themselves, (H, W, 3) each, green towards larger v, their strength applied.

    No two are of the same texture and strength. Also which of them each material has, by its
    number; materials without one are missing. `binary` and `parts` are as for `read_parts`.
    """
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
                if pixels > MAX_PIXELS or max(file.size) > MAX_SIDE:
                    raise MeshFaultError(f"{file.width} by {file.height} pixels are too many")
                if scans > 1 and scans * file.width * file.height > MAX_DECODED:
                    raise MeshFaultError(f"it stores its picture in {scans} passes")
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
    """Entry of the image that a material's normal texture shows."""
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
