# SPDX-License-Identifier: Apache-2.0
"""Photographs that cannot have been taken with the lens that is stated for them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from robir.capture.capture import Finding, View
from robir.capture.frames import Frame, Lens
from robir.capture.refusal import warning

SHAPE_SLACK = 0.02  # difference of width over height, against itself, that rounding makes at most


def check_shapes(frames: Sequence[Frame], views: Sequence[View]) -> list[Finding]:
    """Photographs of another shape than the rest, where one lens is stated for all of them.

    Args:
        frames: What the format says.
        views: Read photographs.

    Returns:
        At most one finding.
    """
    wide = {view.name: view.camera.whole_size for view in views}
    shapes: dict[Lens, dict[str, float]] = defaultdict(dict)
    for frame in frames:
        if frame.name in wide and frame.lens.size is None:
            width, height = wide[frame.name]
            shapes[frame.lens][frame.name] = width / height
    odd = [
        name
        for own in shapes.values()
        for name, shape in own.items()
        if abs(shape / float(np.median(list(own.values()))) - 1.0) > SHAPE_SLACK
    ]
    if not odd:
        return []
    return [
        warning(
            "odd-shapes",
            f"{len(odd)} of {len(views)} photographs are of another shape than the rest, but the "
            "poses state one lens for all of them: cut, turned or stitched pictures have another",
            "Leave them out, or give the photographs as they were taken.",
            *odd,
        )
    ]
