# SPDX-License-Identifier: Apache-2.0
"""Specular light of samples towards the cameras, from sky, bounces and suns.

Soft light is the incident light blurred about the mirror direction and scaled by the split-sum
reflectance; a sun is evaluated with the GGX lobe itself.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.lobes import sky_radiance
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.maths import microfacet
from robir.maths.vectors import normalise, orthonormal_frame
from robir.transport.observe import Observations
from robir.transport.surfels import Surfels
from robir.transport.visibility import towards_light
from robir.workers import blocks, side_by_side

Floats = NDArray[np.float32]

F0 = 0.04  # reflectance of dielectrics at normal incidence, Blender's default (IOR 1.45 to 1.5)

CHUNK = 1024  # rays at a time, whose cosines with all directions then stay in the processor's cache

# roughness below which a sun's highlight is narrower than the samples can tell
_SHARPEST_HIGHLIGHT = 0.12
# sharpness of the lobe about a mirror direction beyond which the sky's directions lie too far from
# each other
_SHARPEST_KERNEL = 200.0
# between normal and half vector, within which a view is near the mirror direction of a sun
_HIGHLIGHT_COSINE = 0.87
_LEAST_SUN = 0.1  # cosine times visibility of a sun below which it has no highlight
_TILT = 0.12  # of the normal that a highlight may need, as a tangent: about the mesh's error


@dataclass(frozen=True, slots=True)
class ViewRays:
    """Observations of some samples as a flat list."""

    sample: NDArray[np.int64]  # (M,) index into the rows, ascending
    view: NDArray[np.int64]  # (M,) view index
    view_dir: Tensor  # (M, 3) unit, towards the camera
    cosine: Tensor  # (M,) normal times view direction
    mirror: Tensor  # (M,) index of the direction nearest to the mirror direction

    def of(self, chosen: Tensor) -> ViewRays:
        """Those (N,) of the rays whose numbers are given."""
        sample, view = self.sample[chosen.numpy()], self.view[chosen.numpy()]
        parts = (self.view_dir, self.cosine, self.mirror)
        return ViewRays(sample, view, *(part[chosen] for part in parts))


def view_rays(
    surfels: Surfels, observations: Observations, rows: NDArray[np.int64], directions: Floats
) -> ViewRays:
    """All observations of samples `rows` (U,), one ray each; fixed unit `directions` (D, 3)."""
    sample, view = np.nonzero(observations.weight[rows] > 0)
    position, normal = surfels.position[rows][sample], surfels.normal[rows][sample]
    towards = observations.positions[view] - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return as_rays(sample, view, towards, normal, directions)


def as_rays(
    sample: NDArray[np.int64],
    view: NDArray[np.int64],
    view_dir: Floats,
    normal: Floats,
    directions: Floats,
) -> ViewRays:
    """Rays from samples (M,), ascending, to views (M,), with their nearest mirror directions.

    Of unit view directions, away from the surface, and normals (M, 3), and fixed directions (D, 3).
    """
    cosine = (view_dir * normal).sum(1).clip(0.02, 1)
    mirror = 2 * cosine[:, None] * normal - view_dir
    return ViewRays(
        sample,
        view,
        torch.from_numpy(view_dir.astype(np.float32)),
        torch.from_numpy(cosine.astype(np.float32)),
        torch.from_numpy(_nearest(mirror, directions)),
    )


def _nearest(towards: Floats, directions: Floats) -> NDArray[np.int64]:
    """Index (M,) of the nearest of fixed directions (D, 3), unit, to each vector (M, 3)."""
    found = side_by_side(
        lambda part: (towards[part] @ directions.T).argmax(1), blocks(len(towards), CHUNK)
    )
    return np.concatenate([np.zeros(0, np.int64), *found])


def reflected_share(rays: ViewRays, roughness: float) -> Tensor:
    """Share (M,) of even light that a dielectric's specular layer reflects towards each view.

    It does not reach the diffuse layer, as in Blender's Principled material.
    """
    scale, bias = microfacet.environment_brdf(rays.cosine, torch.full_like(rays.cosine, roughness))
    return F0 * scale + bias


def tilts_of() -> tuple[tuple[float, float], ...]:
    """Tilts of the normal, along two tangents, that are tried: none, and six about it."""
    around = np.arange(6) * np.pi / 3
    return ((0.0, 0.0), *((_TILT * np.cos(a), _TILT * np.sin(a)) for a in around))


@lru_cache
def _hear_of_beta() -> None:
    """Let torch say once, to nobody, that its sparse tensors are in beta; threads share filters."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.zeros(1, 1).to_sparse_csr()


