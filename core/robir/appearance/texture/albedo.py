# SPDX-License-Identifier: Apache-2.0
"""Albedo per texel, read from the photographs under the solved light, step by step.

Every texel is projected into the photographs, its radiance divided by its own irradiance: soft
light and bounces vary slowly and come from the samples, the suns are traced per texel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import SUN_RAY_PAIRS, Problem
from robir.appearance.light.solver import Light
from robir.appearance.light.sunlight import irradiance_doubt
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.photometry.statistics import (
    display_mean,
    linear_observations,
    texture_weights,
    weighted_radiance,
)
from robir.appearance.texture.residual_shading import Surroundings, most_albedo, with_normals
from robir.appearance.texture.shadow_edges import (
    Reference,
    ShadowBorders,
    fill_clipped,
    solve_shadow_edges,
)
from robir.appearance.texture.texels import (
    MAX_ALBEDO,
    MIN_ALBEDO,
    NORMAL_SCALE,
    Blend,
    TexelAlbedo,
    Texels,
    sun_transfer,
)
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.steps import Pipeline, Step
from robir.transport.observe import Observations, observe
from robir.workers import num_workers

Floats = NDArray[np.float32]

LARGEST = 1.0  # from here on the albedo is unknown; code 255 of uncertainty.png

_FLOOR = 0.22  # what every texel has: light that is wrong makes whole sides of a thing wrong alike
_SPREAD = 6.9  # factor of the standard error of the views about a texel's brightness
_CHANGED = 3.8  # factor of how far albedo lay off its surroundings
_FEW = 0.3  # error by one view; falls with the square root of their number
# of a texel that no view shows, per unit frame to the nearest seen one. Assumed, not calibrated:
# test views hardly show what no training view does.
_DISTANCE = 14.0


def standard_error(
    spread: Floats, changed: Floats, count: NDArray[np.integer[Any]], distance: Floats
) -> Floats:
    """One standard error (N,) of log albedo, float32 in [floor, LARGEST].

    The causes of an error hardly depend on each other, so their variances add. `spread` (N,) is the
    standard error over the views of the log of a texel's brightness, `changed` (N,) the absolute
    change of log albedo by smoothing, mean over channels, `count` (N,) the views that show it,
    `distance` (N,) that to the nearest texel that a view shows, unit frame. Factors were fitted so
    that the bands hold 90 % of the texels of captures with known albedo (docs/uncertainty.md).
    """
    variance = _FLOOR**2 + (_SPREAD * spread) ** 2 + (_CHANGED * changed) ** 2
    variance = variance + _FEW**2 / np.maximum(count, 1)
    variance = variance + (_DISTANCE * distance) ** 2
    return np.minimum(np.sqrt(variance), LARGEST).astype(np.float32)


def distance_to_seen(position: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Distance of every point (N, 3) to the nearest that is seen.

    Infinite if none is, and from where it alone makes an albedo unknown: these cost most.
    """
    distance = np.where(seen, 0.0, np.inf).astype(np.float32)
    if seen.any() and not seen.all():
        tree = cKDTree(position[seen])
        reach = LARGEST / _DISTANCE
        distance[~seen] = tree.query(
            position[~seen], eps=0.1, distance_upper_bound=reach, workers=num_workers()
        )[0]
    return distance


# every so manieth texel stands for its neighbours where texels are compared with each other or
# normals are turned: the atlas is finer than photographs and mesh
_STEP = 4
_LEAST_DIFFUSE = 0.1  # least share of a texel's radiance that is the paint's below a specular layer
_DIM_SHARE = 0.02  # irradiance that hardly tells albedo, over the mean of all texels
_VIEW_ERROR = 0.05  # error of log albedo that all views have in common
_EDGE_ERROR = 0.25  # the same at a shadow's edge
# error of the specular light that is subtracted, over itself: little is known of a dark material in
# the shade, most of whose light is reflected
_SPECULAR_ERROR = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelMaterial:
    """What is known of the texels beside their albedo, from the surface samples."""

    floor: Floats  # (N, 3) radiance that a specular layer adds to every view
    kept: Floats  # (N, 3) share of the light that enters the diffuse layer below it
    metal: Floats  # (N, 3) base colour where it is metal
    metallic: NDArray[np.bool_]  # (N,) bool
    roughness: Floats  # (N,) float32

    @classmethod
    def of(cls, specular: SpecularMaterial, blend: Blend) -> TexelMaterial:
        """Values of the samples between which the texels lie."""
        return cls(
            floor=blend(torch.from_numpy(specular.floor)),
            kept=blend(torch.from_numpy(specular.kept)),
            metal=blend(torch.from_numpy(specular.metal)),
            metallic=blend(torch.from_numpy(specular.metallic)[:, None])[:, 0] > 0.5,
            roughness=blend(torch.from_numpy(specular.roughness)[:, None])[:, 0],
        )


