# SPDX-License-Identifier: Apache-2.0
"""What the photographs say about each surface sample.

Samples are projected into the photographs (rather than pixels onto the surface), so that the cost
follows the scene and not the number of pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.vectors import farthest_points
from robir.workers import side_by_side

Floats = NDArray[np.float32]

MASK_INSIDE = 250  # mask code from which a pixel is wholly object

DEPTH_JUMP = 0.03  # smallest step of depth, unit frame, that counts as the outline of a nearer part

# views flatter than this (78 degrees off the normal) are not read: a pixel there covers five times
# its width of surface
MIN_COSINE = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """Colours of surface points in the photographs."""

    display: NDArray[np.uint8]  # (N, V, 3) uint8, display-referred; meaningless where `weight` is 0
    weight: Floats  # (N, V) float32, 0 where the view does not show the point, else its cosine
    clipped: NDArray[np.bool_]  # (N, V, 3) bool, code 255: the true value is at least this bright
    # (N, V) uint8, as `off_axis_codes` gives it; meaningless where `weight` is 0
    off_axis: NDArray[np.uint8]
    positions: Floats  # (V, 3) float32, camera centres
    views: tuple[str, ...]  # names of the V views

    def subset(self, keep: NDArray[np.bool_]) -> Observations:
        """The points where `keep` holds."""
        return replace(
            self,
            display=self.display[keep],
            weight=self.weight[keep],
            clipped=self.clipped[keep],
            off_axis=self.off_axis[keep],
        )

    def of_views(self, keep: NDArray[np.bool_]) -> Observations:
        """All points in the views where `keep` holds."""
        return Observations(
            display=self.display[:, keep],
            weight=self.weight[:, keep],
            clipped=self.clipped[:, keep],
            off_axis=self.off_axis[:, keep],
            positions=self.positions[keep],
            views=tuple(view for view, kept in zip(self.views, keep, strict=True) if kept),
        )


def spread_views(views: tuple[View, ...], count: int) -> tuple[View, ...]:
    """At most `count` views whose cameras lie far apart, in their old order."""
    positions = np.stack([view.camera.position for view in views])
    return tuple(views[index] for index in farthest_points(positions, count))


def observe(
    tracer: EmbreeTracer,
    position: Floats,
    normal: Floats,
    views: tuple[View, ...],
    offset: float,
) -> Observations:
    """Read points (N, 3), with unit normals, in every view that sees them.

    A view counts where the point faces it, nothing lies between (rays start at `offset` above the
    surface), and all four pixels about its projection are object and away from nearer outlines.
    """
    count = len(position)
    display = np.zeros((count, len(views), 3), np.uint8)
    weight = np.zeros((count, len(views)), np.float32)
    clipped = np.zeros((count, len(views), 3), bool)
    off_axis = np.zeros((count, len(views)), np.uint8)

    def read(index: int) -> None:
        view, camera = views[index], views[index].camera
        towards = camera.position - position
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.einsum("nd,nd->n", towards, normal) / distance
        chosen = np.flatnonzero(cosine > MIN_COSINE)
        pixels, depth = camera.project(position[chosen].astype(np.float64))
        inside = (pixels >= 1).all(1) & (pixels <= [camera.width - 1, camera.height - 1]).all(1)
        inside &= depth > 0
        chosen, pixels = chosen[inside], pixels[inside]
        start = position[chosen] + offset * normal[chosen]
        rays = towards[chosen] / distance[chosen, None]
        free = ~tracer.is_blocked(start, rays)
        chosen, pixels = chosen[free], pixels[free]
        colour, top, whole = _bilinear(view, clean_pixels(tracer, view)[0], pixels)
        kept = chosen[whole]
        display[kept, index] = colour[whole]
        clipped[kept, index] = top[whole]
        weight[kept, index] = cosine[kept]
        off_axis[kept, index] = off_axis_codes(camera, pixels[whole])

    side_by_side(read, range(len(views)))
    centres = np.stack([view.camera.position for view in views]).astype(np.float32)
    return Observations(
        display=display,
        weight=weight,
        clipped=clipped,
        off_axis=off_axis,
        positions=centres,
        views=tuple(view.name for view in views),
    )


def off_axis_codes(camera: Camera, pixels: NDArray[np.float64]) -> NDArray[np.uint8]:
    """`Camera.off_axis` of points (N, 2), pixels, in 255ths, (N,)."""
    return np.rint(255 * camera.off_axis(pixels)).astype(np.uint8)


def clean_pixels(tracer: EmbreeTracer, view: View) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Object pixels (H, W) that no nearer outline runs through, and inverse depths (H, W).

    The inverse of depth is linear across the image of a plane, so its second difference marks jumps
    of depth only. It is 0 where there is no surface.
    """
    inside = view.mask > MASK_INSIDE
    rows, columns = np.nonzero(inside)
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
    origins, directions = view.camera.rays(pixels)
    hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    inverse = np.zeros(view.mask.shape)
    inverse[rows, columns] = 1 / (hits.distance * (directions @ view.camera.forward))
    jump = np.zeros(view.mask.shape)
    for axis in (0, 1):
        bend = np.abs(np.diff(inverse, n=2, axis=axis))
        margin = [(1, 1) if axis == side else (0, 0) for side in (0, 1)]
        jump = np.maximum(jump, np.pad(bend, margin, mode="edge"))
    # d(1/z) = dz / z^2: a jump of dz bends the inverse depth by that much.
    return inside & (jump < DEPTH_JUMP * inverse**2), inverse


def _pixels_about(
    camera: Camera, places: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows, columns and bilinear shares (N, 4) of the pixels about places (N, 2)."""
    last = [camera.width - 2, camera.height - 2]
    low: NDArray[np.int64] = np.clip(np.floor(places - 0.5), 0, last).astype(np.int64)
    right, down = np.clip(places - 0.5 - low, 0, 1).T
    shares = [(1 - right) * (1 - down), (1 - right) * down, right * (1 - down), right * down]
    rows = low[:, 1:] + np.array([0, 1, 0, 1])
    columns = low[:, :1] + np.array([0, 0, 1, 1])
    return rows, columns, np.stack(shares, axis=1)


def _bilinear(
    view: View, clean: NDArray[np.bool_], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.bool_]]:
    """Interpolated colours, where a source was clipped, and where all sources are clean."""
    rows, columns, shares = _pixels_about(view.camera, pixels)
    colour = np.zeros((len(pixels), 3))
    top = np.zeros((len(pixels), 3), bool)
    whole = np.ones(len(pixels), bool)
    for row, column, share in zip(rows.T, columns.T, shares.T, strict=True):
        texel = view.image_display[row, column]
        colour += share[:, None] * texel
        counts = share > 0.04
        top |= (texel == 255) & counts[:, None]
        whole &= clean[row, column] | ~counts
    return np.rint(colour).astype(np.uint8), top, whole
