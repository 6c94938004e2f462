# SPDX-License-Identifier: Apache-2.0
"""From doubtful pixels to a mask whose outline runs along edges of the photograph.

Random walker with prior models (Grady 2005, "Multilabel random walker image segmentation using
prior models"): of all x in [0, 1] over the pixels, the one that minimises

    sum over neighbours i, j of w_ij (x_i - x_j)^2  +  STRENGTH sum over i of c_i (x_i - p_i)^2

with p the belief in the object, c = |2 p - 1| its certainty and w small across edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.capture.masks.sight import Layer

STRENGTH = 0.05  # weight of a pixel's own belief against that of its neighbours
LEAST_EDGE = 0.002  # weight between neighbours across the strongest edge
STEPS = 60  # steps of conjugate gradients at most


def walk(
    lab: Layer, belief: Layer, fixed: NDArray[np.bool_] | None = None, steps: int = STEPS
) -> Layer:
    """Belief spread along the picture's areas and held at its edges.

    Args:
        lab: (H, W, 3) picture, CIE L*a*b*.
        belief: (H, W) in [0, 1].
        fixed: (H, W) pixels that keep their belief, or None.
        steps: Steps of the solver at most.

    Returns:
        (H, W) float32 in [0, 1]; the mask is where it is above one half.
    """
    across, down = _weights(lab)
    certainty = np.float32(STRENGTH) * (np.abs(2 * belief - 1) + np.float32(1e-3))
    if fixed is not None:
        certainty = np.where(fixed, np.float32(1e3), certainty)
    diagonal = certainty.copy()
    for axis, weight in ((1, across), (0, down)):
        first, second = _sides(diagonal, axis)
        first += weight
        second += weight

    def apply(x: Layer) -> Layer:
        result = diagonal * x
        for axis, weight in ((1, across), (0, down)):
            to_first, to_second = _sides(result, axis)
            first, second = _sides(x, axis)
            to_first -= weight * second
            to_second -= weight * first
        return result

    x = belief.astype(np.float32).copy()
    rest = certainty * belief - apply(x)
    direction = z = rest / diagonal
    power = float((rest * z).sum())
    enough = 1e-6 * max(float((certainty * belief).sum()), 1e-9)
    for _ in range(steps):
        if power < enough:
            break
        image = apply(direction)
        step = np.float32(power / float((direction * image).sum()))
        x += step * direction
        rest = rest - step * image
        z = rest / diagonal
        before, power = power, float((rest * z).sum())
        direction = z + np.float32(power / before) * direction
    return np.clip(x, 0, 1)


def _weights(lab: Layer) -> tuple[Layer, Layer]:
    """Likeness of horizontal (H, W - 1) and vertical (H - 1, W) neighbours."""
    across = np.square(np.diff(lab, axis=1)).sum(axis=2)
    down = np.square(np.diff(lab, axis=0)).sum(axis=2)
    # the width of GrabCut (Rother, Kolmogorov and Blake 2004): twice the mean square
    width = across.sum() + down.sum()
    width = 2 * width / max(across.size + down.size, 1) + np.float32(1e-6)
    floor = np.float32(LEAST_EDGE)
    return np.exp(-across / width) + floor, np.exp(-down / width) + floor


def _sides(layer: Layer, axis: int) -> tuple[Layer, Layer]:
    """Views of the first and the second pixel of each pair of neighbours."""
    if axis == 1:
        return layer[:, :-1], layer[:, 1:]
    return layer[:-1], layer[1:]
