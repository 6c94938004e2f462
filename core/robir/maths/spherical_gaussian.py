# SPDX-License-Identifier: Apache-2.0
"""Spherical Gaussians: sums of lobes that carry radiance over directions.

One lobe is G(w) = amplitude * exp(sharpness * (w . axis - 1)). Batch letters: K lobes, C channels;
leading axes of directions and normals are free. Everything is safe from overflow for sharpness
from 1e-3 up to 1e6 in float32.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from robir.maths.vectors import dot, equirect_directions, equirect_solid_angles

_SUBPIXELS = 4
# Sharpness times squared pixel height from which pixel centres alone miss the shape of a lobe.
_SHARP = 0.1
# Exponent below which exp vanishes next to 1 even among the smallest float32.
_NOTHING = 110.0


@dataclass(frozen=True, slots=True)
class SphericalGaussians:
    """A mixture of lobes."""

    axis: Tensor  # (K, 3), unit, world, towards the light
    sharpness: Tensor  # (K,), above 0; about 1 / sharpness is the squared width in radians
    amplitude: Tensor  # (K, C), radiance on the axis, linear


def lobe_shapes(lobes: SphericalGaussians, direction: Tensor) -> Tensor:
    """Lobes of unit amplitude at unit directions (..., 3); (..., K), 1 on the axis."""
    return torch.exp(lobes.sharpness * (direction @ lobes.axis.transpose(-1, -2) - 1.0))


def evaluate(lobes: SphericalGaussians, direction: Tensor) -> Tensor:
    """Radiance (..., C) of the whole mixture at unit directions (..., 3)."""
    return lobe_shapes(lobes, direction) @ lobes.amplitude


def product(first: SphericalGaussians, second: SphericalGaussians) -> SphericalGaussians:
    """Lobe by lobe product, again a lobe, exact; the two broadcast over their leading axes.

    With r the smaller and s the larger sharpness, q = r / s and l = |q x_r + x_s|, the product has
    sharpness s l and amplitude m_r m_s exp(s (l - q - 1)). The exponent is formed from the
    difference of the axes, so equal and opposite sharp lobes keep their digits.
    """
    total = first.sharpness + second.sharpness
    summed = first.sharpness[..., None] * first.axis + second.sharpness[..., None] * second.axis
    length = torch.linalg.vector_norm(summed, dim=-1)
    # |u|^2 = (a + b)^2 - a b |x - y|^2, hence |u| - a - b = -a b |x - y|^2 / (|u| + a + b).
    gap = first.axis - second.axis
    exponent = -first.sharpness * second.sharpness * dot(gap, gap) / (length + total)
    return SphericalGaussians(
        axis=summed / length.clamp_min(1e-12)[..., None],
        sharpness=length,
        amplitude=first.amplitude * second.amplitude * torch.exp(exponent)[..., None],
    )


def unit_integral(sharpness: Tensor) -> Tensor:
    """Integral over the sphere of a lobe of unit amplitude, in steradian."""
    return -2.0 * math.pi * torch.expm1(-2.0 * sharpness) / sharpness


def integral(lobes: SphericalGaussians) -> Tensor:
    """Integral of every lobe over the whole sphere (K, C), radiance times steradian; exact."""
    return lobes.amplitude * unit_integral(lobes.sharpness)[..., None]


def amplitude_from_irradiance(sharpness: Tensor, irradiance: Tensor) -> Tensor:
    """Amplitude (K, C) of lobes whose integrals over the sphere are given (K, C).

    For a sharp lobe that is the irradiance of a surface that faces it, as of a sun lamp.
    """
    return irradiance / unit_integral(sharpness)[..., None]


def mean_cosine(sharpness: Tensor) -> Tensor:
    """Length of a lobe's mean direction, coth(s) - 1 / s, from 0 to 1."""
    series = sharpness * (1.0 / 3.0 - sharpness * sharpness / 45.0)
    large = sharpness.clamp_min(0.1)
    return torch.where(sharpness < 0.1, series, 1.0 / torch.tanh(large) - 1.0 / large)


