# SPDX-License-Identifier: Apache-2.0
"""The support plane: flat ground that the masks show by its rim.

Seen from above only, flat ground has a visual hull that bulges like a lens: no mask can tell. Its
rim can: every ray through a mask's outline touches the surface, and where the rest of the hull
leaves little of such a ray, the touching point is known. The rim of a flat ground puts many of
these points into one plane, all around the object. What the hull of that plane's outline alone
would bulge to is then no evidence of anything standing there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import ConvexHull, QhullError
from skimage.draw import polygon2mask
from skimage.measure import find_contours
from torch import Tensor

from robir.capture.camera import Camera
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.rays import ReducedPhoto
from robir.maths.vectors import tangents

Array = NDArray[np.float64]


_CONTOUR_POINTS = 120  # outline points used of a photograph
_RAY_STEPS = 240  # steps along an outline point's ray through the bounding sphere
# how much deeper than the deepest point of such a ray another may lie to belong to the stretch
# that touches (cells)
_NEAR_HULL = 0.6
# length of that stretch up to which its middle is a touching point (unit frame)
_LONGEST_STRETCH = 0.12
_LEAST_TOUCHING = 100  # touching points that a plane is looked for among
_LEAST_AGREEING = 60  # points that must lie in a plane
_LEAST_UPPER = 30  # points of its upper edge from which it is fitted to that
_THICKEST = 4.0  # height up to which the upper edge is looked for above the lower one (cells)
_TRIALS = 600  # planes through three points that are tried
_TOLERANCE = 0.5  # distance from a plane up to which points speak for it (cells)
_LEAST_IN_FRONT = 0.9  # share of the cameras that must be on the plane's one side
# part of an outline's normal along the plane's, above which the outline is that of the upper edge
_LEAST_UPWARD = 0.5
_FIT_WIDTH = 0.4  # distance from the upper edge at which a point counts as stray (cells)
_FIT_ROUNDS = 10  # solutions, each with the weights by the one before
_RIM_WIDTH = 1.2  # distance from the plane up to which points belong to its outline (cells)
_WIDEST_GAP = 60.0  # angle about the middle that the rim may leave open (degrees)
# of the hull that must stand on the outline, and of the outline's pictures that the masks must
# hold
_LEAST_SHARE = 0.97
_OUTLINE_GROWTH = 1.04  # size, against the outline, of what the hull must stand on
# points between which the edge's distance from the middle is linear in the angle about it
_KNOTS = 36
_STIFFNESS = 0.3  # weight of the difference between neighbouring knots against one ray
# upward part of an outline's outward normal; upright things and near edges, below which the
# ground shows its side, have less
_LEAST_RISE = 0.3
_LEAST_FALL = 0.05  # downward part of a ray's direction; flatter ones meet the plane anywhere
# cosine between an outline's normal, within the plane, and the direction from the middle;
# outlines of what stands before the edge run across it
_LEAST_ALONG = 0.9
_EDGE_ROUNDS = 10  # linear solutions
_WIDE_ROUNDS = 3  # how many of them take rays at the full width
_NARROWING = 0.35  # share of the width at which a ray counts as stray in the others
_RAYS_A_KNOT = 5  # rays that must agree on the edge, for each knot


@dataclass(frozen=True, slots=True, kw_only=True)
class SupportPlane:
    """Flat ground, unit frame."""

    origin: Array  # (3,) point on the plane, the middle of the outline
    axes: Array  # (3, 3) rows: two directions within the plane, then the normal towards the cameras
    outline: Array  # (K, 2) convex outline, counter-clockwise, coordinates along the first two axes

    def local(self, points: Array) -> Array:
        """Coordinates of points (..., 3): two within the plane and the height above it."""
        return (points - self.origin) @ self.axes.T

    def world(self, local: Array) -> Array:
        """Inverse of `local`."""
        return local @ self.axes + self.origin


class OutlineRays(NamedTuple):
    """Rays through the outlines of masks, unit frame."""

    origins: Array  # (P, 3)
    directions: Array  # (P, 3) unit
    outward: Array  # (P, 3) unit, across the ray and out of the mask: the normal of what it touches


def _outline_rays(photo: ReducedPhoto) -> OutlineRays:
    """Rays through a mask's outline."""
    curves = [c for c in find_contours(np.pad(photo.coverage, 1), 0.5) if len(c) > 12]
    if not curves:
        return OutlineRays(*np.zeros((3, 0, 3)))
    image = np.concatenate(curves)[:, ::-1] - 0.5
    tangent = [np.roll(curve, -3, axis=0) - np.roll(curve, 3, axis=0) for curve in curves]
    tangent = np.concatenate(tangent)[:, ::-1]
    height, width = photo.coverage.shape
    inner = ((image >= 1.5) & (image <= [width - 1.5, height - 1.5])).all(1)
    every = max(1, inner.sum() // _CONTOUR_POINTS)
    image, tangent = image[inner][::every], tangent[inner][::every]
    # outwards is across the tangent, to the side where the coverage falls
    across = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    probe = (image + 1.5 * across)[:, ::-1] - 0.5
    falls = map_coordinates(photo.coverage, probe.T, order=1, mode="constant") < 0.5
    across = np.where(falls[:, None], across, -across)
    origins, directions = photo.camera.rays(image)
    _, aside = photo.camera.rays(np.asarray(image + across, np.float64))
    outward = aside - directions * (aside * directions).sum(1, keepdims=True)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    return OutlineRays(np.broadcast_to(origins, directions.shape), directions, outward)


def touching_points(
    rays: OutlineRays, lattice: Lattice, hull: Tensor
) -> tuple[Array, NDArray[np.int64]]:
    """Surface points (P, 3) that the outlines pin down, and the rays (P,) that they lie on."""
    origins, directions = rays.origins, rays.directions
    if len(origins) == 0:
        return origins, np.zeros(0, np.int64)
    middle = -(origins * directions).sum(1)
    steps = np.linspace(-1.1, 1.1, _RAY_STEPS)
    distance = middle[:, None] + steps
    points = origins[:, None] + distance[..., None] * directions[:, None]
    flat = torch.from_numpy(points.reshape(-1, 3)).float()
    value = lattice.trilinear(hull, flat).numpy()
    value = value.reshape(len(origins), _RAY_STEPS)
    best = value.argmin(axis=1)
    lowest = value[np.arange(len(best)), best]
    near = value < np.maximum(lowest, 0.0)[:, None] + _NEAR_HULL * lattice.cell
    length = near.sum(axis=1) * (steps[1] - steps[0])
    weight = near / np.maximum(near.sum(axis=1, keepdims=True), 1)
    centre = (weight * distance).sum(axis=1)
    sharp = (length < _LONGEST_STRETCH) & (lowest < lattice.cell)
    found = origins + centre[:, None] * directions
    return found[sharp], np.flatnonzero(sharp)


def detect(
    photos: list[ReducedPhoto],
    lattice: Lattice,
    hull: Tensor,
    generator: torch.Generator,
) -> SupportPlane | None:
    """Find the flat ground under the object by its visual hull (N,), if the masks show one."""
    cell = lattice.cell
    parts = zip(*[_outline_rays(photo) for photo in photos], strict=True)
    rays = OutlineRays(*[np.concatenate(part) for part in parts])
    points, of_ray = touching_points(rays, lattice, hull)
    if len(points) < _LEAST_TOUCHING:
        return None
    eyes = np.stack([photo.camera.position for photo in photos])
    found = _consensus(points, eyes, cell, generator)
    if found is None:
        return None
    normal, offset = found
    # The upper edge is what bears things: outline points whose surface faces up. Most points may
    # lie on the lower edge of a thick ground.
    height = points @ normal - offset
    faces_up = rays.outward[of_ray] @ normal > _LEAST_UPWARD
    edge = commonest(height[faces_up & (np.abs(height) < _THICKEST * cell)], cell)
    upper = faces_up & (np.abs(height - edge) < 2.0 * cell)
    if upper.sum() >= _LEAST_UPPER:
        width = _FIT_WIDTH * cell
        normal, offset = _refit(points[upper], normal, width)
        middle = np.median(points[upper], axis=0)
        middle += (offset - middle @ normal) * normal
        offset += level(rays, of_ray[upper], middle, normal, width)
    height = points @ normal - offset
    rim = points[np.abs(height) < _RIM_WIDTH * cell]
    plane = _outlined(rim, normal, offset)
    if plane is None or not _is_ground(plane, rim, photos, Sampled(lattice, hull)):
        return None
    return plane


def _consensus(
    points: Array, eyes: Array, cell: float, generator: torch.Generator
) -> tuple[Array, float] | None:
    """Plane with most points near it and the cameras on one side (Fischler and Bolles 1981)."""
    tolerance = _TOLERANCE * cell
    triples = torch.randint(len(points), (_TRIALS, 3), generator=generator).numpy()
    one, two, three = (points[triples[:, k]] for k in range(3))
    normals = np.cross(two - one, three - one)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(length, 1e-12)[:, None]
    normals *= np.where((normals * (eyes.mean(0) - one)).sum(1) < 0, -1.0, 1.0)[:, None]
    offsets = (normals * one).sum(1)
    usable = (length >= 0.05) & ((eyes @ normals.T > offsets).mean(0) >= _LEAST_IN_FRONT)
    count = usable * (np.abs(points @ normals.T - offsets) < tolerance).sum(0)
    first = int(count.argmax())
    if count[first] < _LEAST_AGREEING:
        return None
    near = np.abs(points @ normals[first] - offsets[first]) < 2.0 * tolerance
    return _refit(points[near], normals[first], tolerance)


def commonest(values: Array, width: float) -> float:
    """Mean of the values (N,) about the one that has most others within a width; 0 without any."""
    if not len(values):
        return 0.0
    ordered = np.sort(values)
    first = np.searchsorted(ordered, ordered - width)
    last = np.searchsorted(ordered, ordered + width, side="right")
    best = int((last - first).argmax())
    return float(ordered[first[best] : last[best]].mean())


def _refit(points: Array, normal: Array, width: float) -> tuple[Array, float]:
    """Plane through points by reweighted least squares (Geman-McClure weights)."""
    weight = np.ones(len(points))
    offset = float(np.median(points @ normal))
    for _ in range(_FIT_ROUNDS):
        middle = (weight[:, None] * points).sum(0) / weight.sum()
        spread = (points - middle) * weight[:, None]
        _, _, axes = np.linalg.svd(spread.T @ (points - middle))
        normal = axes[2] if axes[2] @ normal > 0 else -axes[2]
        offset = float(middle @ normal)
        weight = 1.0 / (1.0 + ((points @ normal - offset) / width) ** 2) ** 2
    return normal, offset


def _outlined(rim: Array, normal: Array, offset: float) -> SupportPlane | None:
    """The plane with the convex outline of its rim points."""
    axes = np.stack([*tangents(normal), normal])
    flat = rim @ axes[:2].T
    try:
        outline = flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):
        return None
    middle = 0.5 * (outline.min(0) + outline.max(0))
    origin = middle @ axes[:2] + offset * normal
    return SupportPlane(origin=origin, axes=axes, outline=outline - middle)


