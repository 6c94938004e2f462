# SPDX-License-Identifier: Apache-2.0
"""Specular reflection: GGX microfacets with height-correlated shadowing.

    f_s = D(h) F(o.h) V(n.i, n.o),    ggx_alpha = roughness ** 2 as in Blender's Principled,
    D(h) = a^2 / (pi ((n.h)^2 (a^2 - 1) + 1)^2),
    V = G2 / (4 n.i n.o) = 1/2 / (n.i s(n.o) + n.o s(n.i)),  s(c) = sqrt(c^2 (1 - a^2) + a^2),
    F = F0 + (1 - F0) (1 - o.h)^5.

Directions are unit and point away from the surface, world space. D and G2 are those of Cycles'
GGX. Two things differ from its Principled material: Cycles evaluates the dielectric Fresnel
equations where this takes Schlick's fit, and its default "Multiscatter GGX" gives back the energy
that single scattering loses on rough surfaces.

References:
    Walter et al., Microfacet Models for Refraction, EGSR 2007 (D); Heitz, Understanding the
    Masking-Shadowing Function, JCGT 3(2), 2014, Eq. 99 (G2); Schlick, EG 1994 (F).
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from robir.maths.vectors import dot, normalise

# Narrower than this, D overflows what float32 can square; it is a mirror to any camera.
_SMALLEST_ALPHA = 1e-3
_SMALLEST_COSINE = 1e-4
_TABLE_NODES = 33
_TABLE_STRATA = 64


def ggx_alpha_from_roughness(roughness: Tensor) -> Tensor:
    """GGX width roughness ** 2, kept above 0.001."""
    return (roughness * roughness).clamp_min(_SMALLEST_ALPHA)


def ggx_distribution(cosine_half: Tensor, roughness: Tensor) -> Tensor:
    """Density D of microfacet normals, per steradian; D times n.h integrates to 1."""
    square = ggx_alpha_from_roughness(roughness) ** 2
    # 1 - c^2 + c^2 a^2 rather than c^2 (a^2 - 1) + 1: the same, without cancelling at the peak.
    cosine = cosine_half.clamp(0.0, 1.0)
    denominator = (1.0 - cosine) * (1.0 + cosine) + cosine * cosine * square
    return square / (math.pi * denominator * denominator)


def smith_visibility(cosine_light: Tensor, cosine_view: Tensor, roughness: Tensor) -> Tensor:
    """Height-correlated Smith G2 over 4 n.i n.o, for both cosines above 0."""
    square = ggx_alpha_from_roughness(roughness) ** 2
    light = cosine_light * torch.sqrt(cosine_view * cosine_view * (1.0 - square) + square)
    view = cosine_view * torch.sqrt(cosine_light * cosine_light * (1.0 - square) + square)
    return 0.5 / (light + view).clamp_min(1e-12)


def schlick_weight(cosine: Tensor) -> Tensor:
    """Share of the step from F0 to 1, (1 - cosine)^5."""
    return (1.0 - cosine).clamp(0.0, 1.0) ** 5


def schlick_fresnel(cosine: Tensor, f0: Tensor) -> Tensor:
    """Reflectance at a cosine of the angle to the half vector; f0 broadcasts."""
    weight = schlick_weight(cosine)
    return f0 + (1.0 - f0) * weight


def specular_brdf(
    light_dir: Tensor, view_dir: Tensor, normal: Tensor, roughness: Tensor, f0: Tensor
) -> Tensor:
    """GGX reflection (..., C) per steradian, without the cosine of the light.

    Of directions and normals (..., 3), roughness (...) in 0..1 and reflectance at normal incidence
    f0 (..., C); 0 where the light or the camera is below the surface.
    """
    half = normalise(light_dir + view_dir)
    cosine_light, cosine_view = dot(normal, light_dir), dot(normal, view_dir)
    is_lit = (cosine_light > 0.0) & (cosine_view > 0.0)
    distribution = ggx_distribution(dot(normal, half), roughness)
    visibility = smith_visibility(
        cosine_light.clamp_min(_SMALLEST_COSINE), cosine_view.clamp_min(_SMALLEST_COSINE), roughness
    )
    fresnel = schlick_fresnel(dot(view_dir, half)[..., None], f0)
    value = torch.where(is_lit, distribution * visibility, torch.zeros_like(cosine_light))
    return fresnel * value[..., None]


def environment_brdf(cosine_view: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """Reflectance under uniform light, split as f0 * scale + bias; their sum is at most 1.

    By cosines n.o and roughness that broadcast, from a 33 x 33 table within 0.003 of the integral
    of f_s n.i (Karis, Real Shading in Unreal Engine 4, SIGGRAPH course 2013).
    """
    table = _environment_table().to(cosine_view)
    cosine_view, roughness = torch.broadcast_tensors(cosine_view, roughness)
    # Nodes run evenly in the square root of the cosine: the table bends most at grazing views.
    row = roughness.clamp(0.0, 1.0) * (_TABLE_NODES - 1)
    column = cosine_view.clamp(1e-8, 1.0).sqrt() * (_TABLE_NODES - 1)
    i = row.detach().floor().clamp(max=_TABLE_NODES - 2).long()
    j = column.detach().floor().clamp(max=_TABLE_NODES - 2).long()
    f, g = (row - i)[..., None], (column - j)[..., None]
    low = table[i, j] * (1.0 - g) + table[i, j + 1] * g
    high = table[i + 1, j] * (1.0 - g) + table[i + 1, j + 1] * g
    scale, bias = (low * (1.0 - f) + high * f).unbind(-1)
    return scale, bias


@functools.cache
def _environment_table() -> Tensor:
    """Scale and bias (roughness, sqrt cosine, 2) by samples of the visible normals."""
    # Heitz, Sampling the GGX Distribution of Visible Normals, JCGT 7(4), 2018, listing 1
    stratum = (torch.arange(_TABLE_STRATA, dtype=torch.float64) + 0.5) / _TABLE_STRATA
    u1, u2 = (grid.reshape(-1) for grid in torch.meshgrid(stratum, stratum, indexing="ij"))
    node = torch.linspace(0.0, 1.0, _TABLE_NODES, dtype=torch.float64)
    cosine = (node * node).clamp_min(_SMALLEST_COSINE)[:, None]
    rows = []
    for roughness in node:
        alpha = ggx_alpha_from_roughness(roughness)
        x, z = alpha * torch.sqrt(1.0 - cosine * cosine), cosine
        length = torch.sqrt(x * x + z * z)
        x, z = x / length, z / length
        # Stretched view (x, 0, z); tangents (0, 1, 0) and (-z, 0, x).
        t1 = u1.sqrt() * torch.cos(2.0 * math.pi * u2)
        t2 = u1.sqrt() * torch.sin(2.0 * math.pi * u2)
        bend = 0.5 * (1.0 + z)
        t2 = (1.0 - bend) * torch.sqrt((1.0 - t1 * t1).clamp_min(0.0)) + bend * t2
        t3 = torch.sqrt((1.0 - t1 * t1 - t2 * t2).clamp_min(0.0))
        half = torch.stack(
            [
                alpha * (-z * t2 + x * t3),
                alpha * t1.expand_as(t2),
                (x * t2 + z * t3).clamp_min(1e-12),
            ],
            dim=-1,
        )
        half = normalise(half)
        cosine_half = torch.sqrt(1.0 - cosine * cosine) * half[..., 0] + cosine * half[..., 2]
        light = 2.0 * cosine_half * half[..., 2] - cosine
        square = alpha * alpha
        shadow = torch.sqrt(cosine * cosine * (1.0 - square) + square)
        # G2 / G1 with G1 = 2 n.o / (n.o + s(n.o)).
        ratio = 2.0 * light * smith_visibility(light.clamp_min(1e-9), cosine, roughness)
        ratio = torch.where(light > 0.0, ratio * (cosine + shadow), torch.zeros_like(light))
        weight = schlick_weight(cosine_half)
        parts = [((1.0 - weight) * ratio).mean(-1), (weight * ratio).mean(-1)]
        rows.append(torch.stack(parts, dim=-1))
    return torch.stack(rows)