@dataclass(frozen=True, kw_only=True)
class LitTexels:
    """Texels with what photographs show of them and what arrives there, whatever their material."""

    problem: Problem  # scene under the chosen tone curve
    light: Light  # solved light
    texels: Texels  # points of the atlas
    blend: Blend  # of values of the surface samples
    seen: Observations  # what the photographs show of the texels
    total: Floats  # (N, 3) radiance that stands for all views
    clipped: NDArray[np.bool_]  # (N, 3) bool, channels that are clipped
    soft: Floats  # (N, 3) irradiance from sky and other surfaces
    narrow: Floats  # (N, J) visibility times cosine of the suns
    spread: Floats  # (N,) standard error over views of the log of a texel's brightness

    @classmethod
    def of(
        cls,
        lit: tuple[Problem, Light],
        texels: Texels,
        views: tuple[View, ...],
        tracer: EmbreeTracer,
    ) -> LitTexels:
        """Read texels in photographs, which have the size that they are read at."""
        problem, light = lit
        blend = Blend(problem, texels)
        soft = blend(problem.scene.soft @ light.amplitudes.soft + problem.indirect)
        seen = observe(tracer, texels.position, texels.normal, views, problem.scene.offset)
        linear = linear_observations(seen, problem.curve, problem.gains, texels.normal)
        observed = seen.weight, seen.positions
        share = texture_weights(observed, texels.position)
        radiance = weighted_radiance(seen, linear, share)
        shown = display_mean(linear, share, problem.curve)
        return cls(
            problem=problem,
            light=light,
            texels=texels,
            blend=blend,
            seen=seen,
            total=shown.clamp(min=1e-5).numpy(),
            clipped=radiance.clipped.numpy(),
            soft=soft,
            narrow=sun_transfer(problem, light, texels, light.sharpness, 2 * SUN_RAY_PAIRS),
            spread=_spread(linear, seen),
        )

    @property
    def sun(self) -> Floats:
        """(J, 3) irradiance of the suns on what faces them."""
        return self.light.amplitudes.sharp.numpy()

    @cached_property
    def irradiance(self) -> Floats:
        """(N, 3)."""
        return self.soft + self.narrow @ self.sun

    @cached_property
    def coverage(self) -> NDArray[np.int64]:
        """(N,) views that show each texel."""
        return (self.seen.weight > 0).sum(1)

    @cached_property
    def borders(self) -> ShadowBorders:
        """Where it is not known how much sun arrives."""
        return ShadowBorders.of(self.problem, self.light, self.texels, float(self.soft.mean()))

    @cached_property
    def surroundings(self) -> Surroundings:
        """The texels about each."""
        points = with_normals(self.texels.position, self.texels.normal, NORMAL_SCALE)
        return Surroundings(points, _STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelState:
    """Texels whose albedo is being read."""

    lit: LitTexels  # what photographs show of them and what arrives
    material: TexelMaterial  # all but the albedo
    albedo: Floats  # (N, 3) so far
    edge: NDArray[np.bool_]  # (N,) bool, where it is not known how much sun arrives
    # (N,) standard deviation of log albedo by views, shadow edges and dim light
    disagreement: Floats
    unknown: Floats  # (N,) the same, with what a specular layer hides
    reference: Reference | None = None  # texels whose albedo is certain; None before it was read
    smooth: Floats | None = None  # (N, 3) smoothed albedo; None where it was not smoothed

    @classmethod
    def of(cls, lit: LitTexels, specular: SpecularMaterial) -> TexelState:
        """Texels of a specular material, of whose albedo nothing is known yet."""
        nothing = np.zeros(len(lit.total), np.float32)
        return cls(
            lit=lit,
            material=TexelMaterial.of(specular, lit.blend),
            albedo=np.zeros_like(lit.soft),
            edge=nothing > 0,
            disagreement=nothing,
            unknown=nothing,
        )

    @property
    def below(self) -> Floats:
        """(N, 3) diffuse radiance below a specular layer."""
        total = self.lit.total
        return np.maximum(total - self.material.floor, _LEAST_DIFFUSE * total)

    @property
    def exitant(self) -> Floats:
        """(N, 3) diffuse radiosity."""
        return np.pi * self.below / self.material.kept

    @property
    def known(self) -> Reference:
        """Texels whose albedo is certain, once it was read."""
        if self.reference is None:
            raise RuntimeError("albedo was not read")
        return self.reference

    @property
    def values(self) -> TexelAlbedo:
        """All that is known of the texels."""
        lit, smooth = self.lit, self.albedo if self.smooth is None else self.smooth
        distance = distance_to_seen(lit.texels.position, lit.coverage > 0)
        changed = np.abs(np.log(smooth / self.albedo)).mean(1)
        return TexelAlbedo(
            albedo=smooth.astype(np.float32),
            coverage=lit.coverage,
            read=self.albedo.astype(np.float32),
            uncertainty=standard_error(lit.spread, changed, lit.coverage, distance),
            roughness=self.material.roughness.astype(np.float32),
            metallic=self.material.metallic.astype(np.float32),
            irradiance=lit.irradiance.astype(np.float32),
        )


def texel_albedo(lit: LitTexels, specular: SpecularMaterial, pipeline: Pipeline) -> TexelAlbedo:
    """Albedo of every texel (base colour of metal), how well it is known, roughness and metal.

    Texels no view shows take their neighbours' albedo.
    """
    return pipeline.run(ALBEDO, TexelState.of(lit, specular)).values


def _spread(linear: Tensor, seen: Observations) -> Floats:
    """Standard error over views of the log of a texel's brightness, (N,)."""
    valid = torch.from_numpy(seen.weight > 0).float()
    count = valid.sum(1).clamp(min=1)
    log = linear.mean(2).clamp(min=1e-4).log()
    mean = (log * valid).sum(1) / count
    variance = ((log - mean[:, None]) ** 2 * valid).sum(1) / count
    return (variance / count).sqrt().numpy()


def _divide(state: TexelState) -> TexelState:
    lit, metallic = state.lit, state.material.metallic
    irradiance = lit.irradiance
    albedo = state.exitant / np.hypot(irradiance, _DIM_SHARE * irradiance.mean(0))
    albedo[metallic] = state.material.metal[metallic]
    edge = lit.borders.on_edges(albedo) & ~metallic
    certain = (lit.coverage >= 2) & ~edge & ~lit.clipped.any(1)
    doubt = irradiance_doubt(torch.from_numpy(irradiance)).numpy()
    common = np.where(edge, _EDGE_ERROR, _VIEW_ERROR)
    known = np.sqrt(lit.spread**2 + common**2 + doubt**2)
    disagreement = np.where(lit.coverage > 0, known, 1.0).clip(0.0, 1.0)
    reflected = _SPECULAR_ERROR * state.material.floor.mean(1) / state.below.mean(1)
    return replace(
        state,
        albedo=albedo,
        edge=edge,
        disagreement=disagreement,
        unknown=np.hypot(disagreement, reflected).clip(0.0, 1.0),
        reference=Reference(lit.texels, albedo, certain),
    )


def _solve_shadow_edges(state: TexelState) -> TexelState:
    if not state.edge.any():
        return state
    lit = state.lit
    arriving = (lit.soft, lit.narrow, lit.sun)
    diffuse = (state.albedo, state.exitant)
    facing = lit.borders.facing
    albedo = solve_shadow_edges(diffuse, arriving, facing, lit.texels, state.edge, state.known)
    return replace(state, albedo=albedo)


def _fill_clipped(state: TexelState) -> TexelState:
    if not state.lit.clipped.any():
        return state
    albedo = fill_clipped(state.albedo, state.lit.clipped, state.known, state.lit.texels)
    return replace(state, albedo=albedo)


def _fill_unseen(state: TexelState) -> TexelState:
    hidden, albedo = state.lit.coverage == 0, state.albedo.copy()
    albedo[hidden] = state.known.nearest_albedo(state.lit.texels, hidden)
    return replace(state, albedo=np.clip(albedo, MIN_ALBEDO, MAX_ALBEDO))


def _smooth_albedo(state: TexelState) -> TexelState:
    reflected = state.lit.total * state.material.kept / state.below
    most = most_albedo(state.albedo, reflected, state.disagreement)
    smooth = np.minimum(state.lit.surroundings.smoothed(state.albedo, state.unknown), most)
    return replace(state, smooth=smooth.clip(MIN_ALBEDO, MAX_ALBEDO))


# how albedo is read, in this order
ALBEDO: tuple[Step[TexelState], ...] = (
    Step(
        name="irradiance",
        purpose="divides what paint sends by what arrives, the suns traced per texel",
        source="Lambert's law",
        run=_divide,
        is_on_trial=False,
    ),
    Step(
        name="shadow-edges",
        purpose="finds how much sun arrives at a shadow's edge by the albedo about it",
        source="RobIR's regularised visibility ratio (METHOD 2.7), per texel",
        run=_solve_shadow_edges,
    ),
    Step(
        name="clipped-texels",
        purpose="makes what is clipped as bright as its surroundings",
        source="ours",
        run=_fill_clipped,
    ),
    Step(
        name="unseen-texels",
        purpose="gives what no photograph shows its neighbours' albedo",
        source="ours",
        run=_fill_unseen,
        is_on_trial=False,
    ),
    Step(
        name="smooth-albedo",
        purpose="takes out of albedo what errors of mesh and light have left in it",
        source="ours: bilateral in albedo, corrections blurred to the width of the mesh's errors",
        run=_smooth_albedo,
    ),
)
