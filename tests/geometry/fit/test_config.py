# SPDX-License-Identifier: Apache-2.0
"""What is set of the fit reaches it."""

from __future__ import annotations

import pytest
import torch

from robir.config import RunConfig, resolve
from robir.errors import ConfigError
from robir.geometry.fit.config import OptimiseConfig
from robir.geometry.fit.optimise import smooth
from robir.geometry.lattice import Lattice


def smoothed(config: OptimiseConfig) -> torch.Tensor:
    lattice = Lattice(lower=(0.0, 0.0, 0.0), cell=1.0, shape=(7, 7, 7))
    values = torch.zeros(lattice.count)
    values[lattice.count // 2] = 1.0
    smooth(values, lattice, 0.0, config)
    return values


def test_a_setting_of_the_fit_changes_what_it_does() -> None:
    words = ["geometry.fit.optimise.smoothing=0", "geometry.fit.optimise.fairing=0.0"]
    still = resolve(RunConfig(), None, words).geometry.fit.optimise
    assert (still.smoothing, still.fairing) == (0.0, 0.0)
    assert smoothed(still).count_nonzero() == 1
    assert smoothed(OptimiseConfig()).count_nonzero() > 1


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("geometry.fit.mirror_pits.dull=0.05", "mirror_pits.dull is 0.05; it must be below"),
        ("geometry.fit.mirror_pits.proven_mirroring=0.01", "proven_dull is 0.018"),
        ("geometry.fit.sampling.block=0", "it must be in 1 .. 16 cells"),
    ],
)
def test_what_no_step_can_work_with_is_refused(assignment: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        resolve(RunConfig(), None, [assignment])