def _product_at(
    tables: Sequence[Tensor], kernel: Tensor, place: tuple[NDArray[np.int64], Tensor]
) -> list[Tensor]:
    """Some entries (M,), at rising rows, of the products of tables and a symmetric kernel."""
    # the whole products take six times as long; they are made where more entries are wanted than a
    # sparse tensor holds
    row, column = place
    if len(row) > len(tables[0]) * len(kernel):
        return [(table @ kernel)[torch.from_numpy(row), column] for table in tables]
    starts = np.searchsorted(row, np.arange(len(tables[0]) + 1))

    def entries(rows: slice) -> list[Tensor]:
        own = slice(int(starts[rows.start]), int(starts[rows.stop]))
        wanted = torch.sparse_csr_tensor(
            torch.from_numpy(starts[rows.start : rows.stop + 1] - own.start),
            column[own],
            torch.zeros(own.stop - own.start),
            size=(rows.stop - rows.start, len(kernel)),
            check_invariants=False,
        )
        parts = (table[rows] for table in tables)
        return [
            torch.sparse.sampled_addmm(wanted, part, kernel, beta=0.0).values() for part in parts
        ]

    _hear_of_beta()
    found = side_by_side(entries, blocks(len(tables[0]), CHUNK) or [slice(0, 0)])
    return [torch.cat(parts) for parts in zip(*found, strict=True)]


def _radiance_of_surfaces(
    problem: Problem, rows: NDArray[np.int64]
) -> tuple[tuple[Tensor, ...], Tensor]:
    """Radiance (U, D) a channel that samples see of each other, and where a surface is seen."""
    # a mean over all blocked directions would pass for metal where a polished board mirrors a piece
    transport = problem.scene.transport
    directions, position = transport.visibility.directions, transport.surfels.position
    met = transport.visibility.bounce[rows].tocoo()
    towards = position[met.col] - position[rows[met.row]]
    # lengths do not change which direction is the nearest
    column = _nearest(towards, directions)
    shape = (len(rows), len(directions))
    place = torch.from_numpy(met.row.astype(np.int64) * len(directions) + column)

    def summed(values: Tensor) -> Tensor:
        return torch.zeros(shape[0] * shape[1]).index_add_(0, place, values).reshape(shape)

    count = summed(torch.ones(len(place)))
    exitant = problem.exitant[met.col]
    sums = (summed(exitant[:, channel]) for channel in range(3))
    return tuple(total / count.clamp(min=1) for total in sums), count > 0


