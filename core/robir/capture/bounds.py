# SPDX-License-Identifier: Apache-2.0
"""The object's bounding sphere from masks: the visual hull, carved coarse to fine.

The hull is every point that no mask calls background. Cells of a coarse grid are kept if a mask
is nearer to their projected centre than their projected half diagonal, so thin parts survive;
then only the outermost cells, which alone decide the sphere, are divided further. All of them are
where what lies outermost vanishes as it is divided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, View

Array = NDArray[np.float64]

GRID = 48  # cells along each side of the coarse grid
MARGIN = 1.02  # factor on the sphere's radius for what masks and poses do not know exactly
INSIDE = 64  # mask value from which a pixel counts as object; low, so that thin parts survive
_LEVELS = 3
_AGREEMENT = 0.9

_FINEST = 1e-9  # side of a cell, as a share of its distance from the origin, that numbers resolve


@dataclass(frozen=True, slots=True, kw_only=True)
class Silhouette:
    """A mask with its camera, as `kept` reads it."""

    camera: Camera
    distance: NDArray[np.float32]  # (H, W) pixels to the nearest object pixel, 0 on it
    is_open: tuple[bool, bool, bool, bool]  # cut off at the left, right, upper and lower border


@dataclass(frozen=True, kw_only=True)
class Hull:
    """The visual hull of the masks, by cells (N, 3) of half a side."""

    agreement: Array  # (V,) share of each mask that the hull covers, 1 where masks and poses agree
    strict: float  # median of the same if no mask may be wrong: near 1 only for the right poses
    silhouettes: Sequence[Silhouette]
    cells: Array
    half: float
    dissent: int  # masks that may call a cell background

    @cached_property
    def sphere(self) -> Bounds:
        """Its bounding sphere with margin, which costs as much as all else."""
        return _refined(self.silhouettes, self.cells, self.half, self.dissent)


def sphere_from_masks(views: Sequence[View], start: Bounds | None) -> Hull | None:
    """Bounding sphere of the visual hull of masks, looked for at `start` first; None if empty."""
    masks = [(view.camera, view.mask >= INSIDE) for view in views]
    silhouettes = [silhouette(camera, mask) for camera, mask in masks if mask.any()]
    if len(silhouettes) < 2:
        return None
    where = start or _first_guess(silhouettes)
    if where is None:
        return None
    limit = start if start is not None and start.is_limit else None
    budgets = sorted({0, 1, *(int(share * len(silhouettes)) for share in (0.05, 0.1))})
    best: Hull | None = None
    strict = 0.0
    for dissent in budgets:
        cells, half = _coarse(silhouettes, where, limit, dissent)
        if len(cells) == 0:
            continue
        agreement = _agreement(silhouettes, cells, half)
        share = float(np.median(agreement))
        strict = share if dissent == 0 else strict
        if best is None or share > np.median(best.agreement) + 0.02:
            best = Hull(
                agreement=agreement, strict=strict, silhouettes=silhouettes, cells=cells, half=half,
                dissent=dissent,
            )  # fmt: skip
        if share >= _AGREEMENT:
            break
    return best


def sphere_from_points(points: Array, views: Sequence[View]) -> Bounds | None:
    """Sphere about 98 % of the points (N, 3) that nine in ten masks contain; None below 20."""
    inside, seen = np.zeros(len(points)), np.zeros(len(points))
    for view in views:
        pixels, depth = view.camera.project(points)
        row, column = _indices(view.camera, pixels)
        seen += view.camera.in_photograph(pixels, depth)
        framed = view.camera.in_picture(pixels, depth)
        inside += framed & (view.mask[row, column] >= INSIDE)
    inner = points[(seen >= 2) & (inside >= 0.9 * seen)]
    if len(inner) < 20:
        return None
    centre = np.median(inner, axis=0)
    radius = float(np.quantile(np.linalg.norm(inner - centre, axis=1), 0.98))
    origin = f"{len(inner)} sparse points inside the masks"
    return Bounds(centre=centre, radius=1.3 * radius, origin=origin)


def enclosing_sphere(points: Array) -> tuple[Array, float]:
    """Centre (3,) and radius of the least sphere about points (N, 3) (Badoiu and Clarkson 2003)."""
    if len(points) > 16:
        # Flat sets have no hull; all their points will do.
        with suppress(QhullError):
            points = points[ConvexHull(points).vertices]
    centre = points.mean(axis=0)
    for step in range(1, 1001):
        farthest = points[np.argmax(((points - centre) ** 2).sum(axis=1))]
        centre = centre + (farthest - centre) / (step + 1)
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def silhouette(camera: Camera, mask: NDArray[np.bool_]) -> Silhouette:
    """Of a mask (H, W) that is not empty."""
    distance = np.asarray(ndimage.distance_transform_edt(~mask), dtype=np.float32)
    on = distance == 0
    sides = (on[:, 0], on[:, -1], on[0], on[-1])
    left, right, top, bottom = (bool(side.any()) for side in sides)
    return Silhouette(camera=camera, distance=distance, is_open=(left, right, top, bottom))


def _first_guess(silhouettes: Sequence[Silhouette]) -> Bounds | None:
    """The point nearest to the rays through the masks' centres, and a generous radius."""
    system, right = np.zeros((3, 3)), np.zeros(3)
    for silhouette in silhouettes:
        rows, columns = np.nonzero(silhouette.distance == 0)
        middle = np.array([[columns.mean() + 0.5, rows.mean() + 0.5]])
        origin, direction = silhouette.camera.rays(middle)
        across = np.eye(3) - np.outer(direction[0], direction[0])
        system += across
        right += across @ origin[0]
    if np.linalg.cond(system) > 1e6:
        return None
    centre = np.linalg.solve(system, right)
    radii = []
    for silhouette in silhouettes:
        rows, columns = np.nonzero(silhouette.distance == 0)
        pixel, depth = silhouette.camera.project(centre[None])
        offset = np.hypot(columns + 0.5 - pixel[0, 0], rows + 0.5 - pixel[0, 1]).max()
        focal = min(silhouette.camera.fx, silhouette.camera.fy)
        if depth[0] > 0:
            radii.append(offset / focal * depth[0])
    if not radii:
        return None
    return Bounds(centre=centre, radius=1.2 * float(np.median(radii)), origin="")


