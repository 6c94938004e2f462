# SPDX-License-Identifier: Apache-2.0
"""The plane that an object stands on, by its masks alone.

Photographs from above leave the visual hull a cone below the object, which hides behind the object
in every one of them. No camera meets it first: all that cameras meet of the hull lies above the
plane that the object stands on, and its lowest points lie on it. Of all planes that lie below what
cameras meet, that one cuts most off the hull.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from robir.geometry.lattice import Sampled
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.rays import ReducedPhoto
from robir.maths.vectors import fibonacci_sphere, ring

Array = NDArray[np.float64]

_RAYS = 1500  # rays of a photograph at most
_NODES = 40_000  # nodes inside the hull at most by which what is cut off is counted
_BELOW = 0.001  # share of what cameras meet that may lie below the plane: edges of masks err
_DIRECTIONS = 400  # normals of the first search
_ROUNDS = 6  # rings of normals of the second
_RADIUS = 0.17  # of the first ring, about the spacing of the first search (radians)
_SHRINKING = 0.6  # radius of a ring over that of the one before
_LEAST_SHARE = 0.01  # share of the hull that is cut off at least, or nothing is
_MARGIN = 0.01  # what is left below the plane, unit frame


class Base(NamedTuple):
    """A plane with what it cuts off."""

    normal: Array  # (3,) unit, towards the cameras
    offset: float  # points p on it have normal . p = offset, unit frame
    share: float  # of the hull that lies below


def without_cone(hull: Sampled, photos: list[ReducedPhoto]) -> Sampled:
    """The hull, of an object without ground, less what lies below the plane that it stands on.

    The hull itself where a camera looks from below, or hardly anything lies there.
    """
    base = base_plane(hull, photos)
    if base is None or base.share < _LEAST_SHARE:
        return hull
    height = hull.lattice.nodes().double().numpy() @ base.normal - base.offset
    below = torch.from_numpy(-_MARGIN - height).float()
    return Sampled(hull.lattice, torch.maximum(hull.values, below))


def base_plane(hull: Sampled, photos: list[ReducedPhoto]) -> Base | None:
    """The plane below all that cameras meet of the hull, and below no camera, that cuts off most.

    None where there is none; arguments as for `without_cone`.
    """
    met = _met_first(hull, photos)
    inside = hull.lattice.nodes()[hull.values < 0].double().numpy()
    if not len(met) or not len(inside):
        return None
    inside = inside[:: -(-len(inside) // _NODES)]
    eyes = np.stack([photo.camera.position for photo in photos])

    def best_of(normals: Array) -> Base:
        offsets = np.quantile(met @ normals.T, _BELOW, axis=0)
        shares = (inside @ normals.T < offsets).mean(0)
        shares[(eyes @ normals.T).min(0) < offsets] = -1.0
        best = int(shares.argmax())
        return Base(normals[best], float(offsets[best]), float(shares[best]))

    found, radius = best_of(fibonacci_sphere(_DIRECTIONS).double().numpy()), _RADIUS
    if found.share <= 0:
        return None
    for _ in range(_ROUNDS):
        rings = [ring(found.normal, part * radius, 12, 0.0) for part in (0.5, 1.0)]
        tried = best_of(np.concatenate(rings))
        found, radius = max(found, tried, key=lambda base: base.share), _SHRINKING * radius
    return found


def _met_first(hull: Sampled, photos: list[ReducedPhoto]) -> Array:
    """Points (P, 3) of the hull that rays within masks meet first."""
    mesh = extract(*hull)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    points = [np.zeros((0, 3))]
    for photo in photos:
        pixels = np.argwhere(photo.coverage > 0.5)[:, ::-1] + 0.5
        pixels = pixels[:: -(-len(pixels) // _RAYS) or 1]
        origins, directions = photo.camera.rays(pixels)
        hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
        met = np.isfinite(hits.distance)
        points.append(origins[met] + hits.distance[met][:, None] * directions[met])
    return np.concatenate(points)
