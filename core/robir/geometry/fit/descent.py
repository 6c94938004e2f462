# SPDX-License-Identifier: Apache-2.0
"""Steps of the distances: Adam's, shortened where the photographs contradict each other.

What the colours cannot follow, highlights above all, pushes the surface to and fro as rays come
and go. Adam makes steps of one length of strong and of weak gradients, so such pushes dig lumps
that nothing levels again. Here a node's step is as long as its gradients of many steps agree.
"""

from __future__ import annotations

import torch
from torch import Tensor

from robir.geometry.fit.config import DescentConfig
from robir.geometry.fit.regularise import smoothed
from robir.geometry.lattice import Lattice


def agreement(mean: Tensor, square: Tensor, taken: int, config: DescentConfig) -> Tensor:
    """How far gradients agree, as the share of a step that may be made.

    Args:
        mean: (K,) mean of `taken` gradients, weights decaying by `memory`, their sum 1.
        square: (K,) mean of their squares.
        taken: Number of gradients.
        config: Memory and doubt.

    Returns:
        (K,) in [0, 1]; one half where the squared mean is `doubt` times what random signs leave.
    """
    memory = config.memory
    left = memory**taken
    chance = (1.0 - memory) / (1.0 + memory) * (1.0 + left) / (1.0 - left)
    # nodes that no ray has met yet have no gradient
    odds = (mean.square() / (square * (config.doubt * chance)).clamp_(min=1e-30)).square_()
    return odds / (1.0 + odds)


class Descent:
    """Steps of the distances of one level.

    The gradient is smoothed first, so that the surface moves in patches rather than node by node
    (after Nicolet et al. 2021, "Large steps in inverse rendering of geometry").

    Args:
        distances: (N,) leaf that requires gradients.
        lattice: Its nodes.
        config: Decays, and what counts as agreement.
    """

    def __init__(self, distances: Tensor, lattice: Lattice, config: DescentConfig) -> None:
        self._distances, self._lattice = distances, lattice
        self._config = config
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
        config = self._config
        whole = smoothed(self._distances.grad, self._lattice, config.gradient_passes)
        gradient = whole.index_select(0, self._nodes)  # a third of the time of square brackets
        self._distances.grad = None
        self._taken += 1
        first, second, lasting = self._near
        first.lerp_(gradient, 1.0 - config.first_decay)
        second.mul_(config.second_decay)
        second.addcmul_(gradient, gradient, value=1.0 - config.second_decay)
        lasting.lerp_(gradient, 1.0 - config.memory)
        square = second / (1.0 - config.second_decay**self._taken)
        mean = lasting / (1.0 - config.memory**self._taken)
        share = agreement(mean, square, self._taken, config)
        way = first * share / square.sqrt_().add_(1e-8)
        way *= -rate / (1.0 - config.first_decay**self._taken)
        self._distances.index_add_(0, self._nodes, way)
