# SPDX-License-Identifier: Apache-2.0
"""Adam over a handful of tensors, each with a rate of its own.

By the step of `torch.optim.adam`, whose class loads torch's compiler and cannot exchange a tensor.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Kingma and Ba 2015, "Adam: a method for stochastic optimization", algorithm 1.

    `betas` are the decays of the first and of the second moment.
    """

    def __init__(self, parameters: Sequence[Tensor], betas: tuple[float, float]) -> None:
        self._parameters = list(parameters)
        self._betas = betas
        self._first = [torch.zeros_like(values) for values in parameters]
        self._second = [torch.zeros_like(values) for values in parameters]
        self._taken = [torch.zeros((), device=values.device) for values in parameters]

    def replace(self, index: int, values: Tensor, old_rows: Tensor) -> None:
        """Exchange parameter `index` for one with other rows, whose moments go along.

        `old_rows` (N,) is the old row of each new one, 0 for rows without a past.
        """
        fresh = (old_rows == 0).view(-1, *[1] * (values.ndim - 1))
        for moments in (self._first, self._second):
            moments[index] = torch.where(fresh, 0.0, moments[index][old_rows.long()])
        self._parameters[index] = values

    @torch.no_grad()
    def step(self, rates: Sequence[float]) -> None:
        """Move every parameter by its gradient at its rate, and forget the gradients."""
        begin = 0
        for end in range(1, len(rates) + 1):
            if end < len(rates) and rates[end] == rates[begin]:
                continue
            part = slice(begin, end)
            chosen = self._parameters[part]
            gradients = [values.grad for values in chosen]
            assert all(gradient is not None for gradient in gradients)
            adam(
                chosen,
                gradients,  # pyright: ignore[reportArgumentType]
                self._first[part],
                self._second[part],
                [],
                self._taken[part],
                fused=True,
                amsgrad=False,
                beta1=self._betas[0],
                beta2=self._betas[1],
                lr=rates[begin],
                weight_decay=0.0,
                eps=1e-8,
                maximize=False,
            )
            begin = end
        for values in self._parameters:
            values.grad = None
