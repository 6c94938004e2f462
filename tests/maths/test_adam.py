# SPDX-License-Identifier: Apache-2.0
"""Adam against torch's own class, and a parameter exchanged on the way."""

from __future__ import annotations

import subprocess
import sys

import torch
from torch import Tensor

from robir.maths.adam import Adam

BETAS = (0.9, 0.98)


def _leaves() -> list[Tensor]:
    generator = torch.Generator().manual_seed(3)
    shapes = ((7, 2), (5,), (4, 3))
    return [torch.randn(shape, generator=generator).requires_grad_() for shape in shapes]


def _loss(leaves: list[Tensor]) -> Tensor:
    return sum(((values - 0.3 * index) ** 4).sum() for index, values in enumerate(leaves))  # type: ignore[return-value]


def test_steps_are_those_of_torchs_class() -> None:
    ours, theirs = _leaves(), _leaves()
    rates = (0.1, 0.02, 0.02)
    adam = Adam(ours, BETAS)
    reference = torch.optim.Adam(
        [{"params": [values], "lr": rate} for values, rate in zip(theirs, rates, strict=True)],
        betas=BETAS,
    )
    for _ in range(20):
        _loss(ours).backward()
        adam.step(rates)
        reference.zero_grad()
        _loss(theirs).backward()
        reference.step()
    for left, right in zip(ours, theirs, strict=True):
        assert left.grad is None
        torch.testing.assert_close(left, right, rtol=1e-5, atol=1e-6)


def test_rows_keep_their_moments_when_a_parameter_is_exchanged() -> None:
    """Rows 3 and 1 of the old leaf go on as if nothing had happened; a new row starts afresh."""
    kept, changed = _leaves()[2], _leaves()[2]
    whole, part = Adam([kept], BETAS), Adam([changed], BETAS)
    for _ in range(5):
        for leaf, adam in ((kept, whole), (changed, part)):
            ((leaf - 1) ** 4).sum().backward()
            adam.step((0.1,))
    rows = torch.tensor([0, 3, 1])
    exchanged = changed.detach()[rows].requires_grad_()
    part.replace(0, exchanged, rows)
    before = exchanged.detach().clone()
    for leaf, adam in ((kept, whole), (exchanged, part)):
        ((leaf - 1) ** 4).sum().backward()
        adam.step((0.1,))
    torch.testing.assert_close(exchanged[1:], kept[rows[1:]])
    # Without a past the moments hold this gradient alone, corrected as after six steps.
    first = (1 - BETAS[0]) / (1 - BETAS[0] ** 6)
    second = ((1 - BETAS[1]) / (1 - BETAS[1] ** 6)) ** 0.5
    expected = before[0] - 0.1 * first / second * torch.sign(before[0] - 1)
    torch.testing.assert_close(exchanged[0], expected, rtol=1e-4, atol=1e-5)


def test_the_compiler_stays_unloaded() -> None:
    """The class of torch would load it: seconds for nothing."""
    words = (
        "import sys, torch; from robir.maths.adam import Adam; "
        "x = torch.ones(3, requires_grad=True); a = Adam([x], (0.9, 0.99)); "
        "(x * x).sum().backward(); a.step((0.1,)); sys.exit('torch._dynamo' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0
