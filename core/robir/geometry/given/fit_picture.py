# SPDX-License-Identifier: Apache-2.0
"""A picture of photographs with the user's mesh over them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from robir.capture.capture import View
from robir.capture.images.loading import size_within
from robir.geometry.given.placing import is_met
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.jobs.paths import replacing
from robir.maths.similarity import Similarity
from robir.maths.vectors import farthest_points

_PHOTOGRAPHS = 4  # in a row of it
_SIDE = 240  # longer side of each (pixels)


def show_fit(
    tracer: EmbreeTracer,
    places: Sequence[Similarity],
    views: Sequence[View],
    picture: Path,
) -> None:
    """Write photographs with the mesh over them, red.

    Args:
        tracer: Of the mesh.
        places: Where it is shown, a row of pictures each.
        views: Photographs to choose from.
        picture: The PNG.
    """
    positions = np.stack([view.camera.position for view in views])
    chosen = farthest_points(positions, _PHOTOGRAPHS)
    sheet = Image.new("RGB", (_SIDE * len(chosen), _SIDE * len(places)))
    for column, view in enumerate(views[k] for k in chosen):
        size = size_within((view.camera.width, view.camera.height), _SIDE)
        small = view.camera.resized(*size)
        photo = np.array(Image.fromarray(view.image_display).resize(size))
        rays = small.rays(small.pixel_centres())
        for row, place in enumerate(places):
            shown = is_met(tracer, place, rays).reshape(photo.shape[:2])
            over = photo.copy()
            over[shown] = over[shown] // 2 + np.array([127, 0, 0], np.uint8)
            sheet.paste(Image.fromarray(over), (_SIDE * column, _SIDE * row))
    with replacing(picture) as temporary:
        sheet.save(temporary, format="PNG")
