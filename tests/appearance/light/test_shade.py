# SPDX-License-Identifier: Apache-2.0
"""Which pairs across a shadow count, by hand-made samples."""

import numpy as np
import torch

from robir.appearance.light.sunlight import LIGHT_ERROR, irradiance_doubt, of_one_material, well_lit
from robir.appearance.photometry.statistics import Pairs

DEEP, OPEN = 60, 40


def shaded_pairs() -> tuple[Pairs, torch.Tensor, torch.Tensor]:
    """Samples in a gap, in open shade and in the sun, all of one material under a wrong light.

    That light is too strong in the gap and too weak in the open shade.

    Returns:
        Pairs of every shaded sample with a lit one, log albedo and irradiance of the samples.
    """
    lit = DEEP + OPEN
    log = torch.zeros(2 * lit, 3)
    log[:DEEP], log[DEEP:lit] = -0.5, 0.2
    irradiance = torch.full((2 * lit, 3), 2.0)
    irradiance[:DEEP], irradiance[DEEP:lit] = 0.1, 0.6
    first = torch.arange(lit)
    return (
        Pairs(first=first, second=first + lit, weight=torch.full((lit,), 1 / lit)),
        log,
        irradiance,
    )


def test_what_little_light_reaches_is_known_by_its_share_of_the_mean():
    irradiance = torch.tensor([[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]])
    mean = irradiance.numpy().mean()
    expected = [LIGHT_ERROR * mean / 2, LIGHT_ERROR * mean / 0.2]
    np.testing.assert_allclose(irradiance_doubt(irradiance), expected, rtol=1e-6)


def test_open_shade_tells_the_step_though_samples_in_gaps_are_more():
    pairs, log, irradiance = shaded_pairs()
    clipped = torch.zeros_like(log, dtype=torch.bool)
    told = of_one_material(well_lit([pairs], irradiance), log, clipped)
    assert float(told.weight[DEEP:].sum()) > 0.9
    even = of_one_material([pairs], log, clipped)
    assert float(even.weight[DEEP:].sum()) < 0.4


def test_another_material_hardly_counts():
    pairs, log, irradiance = shaded_pairs()
    log[DEEP] += 1.5
    clipped = torch.zeros_like(log, dtype=torch.bool)
    told = of_one_material(well_lit([pairs], irradiance), log, clipped)
    assert float(told.weight[DEEP]) < 0.01 * float(told.weight[DEEP + 1])
