# SPDX-License-Identifier: Apache-2.0
"""The environment as lobes that are fitted."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from robir.maths.spherical_gaussian import SphericalGaussians, unit_integral
from robir.maths.vectors import fibonacci_sphere, normalise

START_ENERGY = 1.6 * math.pi  # integral of the light over the sphere at the start, per channel


class EnvironmentLight(nn.Module):
    """Lobes with seven free numbers each: axis, log sharpness, amplitude made positive (PhySG).

    The start: every direction of a Fibonacci spread twice, sharpness 10 + 20 |normal|, grey, scaled
    to a given energy.
    """

    def __init__(self, num_lobes: int, generator: torch.Generator) -> None:
        """Make it.

        Args:
            num_lobes: K, even.
            generator: Of the sharpness and the amplitudes.
        """
        super().__init__()
        axis = fibonacci_sphere(num_lobes // 2).repeat(2, 1)
        sharpness = 10.0 + 20.0 * torch.randn(num_lobes, generator=generator).abs()
        amplitude = torch.randn(num_lobes, 1, generator=generator).abs().expand(-1, 3)
        energy = (amplitude * unit_integral(sharpness)[:, None]).sum(dim=0)
        self._axis = nn.Parameter(axis)
        # A rate that suits unit axes would barely move a sharpness of 30.
        self._log_sharpness = nn.Parameter(sharpness.log())
        self._amplitude = nn.Parameter(amplitude * START_ENERGY / energy)

    def lobes(self) -> SphericalGaussians:
        """The lobes, K of them."""
        return SphericalGaussians(
            axis=normalise(self._axis),
            sharpness=self._log_sharpness.exp(),
            amplitude=self._amplitude.abs(),
        )


class Surface(nn.Module):
    """Reflectance at normal incidence, one number for the scene, from 0.05 on."""

    def __init__(self) -> None:
        """Start."""
        super().__init__()
        self._f0 = nn.Parameter(torch.tensor(0.05))

    def f0(self) -> Tensor:
        """Reflectance (), at least 0."""
        return self._f0.abs()
