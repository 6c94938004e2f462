# SPDX-License-Identifier: Apache-2.0
"""Depth maps that agree, fused into signed distances with how much they are to be trusted.

Curless and Levoy 1996, "A volumetric method for building complex models from range images", with
the correlation of the photographs as weight; a depth counts if other maps have it too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool3d, interpolate, pad

from robir.capture.camera import Camera
from robir.geometry.hull import mask_distance
from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import ReducedPhoto
from robir.geometry.stereo.sweep import DepthMap, StereoPicture, sweep
from robir.maths.vectors import farthest_points
from robir.workers import side_by_side

_COARSEST = 12  # nodes along a side below which a grid is not halved any more
# of conjugate gradients on each grid; each begins with the solution on half of its nodes
_ITERATIONS = 60


def laplacian(grid: Tensor) -> Tensor:
    """Second differences of (X, Y, Z), in units of cells; nothing leaves through the border."""
    total = torch.zeros_like(grid)
    for axis in range(3):
        step = grid.diff(dim=axis)
        total.narrow(axis, 0, step.shape[axis]).add_(step)
        total.narrow(axis, 1, step.shape[axis]).sub_(step)
    return total


def smoothest(measured: Tensor, weight: Tensor, smoothness: float) -> Tensor:
    """Grid with the least sum of weight (f - measured)^2 + smoothness (laplacian f)^2.

    The smoothing spline of Duchon 1977, "Splines minimizing rotation-invariant semi-norms in
    Sobolev spaces", on a grid: sharp where it was measured, smooth elsewhere.
    """
    if min(measured.shape) <= _COARSEST:
        return _solved((measured, weight), measured, smoothness, _ITERATIONS)
    # a cell of half the grid holds eight nodes, and twice the step is a sixteenth of the bending
    total = _halved(weight)
    mean = _halved(weight * measured) / total
    coarse = smoothest(mean, 8 * total, 8 / 16 * smoothness)
    finer = interpolate(coarse[None, None], scale_factor=2, mode="trilinear", align_corners=False)[
        0, 0
    ]
    width, height, depth = measured.shape
    start = finer[:width, :height, :depth]
    return _solved((measured, weight), start, smoothness, _ITERATIONS)


def _halved(grid: Tensor) -> Tensor:
    """Means of eight nodes each; an odd last one counts twice."""
    odd = [part for side in reversed(grid.shape) for part in (0, side % 2)]
    return avg_pool3d(pad(grid[None, None], odd, mode="replicate"), 2)[0, 0]


def _solved(
    known: tuple[Tensor, Tensor], start: Tensor, smoothness: float, iterations: int
) -> Tensor:
    """The minimum by conjugate gradients, of what was measured and its weight."""
    measured, weight = known

    def apply(grid: Tensor) -> Tensor:
        return weight * grid + smoothness * laplacian(laplacian(grid))

    inverse = 1 / (weight + 42 * smoothness)  # the diagonal away from the border
    found = start.clone()
    rest = weight * measured - apply(found)
    step = inverse * rest
    direction, before = step.clone(), (rest * step).sum()
    for _ in range(iterations):
        applied = apply(direction)
        share = before / (direction * applied).sum().clamp(min=1e-20)
        found += share * direction
        rest -= share * applied
        step = inverse * rest
        now = (rest * step).sum()
        direction = step + now / before.clamp(min=1e-20) * direction
        before = now
    return found


_NARROW = 1 / 3  # spread of angles below the wanted one that will do, as a share of it
_WIDE = 5 / 6  # the same above it
_APART = 0.5  # angle between two sources at which they count as two, as a share of the wanted one
_LEAST_SCORE = 0.02  # sources that fit less are left out
_SOURCES = 4  # photographs that each is compared with
# angle at the object between a photograph and those it is compared with: less says little about
# depth, more changes what is seen
_BASELINE_DEGREES = 14.0
# angle at the object up to which another photograph's depths can confirm or deny one (degrees)
_CONFIRMING_DEGREES = 40.0
_VIEWS = 48  # most photographs that get a depth map
_AT_ONCE = 8  # of these at most: each takes some hundred megabytes meanwhile
_LEAST_AGREEING = 3  # other depth maps that must agree with a depth
_LEAST_CORRELATION = 0.4  # correlation that a depth must reach
# difference of depth that counts as agreement, and the half width of the band in which distances
# are fused, cells of the fused lattice each
TOLERANCE = (0.75, 4.0)
# share of the band's half width from which a distance says that a node is free, not how far
_FREE = 0.98
_DEEP = 2.0  # distance to the hull beyond which it says no more than inside or outside (bands)
_OUTSIDE = 1.0  # weight of the visual hull where it says that there is nothing
_CELLS = 128  # cells of the fused lattice along the object's longest side
_LEAST_TRUST = 2.0  # sum of the maps' trust below which a distance counts as unknown
_ANCHOR = 1e-5  # weight of the visual hull's distance inside it, where that is unknown
_SMOOTHNESS = 1.0  # weight of the squared Laplacian of the distances, against a trust of 1
_MASK_ROUNDS = 3  # how often depths are taken back that leave nothing where a mask shows the object
WELL_INSIDE = 2.0  # pixels from the outline beyond which a mask is believed
_AROUND = 2  # nodes about those of such a ray whose depths are taken back as well
# share of a mask's pixels that miss the surface from which it has a hole: polished things have 5 %
# and more, what is hidden at the rims of others comes to 2.5 %
_HOLE = 0.035
_RIM = 2.0  # distance from the surface beyond which a ray passes no rim of it (cells)
_RAYS = 2048  # rays at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class Fused:
    """What depth maps say of the distance to the surface at the nodes of a lattice."""

    distance: Tensor  # (N,) mean signed distance, unit frame, cut off at the band
    weight: Tensor  # (N,) sum of the maps' trust
    band: float  # half width of the band


def stereo_surface(photos: list[ReducedPhoto], hull: Sampled, coarseness: float = 1.0) -> Sampled:
    """The surface that depth maps agree on, and the visual hull where they say nothing.

    Less trust than chance and highlights get counts as none. A plain part then lies where its
    outlines put it, bent no more than what is known around it asks. `coarseness` is the share of a
    final surface's cells along a side.
    """
    return next(stereo_surfaces(photos, hull, coarseness))


def stereo_surfaces(
    photos: list[ReducedPhoto],
    hull: Sampled,
    coarseness: float = 1.0,
    within: float = WELL_INSIDE,
) -> Iterator[Sampled]:
    """That surface, and then the one that holds the masks, which may be the same.

    To the second, depths that leave nothing where a mask shows the object are wrong, as where it
    mirrors. `within` is how far from its outline a mask is believed (pixels).
    """
    lattice, outer = hull
    lower, upper = np.asarray(lattice.lower) + 3 * lattice.cell, lattice.upper - 3 * lattice.cell
    fine = Lattice.around(lower, upper, round(coarseness * _CELLS))
    maps = depth_maps(photos, extract(lattice, outer))
    kept = confirmed(maps, TOLERANCE[0] * fine.cell)
    wide = resample(outer, lattice, fine)
    fused = fuse(kept, fine, wide)
    reach = _DEEP * fused.band
    limit = wide.clamp(-reach, reach)
    is_free = fused.distance > _FREE * fused.band
    told = torch.where(is_free, torch.maximum(fused.distance, limit), fused.distance)
    weight = (fused.weight - _LEAST_TRUST).clamp(min=0)
    prior = _ANCHOR + _OUTSIDE * (wide > 0)

    def solved(weight: Tensor) -> Sampled:
        total = weight + prior
        measured = (weight * told + prior * limit) / total
        found = smoothest(measured.view(fine.shape), total.view(fine.shape), _SMOOTHNESS)
        return Sampled(fine, found.reshape(-1))

    surface = solved(weight)
    yield surface
    for _ in range(_MASK_ROUNDS):
        wrong = carved_in_vain(surface, photos, wide, within)
        if not (weight[wrong] > 0).any():
            break
        weight = weight.masked_fill(wrong, 0.0)
        surface = solved(weight)
    yield surface


def carved_in_vain(
    surface: Sampled, photos: list[ReducedPhoto], hull: Tensor, within: float = WELL_INSIDE
) -> Tensor:
    """Nodes (N,) bool of the hull (N,) whose depths leave rays well inside a mask without surface.

    All along such rays where a mask shows a hole. Elsewhere a rim or a corner lacks, and whole rays
    would fill what lies in front of it, so it is what is nearest to being inside.
    """
    lattice, values = surface
    mesh = extract(*surface)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    marked = torch.zeros(lattice.count, dtype=torch.bool)
    positions = np.stack([photo.camera.position for photo in photos])
    for photo in (photos[own] for own in farthest_points(positions, _VIEWS)):
        rows, columns = np.nonzero(mask_distance(photo.coverage) < -within)
        if not len(rows):
            continue
        pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
        origins, directions = photo.camera.rays(pixels)
        hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        missed = ~np.isfinite(hits.distance)
        starts, slopes = (torch.from_numpy(part[missed]).float() for part in (origins, directions))
        met, whole, nearest = 0, [], []
        for part in zip(starts.split(_RAYS), slopes.split(_RAYS), strict=True):
            nodes = lattice.along(*part, 0.7 * lattice.cell)
            held = hull[nodes] < 0.5 * lattice.cell
            least = values[nodes].masked_fill(~held, torch.inf).amin(dim=1, keepdim=True)
            met += int(held.any(dim=1).sum())
            whole.append(nodes[held])
            near = held & (values[nodes] <= least + lattice.cell) & (least < _RIM * lattice.cell)
            nearest.append(nodes[near])
        for nodes in whole if met > _HOLE * len(rows) else nearest:
            marked[nodes] = True
    return lattice.dilated(marked, _AROUND)


def depth_maps(photos: list[ReducedPhoto], hull: Mesh) -> list[DepthMap]:
    """Depth maps of photographs far from each other that have two others at a good angle."""
    pictures = [StereoPicture.of(photo) for photo in photos]
    positions = np.stack([photo.camera.position for photo in photos])
    sources = choose_sources(positions)
    tracer = EmbreeTracer(hull.vertices, hull.faces)

    def depths(own: int) -> DepthMap | None:
        picture, camera = pictures[own], pictures[own].camera
        entry = entry_depth(tracer, camera)
        if len(sources[own]) < 2 or not (picture.whole & np.isfinite(entry)).any():
            return None
        far = float(((hull.vertices - camera.position) @ camera.forward).max())
        return sweep(picture, [pictures[k] for k in sources[own]], entry, far)

    maps = side_by_side(depths, farthest_points(positions, _VIEWS), _AT_ONCE)
    return [one for one in maps if one is not None]


def entry_depth(tracer: EmbreeTracer, camera: Camera) -> NDArray[np.float32]:
    """Depth (H, W) at which a camera's rays meet a mesh; infinite where they do not."""
    origins, directions = camera.rays(camera.pixel_centres())
    hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    depth = hits.distance * (directions @ camera.forward)
    return depth.reshape(camera.height, camera.width).astype(np.float32)


