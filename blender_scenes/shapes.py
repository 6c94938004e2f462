# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed shapes as polygons with texture coordinates: boxes, lathes and tubes (pure numpy)."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True)
class Shape:
    """A polygon mesh.

    Attributes:
        vertices: (N, 3) positions, scene units.
        faces: vertex indices of each polygon, counter-clockwise seen from outside.
        uvs: for each polygon the (corners, 2) texture coordinates, 0..1, v upward.
    """

    vertices: np.ndarray
    faces: list[tuple[int, ...]]
    uvs: list[np.ndarray]


def box(size: tuple[float, float, float]) -> Shape:
    """Axis-aligned box centred at the origin; each face shows the whole texture upright."""
    half = 0.5 * np.asarray(size)
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * half
    # order: -x, +x, -y, +y, bottom, top; each starts at its lower left corner seen from outside
    faces = [(2, 0, 4, 6), (1, 3, 7, 5), (0, 1, 5, 4), (3, 2, 6, 7), (2, 3, 1, 0), (4, 5, 7, 6)]
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return Shape(corners, faces, [square] * 6)


def lathe(profile: np.ndarray, segments: int = 72) -> Shape:
    """Surface of revolution about z.

    Args:
        profile: (K, 2) radius and height, from the bottom axis point (radius 0) round the outside
            to the top axis point (radius 0), so that the surface is closed.
        segments: steps of the turn.

    Returns:
        The surface; u runs once round (from +x towards +y), v along the profile's length.
    """
    profile = np.asarray(profile, dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    v = length / length[-1]
    turn = 2.0 * np.pi * np.arange(segments) / segments
    rings = profile[1:-1]
    ring_points = np.stack(
        [
            rings[:, :1] * np.cos(turn),
            rings[:, :1] * np.sin(turn),
            np.broadcast_to(rings[:, 1:], (len(rings), segments)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    bottom, top = len(ring_points), len(ring_points) + 1
    vertices = np.concatenate(
        [ring_points, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]]
    )
    faces: list[tuple[int, ...]] = []
    uvs: list[np.ndarray] = []
    for j in range(segments):
        k = (j + 1) % segments
        u0, u1 = j / segments, (j + 1) / segments
        faces.append((bottom, k, j))
        uvs.append(np.array([[0.5 * (u0 + u1), v[0]], [u1, v[1]], [u0, v[1]]]))
        for i in range(len(rings) - 1):
            low, high = i * segments, (i + 1) * segments
            faces.append((low + j, low + k, high + k, high + j))
            uvs.append(np.array([[u0, v[i + 1]], [u1, v[i + 1]], [u1, v[i + 2]], [u0, v[i + 2]]]))
        last = (len(rings) - 1) * segments
        faces.append((last + j, last + k, top))
        uvs.append(np.array([[u0, v[-2]], [u1, v[-2]], [0.5 * (u0 + u1), v[-1]]]))
    return Shape(vertices, faces, uvs)


def cylinder(radius: float, height: float, rounding: float = 0.0) -> Shape:
    """Upright cylinder from z = 0 to `height`, its rims rounded by `rounding`."""
    if rounding <= 0.0:
        return lathe(np.array([[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]]))
    arc = np.linspace(0.0, 0.5 * np.pi, 6)
    rim = np.stack(
        [radius - rounding + rounding * np.sin(arc), rounding - rounding * np.cos(arc)], axis=1
    )
    upper = np.stack([rim[::-1, 0], height - rim[::-1, 1]], axis=1)
    # a ring inside each flat end keeps the smoothed normals of the rim off it
    inner = radius - 2.0 * rounding
    ends = [[0.0, 0.0], [inner, 0.0]], [[inner, height], [0.0, height]]
    return lathe(np.concatenate([ends[0], rim, upper, ends[1]]))


def sphere(radius: float) -> Shape:
    """Sphere centred at the origin."""
    polar = np.linspace(0.0, np.pi, 49)
    return lathe(np.stack([radius * np.sin(polar), -radius * np.cos(polar)], axis=1))


def cone(radius: float, height: float) -> Shape:
    """Upright cone, base at z = 0."""
    steps = np.linspace(1.0, 0.0, 9)
    side = np.stack([radius * steps, height * (1.0 - steps)], axis=1)
    return lathe(np.concatenate([[[0.0, 0.0]], side]))


def smooth_profile(points: list[tuple[float, float]], count: int = 64) -> np.ndarray:
    """Samples a profile for `lathe` along a monotone-parameter spline through the given points.

    Args:
        points: radius and height from the bottom axis point to the top axis point.
        count: samples K.

    Returns:
        (K, 2) with radii at least 0 and both ends on the axis.
    """
    knots = np.asarray(points, dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    profile = PchipInterpolator(length, knots)(np.linspace(0.0, length[-1], count))
    profile[:, 0] = np.maximum(profile[:, 0], 1e-4)
    profile[[0, -1], 0] = 0.0
    return profile


def tube(path: np.ndarray, radius: float, segments: int = 32, squash: float = 1.0) -> Shape:
    """Tube with hemispherical ends along a path near the x-y plane.

    Args:
        path: (M, 3) points of the centre line.
        radius: of the cross-section.
        segments: corners of the cross-section.
        squash: height of the cross-section over its width.

    Returns:
        The surface; u runs round the cross-section, v along the path.
    """
    path = np.asarray(path, dtype=float)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    cap = np.linspace(0.5 * np.pi, 0.0, 9)[1:-1]
    start = path[0] - radius * np.sin(cap)[:, None] * tangent[0]
    end = (path[-1] + radius * np.sin(cap)[:, None] * tangent[-1])[::-1]
    centres = np.concatenate([start, path, end])
    radii = radius * np.concatenate([np.cos(cap), np.ones(len(path)), np.cos(cap)[::-1]])
    tangents = np.concatenate(
        [np.repeat(tangent[:1], 7, 0), tangent, np.repeat(tangent[-1:], 7, 0)]
    )
    side = np.cross([0.0, 0.0, 1.0], tangents)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(tangents, side)
    poles = np.stack([path[0] - radius * tangent[0], path[-1] + radius * tangent[-1]])
    turn = 2.0 * np.pi * np.arange(segments) / segments
    ring_count = len(centres)
    offsets = side[:, None] * np.cos(turn)[:, None] + squash * up[:, None] * np.sin(turn)[:, None]
    # a turned lathe has the same faces: take them, and put the tube's points in
    frame = lathe(
        np.stack([np.r_[0.0, np.ones(ring_count), 0.0], np.arange(ring_count + 2.0)], axis=1),
        segments,
    )
    rings = centres[:, None] + radii[:, None, None] * offsets
    return Shape(np.concatenate([rings.reshape(-1, 3), poles]), frame.faces, frame.uvs)
