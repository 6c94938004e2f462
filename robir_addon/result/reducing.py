# SPDX-License-Identifier: GPL-3.0-or-later
"""The object with fewer faces and smaller textures for as long as a file is written."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

_STEP = 0.25  # faces of a level of detail as a share of the one before
_FEWEST = 4


def levels_of_detail(
    asset: bpy.types.Object, most_faces: int, count: int, step: float = _STEP
) -> list[int]:
    """Faces of each level, the finest first; each has a share of those of the one before."""
    faces = len(asset.data.polygons)
    finest = min(faces, most_faces) if most_faces else faces
    return [max(_FEWEST, round(finest * step**level)) for level in range(count)]


@contextmanager
def reduced(asset: bpy.types.Object, faces: int, side: int) -> Iterator[None]:
    """Give the object at most so many faces, textures such a side (0: any), and take it back."""
    before = len(asset.data.polygons)
    modifier = None
    if faces < before:
        modifier = asset.modifiers.new("RobIR faces", "DECIMATE")
        modifier.ratio = faces / before
    swapped = _smaller_textures(asset, side) if side else []
    try:
        yield
    finally:
        if modifier is not None:
            asset.modifiers.remove(modifier)
        for node, image in swapped:
            smaller, node.image = node.image, image
            if smaller.users == 0:
                bpy.data.images.remove(smaller)


def _smaller_textures(
    asset: bpy.types.Object, side: int
) -> list[tuple[bpy.types.Node, bpy.types.Image]]:
    """Put smaller copies into the object's materials; the nodes and what they had."""
    swapped = []
    copies: dict[bpy.types.Image, bpy.types.Image] = {}
    for material in {slot.material for slot in asset.material_slots if slot.material}:
        for node in material.node_tree.nodes if material.node_tree else ():
            image = node.image if node.type == "TEX_IMAGE" else None
            if image is None or max(image.size) <= side:
                continue
            if image not in copies:
                share = side / max(image.size)
                copies[image] = image.copy()
                _shrink(copies[image], [max(1, round(share * pixels)) for pixels in image.size])
                copies[image].pack()
            node.image = copies[image]
            swapped.append((node, image))
    return swapped


def _shrink(image: bpy.types.Image, size: list[int]) -> None:
    """Scale an image, every tile of it; Blender 4.2 can scale the first only, so none."""
    if image.source != "TILED":
        image.scale(*size)
    elif "tile_index" in image.bl_rna.functions["scale"].parameters:
        for index in range(len(image.tiles)):
            image.scale(*size, tile_index=index)