def confirmed(maps: list[DepthMap], tolerance: float) -> list[DepthMap]:
    """The maps without depths that too few others have, or that photographs hardly agree on."""
    if not maps:
        return []
    angle = angles_between(np.stack([one.camera.position for one in maps]))

    def agreed(own: int) -> DepthMap:
        one = maps[own]
        rows, columns = np.nonzero(one.correlation > _LEAST_CORRELATION)
        points = points_at(one, rows, columns)
        votes = np.zeros(len(points), int)
        for other in np.flatnonzero((angle[own] < _CONFIRMING_DEGREES) & (angle[own] > 0)):
            depth, seen = _looked_up(maps[other], points)
            votes += np.abs(depth - seen) < tolerance
        depth = np.full_like(one.depth, np.nan)
        good = votes >= _LEAST_AGREEING
        depth[rows[good], columns[good]] = one.depth[rows[good], columns[good]]
        return replace(one, depth=depth)

    return side_by_side(agreed, range(len(maps)))


def points_at(
    one: DepthMap, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Surface points (P, 3), unit frame, that pixels of a map show."""
    camera = one.camera
    depth = one.depth[rows, columns].astype(np.float64)
    x = (columns + 0.5 - camera.cx) / camera.fx
    y = -(rows + 0.5 - camera.cy) / camera.fy
    local = np.stack([x, y, -np.ones_like(x)], axis=1) * depth[:, None]
    return local @ camera.camera_to_world[:3, :3].T + camera.position


def _looked_up(
    one: DepthMap, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depths (P,) of points in a map's camera, and those the map has there, NaN where none."""
    places, depth = one.camera.project(points)
    pixel = np.floor(places).astype(np.int64)
    size = (one.camera.width, one.camera.height)
    held = (depth > 0) & (pixel >= 0).all(1) & (pixel < size).all(1)
    seen = np.full(len(points), np.nan)
    seen[held] = one.depth[pixel[held, 1], pixel[held, 0]]
    return depth, seen


def fuse(maps: list[DepthMap], lattice: Lattice, hull: Tensor) -> Fused:
    """Mean signed distance of the nodes inside the visual hull (N,), by all maps."""
    band = TOLERANCE[1] * lattice.cell
    rows = (hull < lattice.cell).nonzero()[:, 0].numpy()
    points = lattice.nodes()[rows].double().numpy()
    total, weight = np.zeros(len(rows)), np.zeros(len(rows))
    for one in maps:
        places, depth = one.camera.project(points)
        pixel = np.floor(places).astype(np.int64)
        held = (depth > 0) & (pixel >= 0).all(1)
        held &= (pixel < (one.camera.width, one.camera.height)).all(1)
        near = np.flatnonzero(held)
        column, row = pixel[near].T
        before = one.depth[row, column] - depth[near]
        known = before > -band  # NaN is not
        near, before = near[known], before[known].clip(max=band)
        trust = one.trust[row, column][known]
        total[near] += trust * before
        weight[near] += trust
    distance, weights = torch.zeros(lattice.count), torch.zeros(lattice.count)
    distance[rows] = torch.from_numpy(total / np.maximum(weight, 1e-9)).float()
    weights[rows] = torch.from_numpy(weight).float()
    return Fused(distance=distance, weight=weights, band=band)


def angles_between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (V, V), degrees, between camera centres (V, 3) as seen from the origin."""
    towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)))


def choose_sources(positions: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """For each photograph, others at a good angle that lie on different sides of it, best first."""
    angle = angles_between(positions)
    spread = np.where(angle < _BASELINE_DEGREES, _NARROW, _WIDE) * _BASELINE_DEGREES
    fits = np.exp(-(((angle - _BASELINE_DEGREES) / spread) ** 2))
    np.fill_diagonal(fits, 0.0)
    chosen = []
    for own in fits:
        score, picked = own.copy(), []
        while len(picked) < _SOURCES and score.max() > _LEAST_SCORE:
            best = int(score.argmax())
            picked.append(best)
            score *= 1.0 - np.exp(-((angle[best] / (_APART * _BASELINE_DEGREES)) ** 2))
        chosen.append(np.array(picked, np.int64))
    return chosen
