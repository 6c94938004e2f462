# SPDX-License-Identifier: Apache-2.0
"""The texture coordinates that the user's mesh brings: kept, as tiles where they are such, or not.

A mesh keeps them if no two places of its surface share a texel. They may lie in 0..1, in another
unit square as a whole (then they are shifted), or over UDIM tiles, every face in one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from robir.capture.mesh_file import Given
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tiles import (
    ACROSS,
    ROWS,
    cells_along,
    numbers_of,
    packed,
    tile_of_faces,
    within,
)
from robir.geometry.mesh.unwrap import rasterise_atlas

FAR = 1e4  # tiles from 0..1 beyond which texture coordinates are none

# of a tile's side: a face whose middle is nearer to a border is moved in by twice that, so that
# rounding cannot take it for one of the next tile
RIM = 1e-5


_OUTSIDE = 1e-3  # of a tile's side: as far as texture coordinates may leave it by rounding
_OVERLAP = 0.03  # share of a tile's layout that may lie on itself: charts' rims do
_SMALLEST = 1e-3  # share of a tile below which a layout is none
_ATLAS_SIDE = 1024  # texels along a side by which a layout is judged, each tile by itself
_MOST_TILES = 100  # beyond which a texture would have too few texels of those that memory holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Texture coordinates for the atlas."""

    uvs: NDArray[np.float32]  # (Nu, 2) float32 in [0, 1]
    uv_faces: NDArray[np.int32]  # (Nf, 3) int32, indices into uvs
    # (Nt,) int32, numbers of the tiles that are its cells; empty for one texture
    tiles: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    notes: tuple[str, ...] = ()  # sentences for the user


def own_layout(given: Given) -> Layout | str:
    """The mesh's own layout, or why it cannot be used, as the end of a sentence."""
    uvs = given.uvs.astype(np.float32)
    used = uvs[np.unique(given.faces)]
    known = np.isfinite(used).all(1)
    if not known.any():
        return "it has none"
    if not known.all():
        return f"{(~known).mean():.0%} of its corners have none"
    if used.min() < -_OUTSIDE or used.max() > 1 + _OUTSIDE:
        layout = _tiled(uvs, given.faces)
    else:
        layout = Layout(uvs=np.nan_to_num(uvs).clip(0, 1), uv_faces=given.faces)
    return layout if isinstance(layout, str) else _fault(given, layout) or layout


def _tiled(uvs: NDArray[np.float32], faces: NDArray[np.int32]) -> Layout | str:
    """A layout over tiles or over another unit square, or why it is neither."""
    corners = uvs[faces].astype(np.float64)
    where = f"its own lie outside 0..1 (from {corners.min():.2f} to {corners.max():.2f})"
    if np.abs(corners).max() > FAR:
        return f"{where}, where no tiles are"
    tile = _tile_of(corners, _OUTSIDE)
    places = corners - tile[:, None]
    astray = ((places < -_OUTSIDE) | (places > 1 + _OUTSIDE)).any(axis=(1, 2))
    if astray.any():
        return f"{where} and {astray.sum()} of its faces reach from one tile into the next"
    found, index = np.unique(tile[:, ::-1], axis=0, return_inverse=True)  # by rows, as the numbers
    found, index = found[:, ::-1], index.reshape(-1)
    if len(found) == 1:
        return _shifted(uvs, faces, found[0])
    if found.min() < 0:
        return f"{where} and below 0 there are no tiles"
    if found[:, 0].max() >= ACROSS or found[:, 1].max() >= ROWS:
        return f"{where} and tiles end at u = {ACROSS} and v = {ROWS}"
    if len(found) > (most := _MOST_TILES):
        return f"{where}, on {len(found)} tiles, and textures are made for {most} at most"
    middle = places.mean(axis=1)
    is_near = (np.minimum(middle, 1 - middle) < RIM).any(axis=1)
    inset = np.where(is_near, 2 * RIM, 0.0)[:, None, None]
    of_corner = np.repeat(index, 3)
    atlas = packed(np.clip(places, inset, 1 - inset).reshape(-1, 2), of_corner, len(found))
    # what faces of a tile share stays shared; a vertex on a border is one for each of its tiles
    whose = (faces.reshape(-1).astype(np.int64) * len(found) + of_corner) * 2
    whose += np.repeat(is_near, 3)
    _, first, uv_faces = np.unique(whose, return_index=True, return_inverse=True)
    return Layout(
        uvs=atlas[first],
        uv_faces=uv_faces.reshape(-1, 3).astype(np.int32),
        tiles=numbers_of(found),
    )


def _tile_of(corners: NDArray[np.float64], outside: float) -> NDArray[np.int64]:
    """Lower left corner (Nf, 2) of the unit square that each face's middle (Nf, 3, 2) lies in."""
    # faces without an area may lie on a border whole; they go to the square before it where the
    # others of the mesh leave the one behind it empty
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    is_flat = np.abs(ax * by - ay * bx) < 1e-12
    middle = corners.mean(axis=1)
    tile = np.floor(middle).astype(np.int64)
    if not is_flat.any() or is_flat.all():
        return tile
    keys = np.array([1, 1 << 20])  # no two squares within FAR have the same
    own, before = tile[is_flat], np.floor(middle[is_flat] - outside).astype(np.int64)
    filled = np.unique(tile[~is_flat] @ keys)
    opens = ~np.isin(own @ keys, filled) & np.isin(before @ keys, filled)
    tile[is_flat] = np.where(opens[:, None], before, own)
    return tile


def _shifted(
    uvs: NDArray[np.float32], faces: NDArray[np.int32], corner: NDArray[np.int64]
) -> Layout:
    """A layout that lies in one other unit square, moved to 0..1, where textures repeat it."""
    moved = (np.nan_to_num(uvs).astype(np.float64) - corner).clip(0, 1).astype(np.float32)
    note = (
        f"The mesh's texture coordinates lie in one square away from 0..1 (from {corner[0]}, "
        f"{corner[1]}); the textures are made for 0..1, and repeated they fit."
    )
    return Layout(uvs=moved, uv_faces=faces, notes=(note,))


def _fault(given: Given, layout: Layout) -> str | None:
    """What is wrong with a layout within its tiles, or None."""
    count = len(layout.tiles)
    a, b, c = (layout.uvs[layout.uv_faces[:, k]].astype(np.float64) for k in range(3))
    (ax, ay), (bx, by) = (b - a).T, (c - a).T
    areas = 0.5 * np.abs(ax * by - ay * bx) * cells_along(count) ** 2
    if areas.sum() < _SMALLEST:
        return "its own cover next to nothing of a texture"
    tile = tile_of_faces(layout.uvs, layout.uv_faces, count)
    mesh = replace(plain_mesh(given.vertices, given.faces), uvs=layout.uvs)
    for index in range(max(1, count)):
        of_tile = tile == index
        area = areas[of_tile].sum()
        if area < _SMALLEST:
            continue
        uv_faces = layout.uv_faces[of_tile]
        if count:
            corners = layout.uvs[uv_faces].reshape(-1, 2)
            mesh = replace(mesh, uvs=within(corners, np.full(len(corners), index), count))
            uv_faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        face, _ = rasterise_atlas(replace(mesh, uv_faces=uv_faces), _ATLAS_SIDE)
        covered = float((face >= 0).mean())
        if covered < (1 - _OVERLAP) * area:
            place = f" in tile {layout.tiles[index]}" if count else ""
            return (
                f"{1 - covered / area:.0%} of its own overlap{place}, so that places share texels"
            )
    return None