def _is_ground(plane: SupportPlane, rim: Array, photos: list[ReducedPhoto], hull: Sampled) -> bool:
    """Whether a plane is ground: its rim runs all round, it carries all, and masks contain it."""
    local = plane.local(rim)[:, :2]
    turn = np.sort(np.arctan2(local[:, 1], local[:, 0]))
    gap = np.diff(np.append(turn, turn[0] + 2.0 * np.pi)).max()
    inside = hull.lattice.nodes()[hull.values < 0].numpy().astype(np.float64)
    spot = plane.local(inside)
    carried = within(plane.outline * _OUTLINE_GROWTH, spot[:, :2]).mean()
    shares = []
    for photo in photos:
        area = project_outline(plane, photo.camera)
        shares.append((photo.coverage[area] > 0.5).mean() if area.any() else 0.0)
    is_round = gap < np.radians(_WIDEST_GAP)
    return bool(is_round and carried > _LEAST_SHARE and np.mean(shares) > _LEAST_SHARE)


def project_outline(plane: SupportPlane, camera: Camera) -> NDArray[np.bool_]:
    """Pixels whose centre lies in the picture of the plane's outline, (H, W)."""
    flat = np.concatenate([plane.outline, np.zeros((len(plane.outline), 1))], axis=1)
    image, depth = camera.project(plane.world(flat))
    if (depth <= 0).any():
        return np.zeros((camera.height, camera.width), bool)
    return polygon2mask((camera.height, camera.width), image[:, ::-1] - 0.5)