class Reflections:
    """Light that reaches samples from around any mirror direction."""

    def __init__(self, problem: Problem, light: Light, rows: NDArray[np.int64]) -> None:
        scene = problem.scene
        visibility = scene.transport.visibility
        directions = torch.from_numpy(visibility.directions)
        sky = sky_radiance(directions, light.amplitudes.soft)
        normal = torch.from_numpy(scene.transport.surfels.normal[rows])
        bits = np.unpackbits(visibility.bits[rows], axis=1, count=len(directions))
        seen = torch.from_numpy(bits.astype(np.float32))
        cosine = (normal @ directions.T).clamp(min=0)
        blocked = (cosine > 0).float() - seen
        around = (blocked * cosine).sum(1) * (4 * np.pi / len(directions))
        # Where no ray tells the surface: the mean radiance that the bounce carries.
        bounced = problem.indirect[rows] / around.clamp(min=0.05)[:, None]
        surfaces, is_hit = _radiance_of_surfaces(problem, rows)
        self._directions = directions
        self._incident = [
            seen * sky[:, channel]
            + blocked * torch.where(is_hit, surfaces[channel], bounced[:, channel, None])
            for channel in range(3)
        ]
        self._above = (cosine > 0).float()
        self._seen = seen
        self._normal = normal
        self._light = light
        self._light_distance = scene.light_distance
        self._position = scene.transport.surfels.position[rows]
        self._sun = scene.sharp_transfer(light.axes, light.sharpness, rows)

    @property
    def tilts(self) -> tuple[tuple[float, float], ...]:
        """See `tilts_of`."""
        return tilts_of()

    def radiance(self, rays: ViewRays, roughness: float) -> Tensor:
        """Specular radiance (M, 2, 3): for F0 = 0.04, and per unit of a metal's base colour."""
        return self.from_sky(rays, roughness) + self.from_suns(rays, roughness)

    def from_sky(self, rays: ViewRays, roughness: float) -> Tensor:
        """The part (M, 2, 3) that soft lobes and bounces send."""
        tables = (*self._incident, self._above)
        kernel = self._kernel(roughness)
        *channels, mass = _product_at(tables, kernel, (rays.sample, rays.mirror))
        blurred = torch.stack(channels, 1) / mass.clamp(min=1e-6)[:, None]
        scale, bias = microfacet.environment_brdf(
            rays.cosine, torch.full_like(rays.cosine, roughness)
        )
        return torch.stack(
            [blurred * (F0 * scale + bias)[:, None], blurred * (scale + bias)[:, None]], 1
        )

    def _kernel(self, roughness: float) -> Tensor:
        """How much directions count about each mirror direction, (D, D)."""
        # Width of the GGX lobe about the mirror direction at a typical slant.
        alpha = microfacet.ggx_alpha_from_roughness(torch.tensor(roughness))
        sharpness = float(1 / (2 * alpha**2 * 0.75))
        sharpness = min(sharpness, _SHARPEST_KERNEL)
        return torch.exp(sharpness * (self._directions @ self._directions.T - 1))

    def near_highlight(self, rays: ViewRays) -> Tensor:
        """Numbers (N,) of the observations near the mirror direction of a sun that is seen."""
        sample = torch.from_numpy(rays.sample)
        near = torch.zeros(len(sample), dtype=torch.bool)
        for index in range(len(self._light.axes)):
            half = normalise(self._towards_sun(sample, index) + rays.view_dir)
            facing = (self._normal[sample] * half).sum(1) > _HIGHLIGHT_COSINE
            near |= facing & (self._sun[sample, index] > _LEAST_SUN)
        return near.nonzero()[:, 0]

    def _towards_sun(self, sample: Tensor, index: int) -> Tensor:
        """Unit directions (M, 3) of a sharp light from samples (M,)."""
        axis = self._light.axes[index]
        ray, _ = towards_light(self._position, axis, self._light_distance)
        return torch.from_numpy(np.broadcast_to(ray, self._position.shape).copy())[sample]

    def tilted(self, rays: ViewRays, tilt: tuple[float, float]) -> ViewRays:
        """The same rays mirrored by normals that are tilted along two tangents."""
        normal = self._normals(tilt)[rays.sample].numpy()
        return as_rays(
            rays.sample, rays.view, rays.view_dir.numpy(), normal, self._directions.numpy()
        )

    def _normals(self, tilt: tuple[float, float]) -> Tensor:
        """Normals (U, 3) tilted along two tangents."""
        first, second = orthonormal_frame(self._normal)
        return normalise(self._normal + tilt[0] * first + tilt[1] * second)

    def from_suns(
        self, rays: ViewRays, roughness: float, tilt: tuple[float, float] = (0.0, 0.0)
    ) -> Tensor:
        """The part (M, 2, 3) that sharp lobes send, with normals tilted along two tangents."""
        sample = torch.from_numpy(rays.sample)
        normal = self._normals(tilt)[sample]
        total = torch.zeros(len(sample), 2, 3)
        for index, sharpness in enumerate(self._light.sharpness):
            # About the half vector a sun is half as wide, and widths add as squares: a lobe of
            # sharpness s widens alpha^2 by 1 / (2 s).
            blurred = (roughness**4 + 0.5 / float(sharpness)) ** 0.25
            wide = torch.full_like(rays.cosine, max(blurred, _SHARPEST_HIGHLIGHT))
            axis = self._towards_sun(sample, index)
            arriving = self._sun[sample, index][:, None] * self._light.amplitudes.sharp[index]
            lobe = microfacet.specular_brdf(
                axis, rays.view_dir, normal, wide, torch.tensor([F0, 1.0])
            )
            total += lobe[:, :, None] * arriving[:, None]
        return total
