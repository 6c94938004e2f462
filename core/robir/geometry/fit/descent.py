# SPDX-License-Identifier: Apache-2.0
"""Steps of the distances: Adam's, shortened where the photographs contradict each other.

What the colours cannot follow, highlights above all, pushes the surface to and fro as rays come
and go. Adam makes steps of one length of strong and of weak gradients, so such pushes dig lumps
that nothing levels again. Here a node's step is as long as its gradients of many steps agree.
"""

from __future__ import annotations

import torch
from torch import Tensor

from robir.geometry.fit.regularise import smoothed
from robir.geometry.lattice import Lattice

_GRADIENT_PASSES = 2  # passes of the (1, 2, 1) / 4 filter over the gradient of the distances
FIRST_DECAY = 0.9  # of the first moment, of features and network as well
SECOND_DECAY = 0.99  # of the second moment, likewise
# decay of the mean gradient that tells whether gradients agree: over 50 steps every spot is seen
# from many sides
_MEMORY = 0.98
# agreement, in multiples of what gradients of random sign show by chance, at which the step is
# halved. Chance alone then leaves a tenth of the step, ten times chance all but a tenth.
_DOUBT = 3.0


def agreement(mean: Tensor, square: Tensor, taken: int) -> Tensor:
    """How far gradients agree, as the share of a step that may be made.

    Args:
        mean: (K,) mean of `taken` gradients, weights decaying by `memory`, their sum 1.
        square: (K,) mean of their squares.
        taken: Number of gradients.

    Returns:
        (K,) in [0, 1]; one half where the squared mean is `doubt` times what random signs leave.
    """
    left = _MEMORY**taken
    chance = (1.0 - _MEMORY) / (1.0 + _MEMORY) * (1.0 + left) / (1.0 - left)
    # nodes that no ray has met yet have no gradient
    odds = (mean.square() / (square * (_DOUBT * chance)).clamp_(min=1e-30)).square_()
    return odds / (1.0 + odds)


class Descent:
    """Steps of the distances of one level.

    The gradient is smoothed first, so that the surface moves in patches rather than node by node
    (after Nicolet et al. 2021, "Large steps in inverse rendering of geometry").

    Args:
        distances: (N,) leaf that requires gradients.
        lattice: Its nodes.
    """

    def __init__(self, distances: Tensor, lattice: Lattice) -> None:
        self._distances, self._lattice = distances, lattice
        self._moments = torch.zeros(3, lattice.count, device=distances.device)
        self._nodes = torch.zeros(0, dtype=torch.int64, device=distances.device)
        self._near = self._moments[:, self._nodes]
        self._taken = 0

    def follow(self, wanted: Tensor) -> None:
        """Go on with some nodes; the others wait with their moments.

        Args:
            wanted: (N,) bool, nodes near the surface.
        """
        self._moments[:, self._nodes] = self._near
        self._nodes = wanted.nonzero()[:, 0]
        self._near = self._moments[:, self._nodes]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Move the distances by at most `rate` or so, and forget the gradient."""
        assert self._distances.grad is not None
        whole = smoothed(self._distances.grad, self._lattice, _GRADIENT_PASSES)
        gradient = whole.index_select(0, self._nodes)  # a third of the time of square brackets
        self._distances.grad = None
        self._taken += 1
        first, second, lasting = self._near
        first.lerp_(gradient, 1.0 - FIRST_DECAY)
        second.mul_(SECOND_DECAY)
        second.addcmul_(gradient, gradient, value=1.0 - SECOND_DECAY)
        lasting.lerp_(gradient, 1.0 - _MEMORY)
        square = second / (1.0 - SECOND_DECAY**self._taken)
        mean = lasting / (1.0 - _MEMORY**self._taken)
        share = agreement(mean, square, self._taken)
        way = first * share / square.sqrt_().add_(1e-8)
        way *= -rate / (1.0 - FIRST_DECAY**self._taken)
        self._distances.index_add_(0, self._nodes, way)