def within(outline: Array, points: Array) -> NDArray[np.bool_]:
    """Whether points (P, 2) lie in a convex, counter-clockwise outline (K, 2)."""
    inside = np.ones(len(points), bool)
    for one, two in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        edge = two - one
        inside &= edge[0] * (points[:, 1] - one[1]) - edge[1] * (points[:, 0] - one[0]) >= 0
    return inside


def level(
    rays: OutlineRays, touching: NDArray[np.int64], middle: Array, normal: Array, width: float
) -> float:
    """How far to raise a plane, unit frame, so that all photographs see the same far edge in it.

    Where a visual hull bulges, touching points are guesses, and a ground through them is too high:
    flat cameras see its edge nearer to the middle than steep ones do. Linear least squares for the
    edge, the rise and the radius of the edge's rounding, repeated with Geman-McClure weights; 0
    where too few rays agree. It begins with the rays `touching`; a ray may miss by `width` at
    first.
    """
    weight = np.zeros(len(rays.origins))
    weight[touching] = 1.0
    knots, narrow = _KNOTS, _NARROWING * width
    system = _System(rays, middle, normal)
    edge = system.solve(weight)
    rise = edge[knots]
    for number in range(_EDGE_ROUNDS):
        # the unknowns are those of the last height: the edge is the same, the rise is done
        edge[knots] = 0.0
        system = _System(rays, middle + rise * normal, normal)
        weight = system.weights(edge, width if number < _WIDE_ROUNDS else narrow)
        edge = system.solve(weight)
        rise += edge[knots]
    agreeing = (weight[system.usable] > 0.5).sum()
    return rise if agreeing > _RAYS_A_KNOT * knots and abs(rise) < width else 0.0


