# SPDX-License-Identifier: Apache-2.0
"""Visibility as bits, exact visibility ratios, and the one-bounce matrix.

For a fixed set of D directions that cover the sphere evenly, each of solid angle 4 pi / D, one bit
says whether a sample sees the environment there. Irradiance from any environment L is then

    E(x) = sum_d V(x, w_d) max(n . w_d, 0) L(w_d) 4 pi / D                                   (1)

and the visibility ratio of a lobe (METHOD 2.6) is the lobe-weighted mean of bits. Where a bit is
zero, the ray ends at another sample j whose exitant radiance it carries; collecting these weights
gives the sparse matrix G with indirect irradiance E_ind = G @ radiance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.maths.vectors import tangents
from robir.transport.surfels import Surfels, interpolate
from robir.workers import blocks, side_by_side

Floats = NDArray[np.float32]

CHUNK = 400_000

# cosine below which rays to a sun no longer start the whole offset above the surface: their start
# would move along them by more than ten times as much
GRAZING = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Visibility:
    """What each surface sample sees."""

    directions: Floats  # (D, 3) float32, unit, evenly spread over the sphere
    # (S, D/8) uint8, packed; 1 where the direction is above the surface and unblocked
    bits: NDArray[np.uint8]
    # (S, S) sparse; row i applied to exitant radiance gives indirect irradiance at i
    bounce: csr_matrix
    is_traced: bool  # whether surfaces block light; false only in the ablation without visibility
    offset: float  # distance that rays started above the surface, unit frame

    def unpacked(self) -> NDArray[np.bool_]:
        """Bits as booleans, (S, D)."""
        return np.unpackbits(self.bits, axis=1, count=len(self.directions)).astype(bool)


def trace_visibility(
    mesh: Mesh, tracer: EmbreeTracer, surfels: Surfels, directions: Floats, offset: float
) -> Visibility:
    """Trace unit directions (D, 3) above every sample's horizon: bits and one-bounce matrix."""
    num_surfels, num_directions = len(surfels), len(directions)
    weight = 4 * np.pi / num_directions
    seen = np.zeros((num_surfels, num_directions), bool)

    def traced(part: slice) -> tuple[NDArray[Any], ...]:
        start, normal = part.start, surfels.normal[part]
        cosine = normal @ directions.T
        local, direction = np.nonzero(cosine > 0)
        origin = surfels.position[part] + offset * normal
        hits = tracer.first_hits(origin[local], directions[direction])
        free = hits.face < 0
        seen[start + local[free], direction[free]] = True
        face, barycentric = hits.face[~free], hits.barycentric[~free]
        position, hit_normal = interpolate(mesh, face, barycentric)
        values = weight * cosine[local[~free], direction[~free]]
        return start + local[~free], position, hit_normal, values

    found = side_by_side(traced, blocks(num_surfels, max(1, CHUNK // num_directions)))
    rows, position, hit_normal, values = map(np.concatenate, zip(*found, strict=True))
    hit = surfels.shared_nearest(position, hit_normal) if len(position) else np.zeros(0, np.int64)
    bounce = csr_matrix(
        (values.astype(np.float32), (rows, hit)),
        shape=(num_surfels, num_surfels),
    )
    return Visibility(
        directions=directions,
        bits=np.packbits(seen, axis=1),
        bounce=bounce,
        is_traced=True,
        offset=offset,
    )


def lobe_directions(axis: Floats, sharpness: float, count: int) -> Floats:
    """Unit directions (count, 3) spread like a normalised spherical Gaussian, without bias.

    The polar angle follows the lobe's own distribution, cos t = 1 + ln(1 - u (1 - e^(-2 s)))/s,
    stratified in u; the azimuth turns by the golden angle. Each direction has its opposite about
    the axis, so that the axis is their mean: what lights ground at a grazing angle would else be a
    tenth off with a few of them. The count is even.
    """
    u = (np.arange(count // 2) + 0.5) / (count // 2)
    cosine = 1 + np.log1p(-u * -np.expm1(-2 * sharpness)) / sharpness
    sine = np.sqrt(np.maximum(0, 1 - cosine**2))
    azimuth = np.arange(count // 2) * np.pi * (3 - np.sqrt(5))
    tangent, bitangent = tangents(axis)
    around = np.cos(azimuth)[:, None] * tangent + np.sin(azimuth)[:, None] * bitangent
    aside, along = sine[:, None] * around, cosine[:, None] * np.asarray(axis)
    return np.concatenate([along + aside, along - aside]).astype(np.float32)


def towards_light(
    position: Floats, direction: Floats, distance: float
) -> tuple[Floats, Floats | float]:
    """Unit direction of a light from points (N, 3), and its strength there over that at the origin.

    Light in `direction` (3,) from the origin of the frame and `distance` away has one for every
    point, (N, 3), and falls off by the square, (N,); one from infinitely afar has `direction`, and
    1 everywhere.
    """
    if np.isinf(distance):
        return direction, 1.0
    aside = np.float32(distance) * direction - position
    length = np.linalg.norm(aside, axis=1)
    return aside / length[:, None], (np.float32(distance) / length) ** 2


def cosines(normal: Floats, direction: Floats) -> Floats:
    """Cosines (N,) of unit normals (N, 3) with one direction (3,), or with one each, (N, 3)."""
    return normal @ direction if direction.ndim == 1 else np.einsum("nk,nk->n", normal, direction)


def lobe_transfer(
    tracer: EmbreeTracer | None,
    position: Floats,
    normal: Floats,
    directions: Floats,
    offset: float,
    distance: float = np.inf,
) -> Floats:
    """Mean of visibility times cosine (N,) over directions (J, 3) of a sharp lobe.

    Positions and unit normals are (N, 3). Light that stands `distance` from the frame's origin,
    and not infinitely far, also falls off, so that the values may exceed 1. Each ray starts farther
    along itself, and nothing may lie between there and what is straight above its point: starting
    straight above, it would see every shadow nearer to what casts it, as under a higher sun.
    """
    total = np.zeros(len(position), np.float32)
    axis, _ = towards_light(position, directions.mean(0), distance)
    beside = _beside_a_wall(tracer, position, normal, axis, offset)
    for direction in directions:
        ray, strength = towards_light(position, direction, distance)
        cosine = cosines(normal, ray)
        lit = np.flatnonzero((cosine > 0) & ~beside)
        if tracer is not None and len(lit):
            rays = np.broadcast_to(ray, position.shape)[lit]
            start = position[lit] + _along(cosine[lit], offset) * rays
            lit = lit[~tracer.is_blocked(start, rays)]
        total[lit] += (cosine * strength)[lit]
    return total / len(directions)


def _along(cosine: Floats, offset: float) -> Floats:
    """How far (N, 1) along itself a ray starts so as to be `offset` above the surface."""
    return (offset / np.maximum(cosine, GRAZING))[:, None]


def _beside_a_wall(
    tracer: EmbreeTracer | None,
    position: Floats,
    normal: Floats,
    axis: Floats,
    offset: float,
) -> NDArray[np.bool_]:
    """Whether something lies between where rays start and what is straight above a point, (N,)."""
    # one ray a point, whatever the number of rays to the light: those of a sun start close together
    beside = np.zeros(len(position), bool)
    cosine = cosines(normal, axis)
    facing = np.flatnonzero(cosine > 0)
    if tracer is not None and len(facing):
        towards = np.broadcast_to(axis, position.shape)[facing]
        aside = _along(cosine[facing], offset) * towards - offset * normal[facing]
        reach = np.linalg.norm(aside, axis=1)
        above = position[facing] + offset * normal[facing]
        rays = aside / np.maximum(reach, 1e-12)[:, None]
        beside[facing] = tracer.is_blocked(above, rays, reach)
    return beside
