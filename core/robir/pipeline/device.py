# SPDX-License-Identifier: Apache-2.0
"""Chooses the device and the number of threads that torch works with."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

from robir.errors import DeviceError


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """What a run works with; no part of any fingerprint.

    Attributes:
        device: Torch device, "cpu" or "cuda".
        threads: Threads of one torch operation.
    """

    device: str
    threads: int


def choose_execution(asked: Literal["cpu", "cuda", "auto"], threads: int | None) -> Execution:
    """The device to work on; also sets the number of threads.

    Args:
        asked: "auto" takes a CUDA device where there is one.
        threads: Threads of one torch operation; None takes all cores.

    Raises:
        DeviceError: If CUDA is asked for and there is none.
    """
    import torch

    torch.set_num_threads(threads or os.cpu_count() or 1)
    has_cuda = torch.cuda.is_available()
    if asked == "cuda" and not has_cuda:
        raise DeviceError("torch finds no CUDA device; use --device cpu, or install torch for CUDA")
    device = "cuda" if has_cuda and asked != "cpu" else "cpu"
    return Execution(device=device, threads=torch.get_num_threads())
