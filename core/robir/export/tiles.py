# SPDX-License-Identifier: Apache-2.0
"""The asset's textures by UDIM tiles: the atlas is cut into them, each a texture of its own.

A mesh without tiles has one texture, which is treated as its only tile, without a number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.evaluation.photos import read_picture
from robir.evaluation.sheet import thumbnail
from robir.export.textures import (
    TEXTURES,
    Textures,
    finished_textures,
    stored_normal_map,
    write_textures,
)
from robir.geometry.mesh.tiles import cell, cells_along, tile_of_faces, within
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, of_tile, tiles_there

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Faces with a texture of their own."""

    tile: int | None  # number of their tile; None where there are no tiles
    mesh: Mesh  # those faces, their texture coordinates in 0..1
    textures: Textures  # for these


def tile_textures(
    arrays: dict[str, Array], tiles: NDArray[np.int32], num_views: int, normal_map: Path
) -> tuple[Textures, ...]:
    """Textures of each of the tiles (Nt,), or of the whole atlas; islands grow within a tile only.

    What one tile has and another lacks, metal and normal maps, all get: a material reads its files
    of all tiles by one name. `normal_map` is the user's file, as it is called without tiles; often
    absent.
    """
    made = []
    for index, number in enumerate(tiles.tolist() or [None]):
        parts = {
            name: cell(array, index, len(tiles)) if array.ndim else array
            for name, array in arrays.items()
        }
        bumps = stored_normal_map(of_tile(normal_map, number))
        made.append(replace(finished_textures(parts, num_views), normal_map=bumps))
    if any(one.metallic is not None for one in made):
        made = [
            one if one.metallic is not None else replace(one, metallic=0 * one.roughness)
            for one in made
        ]
    return tuple(made)


def write_tiles(textures: Sequence[Textures], tiles: NDArray[np.int32], folder: Path) -> None:
    """Write the images of export/textures, of every tile by itself, and remove those of others."""
    numbers = tiles.tolist() or [None]
    for number, one in zip(numbers, textures, strict=True):
        write_textures(one, folder, number)
    for name in TEXTURES:
        for number in {None, *tiles_there(folder / name)} - set(numbers):
            of_tile(folder / name, number).unlink(missing_ok=True)


def parts_of(mesh: Mesh, textures: Sequence[Textures]) -> Iterator[Part]:
    """The mesh tile by tile, those without faces left out."""
    count = len(mesh.tiles)
    if not count:
        yield Part(tile=None, mesh=mesh, textures=textures[0])
        return
    tile = tile_of_faces(mesh.uvs, mesh.uv_faces, count)
    for index, number in enumerate(mesh.tiles.tolist()):
        chosen = tile == index
        if not chosen.any():
            continue
        corners, uv_faces = np.unique(mesh.uv_faces[chosen], return_inverse=True)
        places = within(mesh.uvs[corners], np.full(len(corners), index), count)
        own = replace(
            mesh,
            faces=mesh.faces[chosen],
            uvs=places,
            uv_faces=uv_faces.reshape(-1, 3).astype(np.int32),
            tiles=mesh.tiles[:0],
        )
        yield Part(tile=number, mesh=own, textures=textures[index])


def shown_texture(paths: JobPaths, name: str) -> NDArray[np.uint8] | None:
    """A texture such as "albedo" in small, its tiles row by row; None where it was not written."""
    path = paths.textures / f"{name}.png"
    if path.is_file():
        return thumbnail(read_picture(path))
    numbers = tiles_there(path)
    if not numbers:
        return None
    across = cells_along(len(numbers))
    small = [Image.fromarray(thumbnail(read_picture(of_tile(path, one)))) for one in numbers]
    side = max(1, max(small[0].size) // across)
    rows = -(-len(numbers) // across)
    sheet = Image.new("RGB", (across * side, rows * side))
    for index, picture in enumerate(small):
        row, column = divmod(index, across)
        sheet.paste(picture.convert("RGB").resize((side, side)), (column * side, row * side))
    return np.asarray(sheet)