def cosine_shares(sharpness: Tensor, cosine: Tensor) -> Tensor:
    """Irradiance of a lobe on a surface, as a share of the lobe's integral; differentiable.

    The height w . n is taken as normal, with the lobe's exact mean, and its variance scaled so that
    the share is exact at a grazing axis (I1(s) / (2 sinh s)); an even term in the cosine makes it
    exact at zenith and nadir. Off by at most 0.8 % of the integral. Sharpness and cosine, axis
    times normal, broadcast.
    """
    mean_length = mean_cosine(sharpness)
    full = -torch.expm1(-2.0 * sharpness)
    grazing = torch.special.i1e(sharpness) / full
    # The variance at a grazing axis is mean_length / sharpness.
    spread = 2.0 * math.pi * grazing * grazing * sharpness / mean_length

    def gaussian(c: Tensor) -> Tensor:
        square = c * c
        along = 1.0 - 2.0 * mean_length / sharpness - mean_length * mean_length
        variance = square * along.clamp_min(0.0) + (1.0 - square) * mean_length / sharpness
        deviation = torch.sqrt((spread * variance).clamp_min(1e-14))
        mean = mean_length * c
        ratio = mean / deviation
        tail = 0.5 * torch.erfc(-ratio / math.sqrt(2.0))
        density = torch.exp(-0.5 * ratio * ratio) / math.sqrt(2.0 * math.pi)
        return mean * tail + deviation * density

    zenith = (1.0 + torch.expm1(-sharpness) / sharpness) / full
    missing = zenith - gaussian(torch.ones_like(sharpness))
    return (gaussian(cosine) + missing * cosine * cosine).clamp_min(0.0)


def irradiance(lobes: SphericalGaussians, normal: Tensor) -> Tensor:
    """Irradiance (..., K, C) of every lobe on normals (..., 3), unit, without occlusion.

    The integral of the lobe times max(w . n, 0); see cosine_shares for the error.
    """
    shares = cosine_shares(lobes.sharpness, normal @ lobes.axis.transpose(-1, -2))
    return shares[..., None] * integral(lobes)


def to_equirect(lobes: SphericalGaussians, height: int) -> Tensor:
    """Lat-long map (H, 2H, C), linear, in Blender's World frame, row 0 at +Z.

    Wide lobes are sampled at pixel centres, sharp ones at 4 x 4 points a pixel; each is scaled to
    its integral. A lobe that falls between all points goes to the nearest.
    """
    image = lobes.axis.new_zeros(height, 2 * height, lobes.amplitude.shape[-1])
    for axis, sharpness, energy in zip(lobes.axis, lobes.sharpness, integral(lobes), strict=True):
        is_sharp = float(sharpness) * (math.pi / height) ** 2 > _SHARP
        rows, power = _splatted(axis, sharpness, height, _SUBPIXELS if is_sharp else 1)
        angles = equirect_solid_angles(height, rows=rows, dtype=image.dtype, device=image.device)
        image[rows] += (power / angles)[..., None] * energy
    return image


def _splatted(axis: Tensor, sharpness: Tensor, height: int, parts: int) -> tuple[slice, Tensor]:
    """Rows that a lobe (3,) reaches in a map, and its integral's share (rows, 2H) in each pixel."""
    fine = height * parts
    # beyond this angle the lobe is less than the smallest float32
    reach = math.sqrt(2.0 * _NOTHING / float(sharpness)) + 2.0 * math.pi / fine
    middle = math.acos(max(-1.0, min(1.0, float(axis[2]))))
    low = max(0, math.floor((middle - reach) / math.pi * height))
    high = min(height, math.ceil((middle + reach) / math.pi * height))
    rows = slice(parts * low, parts * high)
    options = {"rows": rows, "dtype": axis.dtype, "device": axis.device}
    # |w - x|^2 / 2 = 1 - w . x, but keeps its digits for lobes much sharper than a pixel.
    gap = equirect_directions(fine, **options) - axis
    exponent = -0.5 * sharpness * dot(gap, gap)
    power = torch.exp(exponent - exponent.max()) * equirect_solid_angles(fine, **options)
    power = power / power.sum()
    return slice(low, high), power.view(high - low, parts, 2 * height, parts).sum(dim=(1, 3))
