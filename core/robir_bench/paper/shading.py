# SPDX-License-Identifier: Apache-2.0
"""RobIR's rendering in lobes: what leaves a point towards the camera, lobe by lobe.

    e = sum_k eta_k mu_k (albedo / pi D_k + S_k),

with D_k the irradiance of a lobe of unit amplitude and S_k its mirror-like reflection. The product
of a lobe with the clamped cosine is integrated by `robir.maths`, at 0.8 % of the lobe's energy at
worst, in place of the paper's difference of two hemisphere integrals (1 %).

Batch letters: P points, K lobes.

References:
    RobIR Eq. 11 and App. B; Wang et al., All-Frequency Rendering, SIGGRAPH Asia 2009 (the lobe of
    the NDF and its warp); Karis 2013 (F, G).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from robir.maths.spherical_gaussian import (
    SphericalGaussians,
    cosine_shares,
    lobe_shapes,
    product,
    unit_integral,
)
from robir.maths.vectors import dot, normalise, reflect

_SMALLEST_COSINE = 1e-2


def diffuse_transfer(axis: Tensor, sharpness: Tensor, normal: Tensor) -> Tensor:
    """Irradiance (P, K) of lobes of unit amplitude.

    Args:
        axis: (K, 3) or (P, K, 3).
        sharpness: (K,) or (P, K).
        normal: (P, 3).
    """
    cosine = dot(axis, normal[:, None])
    return cosine_shares(sharpness, cosine) * unit_integral(sharpness)


def specular_transfer(
    axis: Tensor, sharpness: Tensor, frame: tuple[Tensor, Tensor], roughness: Tensor, f0: Tensor
) -> Tensor:
    """Reflection (P, K) of lobes of unit amplitude towards the camera.

    Args:
        axis: (K, 3) or (P, K, 3).
        sharpness: (K,) or (P, K).
        frame: Normals (P, 3) and directions to the camera (P, 3).
        roughness: (P,), as in Blender.
        f0: (), reflectance at normal incidence.
    """
    normal, view_dir = frame
    lobe = warped_ndf(normal, view_dir, roughness, f0)
    one = torch.ones_like(sharpness)[..., None]
    joined = product(SphericalGaussians(axis, sharpness, one), lobe)
    shares = cosine_shares(joined.sharpness, dot(joined.axis, normal[:, None]))
    return shares * unit_integral(joined.sharpness) * joined.amplitude[..., 0]


def warped_ndf(
    normal: Tensor, view_dir: Tensor, roughness: Tensor, f0: Tensor
) -> SphericalGaussians:
    """The BRDF's specular part as one lobe over light directions: (P, 1) of them.

    The distribution of half vectors D(h) = G(h; n, 2 / r^4, 1 / (pi r^4)), warped about the mirror
    direction, times F G / (4 n.o n.i) as it is there. The programs' amplitude is twice this one,
    whose integral is 1.
    """
    fourth = roughness**4
    cosine = dot(normal, view_dir).clamp_min(_SMALLEST_COSINE)
    mirror = normalise(reflect(view_dir, normal))
    half = normalise(mirror + view_dir)
    x = dot(view_dir, half).clamp_min(0.0)
    fresnel = f0 + (1.0 - f0) * 2.0 ** (-(5.55473 * x + 6.8316) * x)
    k = (roughness + 1.0) ** 2 / 8.0
    # n.i is n.o at the mirror direction.
    shadowing = (cosine / (cosine * (1.0 - k) + k)) ** 2
    moderate = fresnel * shadowing / (4.0 * cosine * cosine)
    return SphericalGaussians(
        axis=mirror[:, None],
        sharpness=((2.0 / fourth) / (4.0 * cosine))[:, None],
        amplitude=(moderate / (math.pi * fourth))[:, None, None],
    )


def visibility_ratio(light: SphericalGaussians, directions: Tensor, visibility: Tensor) -> Tensor:
    """Share eta (P, K) of each lobe that points see.

    Args:
        light: K lobes.
        directions: (D, 3), evenly spread over the sphere.
        visibility: (P, D), 0 below the horizon.
    """
    weight = lobe_shapes(light, directions)
    return visibility @ (weight / weight.sum(dim=0).clamp_min(1e-20))


def exitant_radiance(transfer: tuple[Tensor, Tensor], amplitude: Tensor, albedo: Tensor) -> Tensor:
    """Radiance (P, 3), linear, of diffuse and specular transfer (P, K), already times visibility.

    Args:
        transfer: Diffuse and specular.
        amplitude: (K, 3) or (P, K, 3), linear.
        albedo: (P, 3), linear.
    """
    diffuse, specular = (torch.matmul(part[:, None], amplitude)[:, 0] for part in transfer)
    return albedo / math.pi * diffuse + specular