def _coarse(
    silhouettes: Sequence[Silhouette], where: Bounds, limit: Bounds | None, dissent: int
) -> tuple[Array, float]:
    """Kept cells (N, 3) of a coarse grid that grows and shrinks onto the hull, and half a side."""
    centre, reach = where.centre, where.radius
    cells, half = _carved_cube(silhouettes, centre, reach, dissent)
    if limit is not None:
        cells = _within(cells, half, limit)
    else:
        for _ in range(3):
            if len(cells) == 0 or np.abs(cells - centre).max() < reach - 1.5 * half:
                break
            reach *= 1.6
            cells, half = _carved_cube(silhouettes, centre, reach, dissent)
    if len(cells) == 0:
        return cells, half
    middle = 0.5 * (cells.min(axis=0) + cells.max(axis=0))
    reach = float(np.abs(cells - middle).max()) + 2 * half
    cells, half = _carved_cube(silhouettes, middle, reach, dissent)
    return _within(cells, half, limit), half


def _carved_cube(
    silhouettes: Sequence[Silhouette], centre: Array, reach: float, dissent: int
) -> tuple[Array, float]:
    half = reach / GRID
    ticks = np.linspace(-reach + half, reach - half, GRID)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = grid + centre
    return cells[kept(silhouettes, cells, half, dissent)], half


def _within(cells: Array, half: float, limit: Bounds | None) -> Array:
    if limit is None:
        return cells
    return cells[np.linalg.norm(cells - limit.centre, axis=1) <= limit.radius + half]