class _System:
    """What rays say of a plane's edge: K distances from its middle, the rise, the rounding."""

    def __init__(self, rays: OutlineRays, middle: Array, normal: Array) -> None:
        first, second = tangents(normal)
        rising = rays.outward @ normal
        falling = np.maximum(-(rays.directions @ normal), 0.5 * _LEAST_FALL)
        reach = ((rays.origins - middle) @ normal) / falling
        spot = rays.origins + reach[:, None] * rays.directions - middle
        along, aside = spot @ first, spot @ second
        self._radius = np.maximum(np.hypot(along, aside), 1e-9)
        across = (rays.outward * spot).sum(1) / self._radius
        self.usable = across > _LEAST_ALONG * np.sqrt(np.maximum(1.0 - rising**2, 0.0))
        self.usable &= (rising > _LEAST_RISE) & (falling > _LEAST_FALL)
        turn = (np.arctan2(aside, along) / (2.0 * np.pi)) % 1.0 * _KNOTS
        knot, part, row = turn.astype(int) % _KNOTS, turn % 1.0, np.arange(len(turn))
        self._matrix = np.zeros((len(turn), _KNOTS + 2))
        self._matrix[row, knot] = 1.0 - part
        self._matrix[row, (knot + 1) % _KNOTS] = part
        # a higher plane is met earlier
        self._matrix[:, _KNOTS] = (rays.directions * spot).sum(1) / (self._radius * falling)
        # a circle's tangent with normal (sin e, cos e) passes its topmost level (1 - cos e) / sin e
        # radii outside its middle
        self._matrix[:, _KNOTS + 1] = (1.0 - rising) / np.maximum(across, 0.05)

    def weights(self, edge: Array, width: float) -> Array:
        """Geman-McClure weights (P,) of the rays given the unknowns (K + 2,)."""
        away = (self._matrix @ edge - self._radius) / width
        return 1.0 / (1.0 + away**2) ** 2

    def solve(self, weight: Array) -> Array:
        """Unknowns (K + 2,) by least squares with weights (P,)."""
        root = np.sqrt(weight * self.usable)
        stiff = np.zeros((_KNOTS, _KNOTS + 2))
        stiff[:, :_KNOTS] = np.roll(np.eye(_KNOTS), 1, axis=1) - np.eye(_KNOTS)
        stiff[:, :_KNOTS] *= _STIFFNESS
        matrix = np.concatenate([root[:, None] * self._matrix, stiff])
        wanted = np.concatenate([root * self._radius, np.zeros(_KNOTS)])
        return np.linalg.lstsq(matrix, wanted, rcond=None)[0]
