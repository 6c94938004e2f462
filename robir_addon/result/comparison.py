# SPDX-License-Identifier: GPL-3.0-or-later
"""One view of a result as four pictures side by side: photograph, re-render, albedo, roughness."""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..errors import ResultError
from ..gateway import JobPaths, of_tile
from .glb import GlbMesh, corners_of, read_glb
from .pictures import read_codes

MAX_SIDE = 1000  # longer side of one picture, pixels
_TRACED_SIDE = 400  # the same of what the textures show, where a ray is traced for each pixel
_MARGIN = 0.04
_GAP = 0.02


# what reading a damaged file of arrays raises
_DAMAGE = (OSError, ValueError, LookupError, EOFError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class Comparison:
    """Pictures of one view."""

    view: str  # its name
    rendered_by: str  # "Cycles" or "RobIR", whichever made the re-render
    pictures: tuple[np.ndarray, ...]  # (H, W, 4) each, row 0 at the bottom

    @property
    def codes(self) -> np.ndarray:
        """(H, V, 4) all four beside each other."""
        height, width = self.pictures[0].shape[:2]
        gap = np.zeros((height, max(1, round(_GAP * width)), 4))
        beside = [part for picture in self.pictures for part in (gap, picture)][1:]
        return np.concatenate(beside, axis=1)

    def wiped(self, other: int, share: float) -> np.ndarray:
        """(H, W, 4) the photograph up to a share of the width, there another of the pictures."""
        photograph, over = self.pictures[0], self.pictures[other].copy()
        edge = round(share * over.shape[1])
        over[:, :edge] = photograph[:, :edge]
        over[:, max(0, edge - 1) : edge] = 1.0
        return over


@dataclass(frozen=True)
class RenderedView:
    """A view of the capture that was rendered again."""

    entry: dict[str, Any]  # the view in cameras.json
    rendered_by: str  # "Cycles" or "RobIR"
    picture: np.ndarray  # (H, W, 4) codes, row 0 at the bottom


def rendered_view(paths: JobPaths, table: dict[str, Any], view: str = "") -> RenderedView:
    """The re-render of a view ("": the first there is), by Cycles, else by the solver."""
    own, cycles = _own_renders(paths), _cycles_renders(paths)
    views = {entry["name"]: entry for entry in table["views"]}
    rendered = [name for there in (cycles, own) for name in views if name in there]
    chosen = view or next(iter(rendered), "")
    if chosen not in rendered:
        known = ", ".join(sorted(set(rendered))) or "none"
        raise ResultError(
            "view {view!r} was not rendered again; choose one of: {known}", view=chosen, known=known
        )
    if chosen in cycles:
        return RenderedView(views[chosen], "Cycles", read_codes(cycles[chosen]))
    return RenderedView(views[chosen], "RobIR", own[chosen])


def neighbour(paths: JobPaths, table: dict[str, Any], view: str, step: int) -> str:
    """The view some steps farther among those that were rendered again, round and round."""
    views = [entry["name"] for entry in table["views"]]
    rendered = {**_own_renders(paths), **_cycles_renders(paths)}
    known = [name for name in views if name in rendered]
    return known[(known.index(view) + step) % len(known)] if view in known else view


def compare(paths: JobPaths, table: dict[str, Any], view: str = "") -> Comparison:
    """Put the pictures of a view ("": the first) beside each other, cut to the object."""
    again = rendered_view(paths, table, view)
    entry = again.entry
    longer = max(entry["width"], entry["height"])
    # small photographs are shown in whole multiples, so that the textures show more than they do
    scale = min(1.0, MAX_SIDE / longer) if longer > _TRACED_SIDE else _TRACED_SIDE // longer
    size = (max(1, round(entry["width"] * scale)), max(1, round(entry["height"] * scale)))
    few = min(1.0, _TRACED_SIDE / max(size))
    traced = (max(1, round(few * size[0])), max(1, round(few * size[1])))
    photo = read_codes(paths.cameras.parent / entry["image"])
    textures = [_scaled(picture, size) for picture in _seen_textures(paths, entry, traced)]
    pictures = _cut([_scaled(photo, size), _scaled(again.picture, size), *textures])
    return Comparison(entry["name"], again.rendered_by, tuple(pictures))


def _cycles_renders(paths: JobPaths) -> dict[str, Path]:
    prefix = "rerender_"
    files = sorted(paths.renders.glob(f"{prefix}*.png"))
    return {file.stem.removeprefix(prefix): file for file in files}


def _own_renders(paths: JobPaths) -> dict[str, np.ndarray]:
    """The solver's own pictures by view, codes 0..1, row 0 at the bottom."""
    file = paths.stage("appearance") / "held_out.npz"
    if not file.is_file():
        return {}
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return {name: _with_alpha(arrays[name][::-1] / 255.0) for name in arrays.files}
    except _DAMAGE as fault:
        raise ResultError(
            "{file} is damaged ({fault}); reconstruct again", file=file, fault=fault
        ) from fault


def _with_alpha(codes: np.ndarray) -> np.ndarray:
    if codes.shape[-1] == 4:
        return codes
    return np.concatenate([codes, np.ones((*codes.shape[:2], 1))], axis=-1)


def _scaled(codes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A picture at another size: nearest pixels where it grows, means of them where it shrinks."""
    for axis, wanted in ((0, size[1]), (1, size[0])):
        have = codes.shape[axis]
        if wanted < have:
            first = np.arange(wanted) * have // wanted
            shape = [-1 if a == axis else 1 for a in range(codes.ndim)]
            counts = np.diff(np.append(first, have)).reshape(shape)
            codes = np.add.reduceat(codes, first, axis=axis) / counts
        else:
            codes = codes.take(np.arange(wanted) * have // wanted, axis=axis)
    return codes


def _seen_textures(
    paths: JobPaths, view: dict[str, Any], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and roughness as the view's camera sees them, without light."""
    uv, tile, hit = _surface_seen(read_glb(paths.asset), view, size)
    pictures = []
    for name in ("albedo", "roughness"):
        colours = np.zeros((len(uv), 4))
        for number in np.unique(tile).tolist():
            texture = read_codes(of_tile(paths.textures / f"{name}.png", number or None))
            side, chosen = np.array(texture.shape[1::-1]), tile == number
            column, row = np.clip((uv[chosen] * side).astype(int), 0, side - 1).T
            colours[chosen] = texture[row, column]
        seen = np.zeros((size[1], size[0], 4))
        seen[hit] = colours
        seen[..., 3] = hit
        pictures.append(seen)
    return pictures[0], pictures[1]


def _surface_seen(
    mesh: GlbMesh, view: dict[str, Any], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the M pixels that see the surface see of its texture, and which (H, W) these are.

    First places (M, 2) in 0..1 within a tile, then the tile's number (M,), 0 where there are none.
    One ray through the middle of each pixel, row 0 at the bottom.
    """
    tree = BVHTree.FromPolygons(mesh.vertices.tolist(), mesh.faces.tolist(), all_triangles=True)
    pose = np.array(view["camera_to_world"])
    columns = (np.arange(size[0]) + 0.5) / size[0] * view["width"]
    rows = (1.0 - (np.arange(size[1]) + 0.5) / size[1]) * view["height"]
    x, y = np.meshgrid((columns - view["cx"]) / view["fx"], (view["cy"] - rows) / view["fy"])
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T
    origin = Vector(pose[:3, 3])
    found = [tree.ray_cast(origin, Vector(ray)) for ray in rays.tolist()]
    hit = np.array([index is not None for _, _, index, _ in found], bool)
    points = np.array([place[:] for place, _, index, _ in found if index is not None])
    face = np.array([index for _, _, index, _ in found if index is not None], int)
    if len(face) == 0:
        return np.zeros((0, 2)), np.zeros(0, int), hit.reshape(size[1], size[0])
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    whole = np.maximum((normal**2).sum(axis=-1), 1e-30)
    share_b = (np.cross(c - a, a - points) * normal).sum(axis=-1) / whole
    share_c = (np.cross(a - b, b - points) * normal).sum(axis=-1) / whole
    shares = np.stack([1.0 - share_b - share_c, share_b, share_c], axis=-1)
    uv = (shares[..., None] * mesh.corner_uvs[face]).sum(axis=1)
    tile = mesh.tiles[face]
    return uv - corners_of(tile), tile, hit.reshape(size[1], size[0])


def _cut(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """The part of all pictures that holds the object in the first or the last, with a margin.

    The re-render may lack an outline of its own.
    """
    seen = np.any([picture[..., 3] > 0.0 for picture in (pictures[0], pictures[-1])], axis=0)
    if not seen.any():
        return pictures
    rows, columns = np.nonzero(seen.any(axis=1))[0], np.nonzero(seen.any(axis=0))[0]
    margin = max(1, round(_MARGIN * max(seen.shape)))
    low = max(0, rows[0] - margin), max(0, columns[0] - margin)
    high = rows[-1] + 1 + margin, columns[-1] + 1 + margin
    return [picture[low[0] : high[0], low[1] : high[1]] for picture in pictures]