def kept(
    silhouettes: Sequence[Silhouette], cells: Array, half: float, dissent: int
) -> NDArray[np.bool_]:
    """Which cells at most `dissent` masks call background and a quarter of the views see."""
    alive, points = np.arange(len(cells)), cells
    against = np.zeros(len(cells), dtype=np.int32)
    seen = np.zeros(len(cells), dtype=np.int32)
    for silhouette in silhouettes:
        known, beyond = _verdict(silhouette, points, np.sqrt(3.0) * half)
        seen[alive] += known
        against[alive] += known & beyond
        stays = against[alive] <= dissent
        alive, points = alive[stays], points[stays]
    # Cells that few views see may have proportionally few masks against them.
    fair = against[alive] * len(silhouettes) <= dissent * seen[alive]
    result = np.zeros(len(cells), dtype=bool)
    result[alive] = fair & (seen[alive] >= max(2, len(silhouettes) // 4))
    return result


def _verdict(
    silhouette: Silhouette, points: Array, reach: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether a view can judge points, and whether it calls all within `reach` background."""
    camera = silhouette.camera
    pixels, depth = camera.project(points)
    row, column = _indices(camera, pixels)
    x, y = pixels.T
    over = (-x, x - camera.width, -y, y - camera.height)  # pixels beyond each border
    known = np.full(len(points), True)
    for beyond, is_open in zip(over, silhouette.is_open, strict=True):
        if is_open:
            known &= (beyond <= 0) & (depth > 0)
    farthest = np.maximum(np.maximum(over[0], over[1]), np.maximum(over[2], over[3]))
    distance = np.fmax(silhouette.distance[row, column], farthest)
    slack = reach * max(camera.fx, camera.fy) / np.maximum(depth, 1e-12)
    return known, (depth <= 0) | (distance > np.maximum(slack, 0.75))


def _indices(camera: Camera, pixels: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the pixel nearest to image points."""
    column = np.clip(pixels[:, 0], 0.5, camera.width - 0.5).astype(np.int64)
    row = np.clip(pixels[:, 1], 0.5, camera.height - 0.5).astype(np.int64)
    return row, column


def _agreement(silhouettes: Sequence[Silhouette], cells: Array, half: float) -> Array:
    """Share of each mask's pixels whose rays meet a kept cell, (V,)."""
    shares = []
    for one in silhouettes:
        inside = one.distance == 0
        shares.append(float((shown(one.camera, cells, half) & inside).sum() / inside.sum()))
    return np.array(shares)


def shown(camera: Camera, cells: Array, half: float) -> NDArray[np.bool_]:
    """Pixels (H, W) whose rays meet cells (N, 3) of half a side; each fills a disc."""
    pixels, depth = camera.project(cells)
    row, column = _indices(camera, pixels)
    visible = camera.in_picture(pixels, depth)
    empty = np.ones((camera.height, camera.width), dtype=bool)
    if not visible.any():
        return ~empty
    empty[row[visible], column[visible]] = False
    reach = np.sqrt(3.0) * half * max(camera.fx, camera.fy) / np.median(depth[visible])
    return np.asarray(ndimage.distance_transform_edt(empty)) <= max(float(reach), 1.0)


def _refined(silhouettes: Sequence[Silhouette], cells: Array, half: float, dissent: int) -> Bounds:
    """Bounding sphere of the hull after dividing its cells, of half a side, `_LEVELS` times."""
    found = enclosing(partial(kept, silhouettes, dissent=dissent), cells, half)
    radius = MARGIN * (found.radius + float(np.sqrt(3.0)) * found.half)
    origin = f"visual hull of {len(silhouettes)} masks"
    return Bounds(centre=found.centre, radius=radius, origin=origin)


class Enclosed(NamedTuple):
    """The sphere about cells of half a side."""

    centre: Array
    radius: float
    half: float


Carved = Callable[[Array, float], NDArray[np.bool_]]


def enclosing(carved: Carved, cells: Array, half: float) -> Enclosed:
    """Sphere about what is `carved` of cells (N, 3), of half a side, divided `_LEVELS` times."""
    tries = (_divided(carved, cells, half, whole) for whole in range(_LEVELS + 1))
    return next(found for found in tries if found is not None)


def _divided(carved: Carved, cells: Array, half: float, whole: int) -> Enclosed | None:
    """Sphere about cells (N, 3), all divided in the first `whole` turns, then the outermost.

    These decide it while it shrinks by the diagonal of a cell at most; None where it shrinks by
    more, as thin parts vanish at once.
    """
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    centre, radius = enclosing_sphere(cells)
    for level in range(_LEVELS):
        if half <= _FINEST * np.abs(centre).max():
            break  # cells that coincide as numbers have no hull, and eight times as many each time
        diagonal, least = 2 * np.sqrt(3.0) * half, 0.0
        if level >= whole:
            least = radius - diagonal
            cells = cells[np.linalg.norm(cells - centre, axis=1) >= least - diagonal]
        half = 0.5 * half
        children = (cells[:, None, :] + half * corners).reshape(-1, 3)
        children = children[carved(children, half)]
        if len(children) == 0:
            return None if level >= whole else Enclosed(centre, radius, half)
        cells = children
        centre, radius = enclosing_sphere(cells)
        if radius < least:
            return None
    return Enclosed(centre, radius, half)
