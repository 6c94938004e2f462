# SPDX-License-Identifier: Apache-2.0
"""Texture images of the asset, their islands grown so that filters never reach an empty texel.

The atlas of a mesh with UDIM tiles is cut into them, each a texture of its own. A mesh without has
one texture, which is treated as its only tile, without a number.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

from robir.errors import StorageError
from robir.evaluation.metrics import srgb_from_linear
from robir.evaluation.photos import read_picture, thumbnail
from robir.geometry.mesh.tiles import cell, cells_along, tile_of_faces, within
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, of_tile, replacing, tiles_there

Array = NDArray[np.floating[Any]]
Codes = NDArray[np.uint8]

_MARGIN_AT_2K = 8
_METAL = 0.02

# all files that export/textures may hold where there are no tiles
TEXTURES = (
    "albedo.png", "albedo.exr", "roughness.png", "metallic.png", "normal.png", "coverage.png",
    "uncertainty.png",
)  # fmt: skip
UNCERTAINTY_AT_255 = 1.0  # standard error of log albedo at the brightest code


@dataclass(frozen=True, slots=True, kw_only=True)
class Textures:
    """The asset's textures, row 0 at v = 1, islands grown."""

    albedo_linear: Array  # (T, T, 3), linear Rec.709 in [0, 1]
    roughness: Array  # (T, T), perceptual, in [0, 1]
    metallic: Array | None  # (T, T) in [0, 1], or None if nothing is metal
    coverage: Array  # (T, T), share of the training views that saw the texel, in [0, 1]
    uncertainty: Array  # (T, T), standard error of log albedo, up to one factor a channel
    specular: float  # 1 where what is no metal has F0 = 0.04; 0 where it reflects nothing
    normal_map: Codes | None = None  # (H, W, 3) codes of the user's, green towards larger v


def grown(image: Array, inside: NDArray[np.bool_], margin: int) -> Array:
    """Islands of (T, T) or (T, T, C) with texels up to a margin as the nearest, others the mean."""
    if not inside.any():
        return image.copy()
    distance, nearest = distance_transform_edt(~inside, return_indices=True)
    filled = image[tuple(nearest)]
    filled[distance > margin] = image[inside].mean(axis=0)
    return filled


def finished_textures(arrays: dict[str, Array], num_views: int) -> Textures:
    """Grow the appearance stage's textures by 8 texels, more above 2048 a side; as shipped."""
    inside = arrays["inside"].astype(bool)
    margin = max(_MARGIN_AT_2K, round(_MARGIN_AT_2K * inside.shape[0] / 2048))

    def fill(name: str) -> Array:
        return grown(np.asarray(arrays[name], np.float32), inside, margin)

    has_metal = bool((arrays["metallic"][inside] > _METAL).any())
    return Textures(
        albedo_linear=np.clip(fill("albedo_linear"), 0.0, 1.0),
        roughness=np.clip(fill("roughness"), 0.0, 1.0),
        metallic=np.clip(fill("metallic"), 0.0, 1.0) if has_metal else None,
        coverage=np.clip(np.where(inside, arrays["coverage"] / max(num_views, 1), 0.0), 0.0, 1.0),
        uncertainty=np.maximum(np.where(inside, arrays["uncertainty"], 0.0), 0.0),
        specular=float(arrays.get("specular", 1.0)),
    )


def stored_normal_map(path: Path) -> Codes | None:
    """The normal map (H, W, 3) of the geometry stage, or None; a `StorageError` if damaged."""
    if not path.is_file():
        return None
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            return np.array(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as fault:
        raise StorageError(
            f"{path} cannot be read ({fault}). Run the geometry stage again."
        ) from fault


def write_textures(textures: Textures, folder: Path, tile: int | None = None) -> None:
    """Write the images of export/textures, of one tile where there are such.

    albedo.png is sRGB, albedo.exr linear half; roughness, metallic and normal are "Non-Color";
    coverage is the share of views and uncertainty the standard error of log albedo,
    UNCERTAINTY_AT_255 at code 255.
    """
    metallic = None if textures.metallic is None else codes(textures.metallic)
    images = {
        "albedo.png": codes(srgb_from_linear(textures.albedo_linear)),
        "roughness.png": codes(textures.roughness),
        "metallic.png": metallic,
        "normal.png": textures.normal_map,
        "coverage.png": codes(textures.coverage),
        "uncertainty.png": codes(textures.uncertainty / UNCERTAINTY_AT_255),
    }
    for name, image in images.items():
        path = of_tile(folder / name, tile)
        if image is None:
            path.unlink(missing_ok=True)
        else:
            write_png(path, image)
    exr = of_tile(folder / "albedo.exr", tile)
    write_exr(exr, textures.albedo_linear.astype(np.float16))


def codes(values: Array) -> Codes:
    """Values in [0, 1] as 8-bit codes, rounded; others are clipped."""
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


def encoded(image: Codes, **how: Any) -> bytes:
    """Codes as the content of a picture file."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, **how)
    return stream.getvalue()


def write_png(path: Path, image: Codes) -> None:
    """Write (H, W), (H, W, 3) or (H, W, 4) codes as PNG, atomically."""
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def write_exr(path: Path, image_linear: NDArray[Any]) -> None:
    """Write (H, W, 3) linear Rec.709 as a scan-line EXR of the array's own type, atomically."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {axis: np.ascontiguousarray(image_linear[..., i]) for i, axis in enumerate("RGB")}
    with replacing(path) as temporary:
        OpenEXR.File(header, planes).write(str(temporary))


@dataclass(frozen=True, slots=True, kw_only=True)
class TexturedPart:
    """Faces with a texture of their own."""

    tile: int | None  # number of their tile; None where there are no tiles
    mesh: Mesh  # those faces, their texture coordinates in 0..1
    textures: Textures  # for these


def tile_textures(
    arrays: dict[str, Array], tiles: NDArray[np.int32], num_views: int, normal_map: Path
) -> tuple[Textures, ...]:
    """Textures of each tile (Nt,) or of the whole; all have metal if one has, for one material."""
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


def parts_of(mesh: Mesh, textures: Sequence[Textures]) -> Iterator[TexturedPart]:
    """The mesh tile by tile, those without faces left out."""
    count = len(mesh.tiles)
    if not count:
        yield TexturedPart(tile=None, mesh=mesh, textures=textures[0])
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
        yield TexturedPart(tile=number, mesh=own, textures=textures[index])


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
