# SPDX-License-Identifier: Apache-2.0
"""Guessed masks made better by the surface that photographs show.

Depth maps of small photographs, in a hull that a few masks may not cut alone, are good enough to
say where the object ends to within a few pixels; within these colours and edges decide. The masks
so cut give the next hull.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Capture, View
from robir.capture.masks.guess import SIDE, Picture, recut, reduced, sharpened
from robir.geometry.config import GeometryConfig
from robir.geometry.hull import mask_distance, object_hull
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.rays import reduce_view
from robir.geometry.selection import smooth_surface
from robir.geometry.stereo.fusion import entry_depth, stereo_surface

# size of the photographs and of the lattice for these surfaces, as a share of the final ones
_COARSENESS = 0.64
_ROUNDS = 2  # surfaces and cuts, in turns


def remasked(
    capture: Capture, config: GeometryConfig, progress: Callable[[float], None]
) -> Capture:
    """A capture, whose masks were guessed, with masks cut again, the held-out views' too."""
    side = round(_COARSENESS * config.stereo_side)
    pictures = reduced(capture.views, SIDE)
    for number in range(_ROUNDS):
        photos = [reduce_view(view, side) for view in capture.train]
        hull = object_hull(capture, photos, config.hull_cells, guessed=True)
        mesh = smooth_surface(stereo_surface(photos, hull, _COARSENESS))
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        capture = replace(capture, views=cut_about(tracer, capture.views, pictures))
        progress((number + 1) / _ROUNDS)
    return capture


def cut_about(
    tracer: EmbreeTracer, views: Sequence[View], pictures: Sequence[Picture] | None = None
) -> tuple[View, ...]:
    """Views with masks that end where colours and edges say so, near a surface's outline."""
    pictures = pictures or reduced(views, SIDE)
    sizes = [picture.lab.shape[1::-1] for picture in pictures]
    cameras = [view.camera.resized(*size) for view, size in zip(views, sizes, strict=True)]
    shown = [np.isfinite(entry_depth(tracer, camera)) for camera in cameras]
    outlines = [mask_distance(one.astype(np.float32)) for one in shown]
    cut = zip(views, recut(pictures, outlines), strict=True)
    return tuple(_with_mask(*pair) for pair in cut)


def _with_mask(view: View, belief: NDArray[np.float32]) -> View:
    """A view with the mask of a belief, or as it was where that leaves nothing."""
    mask = sharpened(view.image_display, belief)
    return replace(view, mask=mask) if mask.any() else view
