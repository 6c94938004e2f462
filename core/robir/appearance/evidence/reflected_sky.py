# SPDX-License-Identifier: Apache-2.0
"""The sky as paint reflects it.

Shading tells little of single parts of the sky, windows and lamps of a room among them; the
specular layer of paint shows them, F0 = 0.04 of what comes from about the mirror direction, on top
of diffuse light that is the same in all views. So lobes of the sky are changed until the views of
each sample differ as they are seen to, with its diffuse light left free, and what reaches the
diffuse surface kept as it was solved. Radiance is linear in the lobes (Ramamoorthi and Hanrahan
2001, "A signal-processing framework for inverse rendering", the specular and the diffuse part
solved together).

Where no sun shines nothing else tells the roughness: a rough surface would hide errors of a sky
that is held, but here each roughness has the sky that fits it best. They are judged alike, by parts
of the surface that had no part in the fit. Whether the sky is taken is decided in model_size.py.

Batch letters: U samples, M observations, K lobes, L levels of roughness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.blocks import block_numbers
from robir.appearance.evidence.config import EvidenceConfig
from robir.appearance.evidence.lobe_changes import Mirrored, changed
from robir.appearance.light.lobes import sky_radiance
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.observed import Seen
from robir.appearance.material.reflections import (
    Reflections,
    ViewRays,
    metal_share,
    reflected_share,
)
from robir.appearance.material.trial import Trial, predicted_below
from robir.appearance.proof import Proof
from robir.appearance.step_config import ProofConfig

Reals = NDArray[np.floating[Any]]

UNKNOWN = 100.0
"""Error of what is clipped, radiance."""

NO_BASE = 1e-3
"""Usual change of F0, which is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReflectedSky:
    """A sky that paint reflects.

    Attributes:
        light: The light with it.
        roughness: Of all paint; None where it is as a sun's highlights tell it.
        diffuse: (U, 3) radiance of the samples without what they reflect.
        errors: (M,) squared errors of views, each part of the surface by what the others tell.
    """

    light: Light
    roughness: float | None
    diffuse: Tensor
    errors: Reals


@dataclass(frozen=True, slots=True, kw_only=True)
class ReflectedSkies:
    """What paint reflects, shading being held more and less.

    Attributes:
        problem: The scene, the sky of as many lobes as asked for.
        rows: (U,) the samples that were looked at.
        before: (M,) squared errors of views by the sky as it was.
        groups: Numbers (M,) of what errs together.
        skies: One for each of `kept_errors`.
    """

    problem: Problem
    rows: NDArray[np.int64]
    before: Reals
    groups: tuple[NDArray[np.int64], ...]
    skies: tuple[ReflectedSky, ...]


def skies_by_paint(
    problem: Problem, light: Light, gloss: Gloss, count: int, config: EvidenceConfig
) -> ReflectedSkies | None:
    """The light with the sky that paint reflects.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Solved light.
        gloss: Specular material under it.
        count: Number K of lobes that an even sky is parted in.
        config: What is tried, and how freely lobes change.

    Returns:
        None where too little paint is seen.
    """
    asked, rows = config.reflected_sky, problem.scene.rows
    rows = rows[gloss.is_paint[rows] & problem.radiance.seen.numpy()[rows]]
    rows = rows[:: -(-len(rows) // asked.num_samples) or 1]
    position = problem.scene.transport.surfels.position[rows]
    block = block_numbers(position, problem.scene.config.blocks)
    if len(np.unique(block)) < asked.num_folds:
        return None
    found = gloss.roughness[rows].astype(np.float64)
    trial = Trial.of(problem, light, rows)
    rays = trial.rays
    chosen = trial.rays_of(np.ones(len(rows), bool))
    before = trial.paint_errors(chosen, found if gloss.has_highlights else None)
    parted, start = _with_lobes(problem, light, count)
    is_told = len(light.axes) > 0
    levels = [np.full(len(rows), level) for level in asked.roughnesses]
    # a sun's highlight tells more of the roughness, if it is a sun
    levels = [found, *levels] if is_told else levels
    darkened = start.with_sky(torch.zeros_like(start.amplitudes.soft))
    dark = Trial.of(parted, darkened, rows)
    lit = start.irradiance(parted, rows).clamp(min=1e-6)
    sky = start.amplitudes.soft, parted.scene.soft[rows] / lit.T[:, :, None]
    tried = [_Paint.of(dark, sky, level, config) for level in levels]
    groups = rays.view[chosen.numpy()], block[rays.sample[chosen.numpy()]]
    skies, fold = [], block % asked.num_folds
    for kept_error in asked.kept_errors:
        errors = [paint.errors(chosen, paint.across(fold, kept_error)) for paint in tried]
        best = int(np.argmin([error.mean() for error in errors]))
        if is_told and not Proof.of(errors[0], errors[best], groups).is_given:
            best = 0
        soft = tried[best].lobes(np.ones(len(rows), bool), kept_error)
        skies.append(
            ReflectedSky(
                light=start.with_sky(soft),
                roughness=None if is_told and best == 0 else float(levels[best][0]),
                diffuse=tried[best].diffuse(soft),
                errors=errors[best],
            )
        )
    return ReflectedSkies(
        problem=parted, rows=rows, before=before, groups=groups, skies=tuple(skies)
    )


def _with_lobes(problem: Problem, light: Light, count: int) -> tuple[Problem, Light]:
    """The same with an even sky parted in lobes (K)."""
    if len(light.amplitudes.soft) > 1:
        return problem, light
    directions = torch.from_numpy(problem.scene.transport.visibility.directions)
    unit = sky_radiance(directions, torch.ones(count, 1)).mean()
    even = (light.amplitudes.soft / unit).expand(count, 3).clone()
    return problem.with_lobes(count), light.with_sky(even)


@dataclass(frozen=True, slots=True)
class _Paint:
    """Samples of one roughness each, and what the lobes do to them.

    Attributes:
        rays: Their observations.
        seen: What these show.
        fixed: (M, 3) what suns and surfaces send, reflected.
        lobes_sent: (M, K) what each lobe of amplitude 1 sends, reflected.
        through: (M, 1) share of the diffuse light that is let through.
        mirrored: What differs between the views of a sample.
        soft: (K, 3) amplitudes before.
        kept: (3, U, K) share of the irradiance that each amplitude sends.
        config: How much is fitted, and how freely lobes change.
        proof: Into how many folds views are parted.
    """

    rays: ViewRays
    seen: Seen
    fixed: Tensor
    lobes_sent: Tensor
    through: Tensor
    mirrored: Mirrored
    soft: Tensor
    kept: Tensor
    config: EvidenceConfig
    proof: ProofConfig

    @classmethod
    def of(
        cls, dark: Trial, sky: tuple[Tensor, Tensor], level: Reals, config: EvidenceConfig
    ) -> _Paint:
        """Samples (U,) of some roughness (U,).

        Args:
            dark: The samples under a light without its soft lobes.
            sky: These lobes' amplitudes (K, 3), and the share (3, U, K) of the irradiance that each
                sends.
            level: The roughness.
            config: How much is fitted, and how freely lobes change.
        """
        (soft, kept), rays, seen = sky, dark.rays, dark.seen
        count = len(rays.sample)
        fixed, through = torch.zeros(count, 3), torch.ones(count, 1)
        lobes = torch.zeros(count, len(soft))
        levels = level[rays.sample]
        for roughness in np.unique(levels):
            own = torch.from_numpy(np.flatnonzero(levels == roughness))
            parts = _reflected(dark.reflections, rays.of(own), float(roughness), len(soft))
            fixed[own], lobes[own], through[own] = parts
        sample = torch.from_numpy(rays.sample)

        def differing(values: Tensor) -> Tensor:
            """Values less the diffuse light (M, C) that would explain their mean."""
            return values - through * sample_mean(values / through, rays, len(level))[sample]

        return cls(
            rays=rays,
            seen=seen,
            fixed=fixed,
            lobes_sent=lobes,
            through=through,
            mirrored=Mirrored(
                seen=differing(seen.linear - fixed),
                fixed=torch.zeros(count, 3),
                lobes=differing(lobes)[:, None].expand(-1, 3, -1),
                error=_radiance_of_codes(seen, config.reflected_sky.half_believed),
                base_freedom=NO_BASE,
            ),
            soft=soft,
            kept=kept,
            config=config,
            proof=dark.config,
        )

    def lobes(self, samples: NDArray[np.bool_], kept_error: float) -> Tensor:
        """Amplitudes (K, 3) that some of the samples (U,) ask for."""
        config, some = self.config, np.flatnonzero(samples[self.rays.sample])
        step = -(-len(some) // config.reflected_sky.num_fitted) or 1
        mirrored = self.mirrored.of(torch.from_numpy(some[::step]))
        return changed(self.soft, mirrored, self.kept, kept_error, config.lobe_changes)

    def diffuse(self, soft: Tensor) -> Tensor:
        """Mean diffuse radiance (U, 3) of the samples under lobes of some amplitudes (K, 3)."""
        linear = self.seen.linear
        least = self.seen.config.least_diffuse * linear
        below = torch.maximum(linear - self.fixed - self.lobes_sent @ soft, least)
        return sample_mean(below / self.through, self.rays, self.kept.shape[1])

    def across(self, fold: NDArray[np.int64], kept_error: float) -> Tensor:
        """Specular radiance (M, 3), of each fold (U,) by what the others tell of the sky."""
        specular = self.fixed.clone()
        for number in np.unique(fold):
            own = torch.from_numpy(np.flatnonzero(fold[self.rays.sample] == number))
            specular[own] += self.lobes_sent[own] @ self.lobes(fold != number, kept_error)
        return specular

    def errors(self, chosen: Tensor, specular: Tensor) -> Reals:
        """Squared errors of rays whose specular radiance (M, 3) is known; see `Trial`."""
        rays, seen = self.rays.of(chosen), self.seen.of(chosen)
        shone, through = specular[chosen], self.through[chosen]
        below = predicted_below(seen, rays, shone, through, self.proof)
        return seen.squared(below + shone)


def _reflected(
    reflections: Reflections, rays: ViewRays, roughness: float, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """What paint reflects of suns and surfaces (M, 3) and of lobes (M, K), and lets through (M, 1).

    Lobes are given per unit of a metal's base colour; of paint the reflectance is another.
    """
    fixed = reflections.radiance(rays, roughness)
    share = reflected_share(rays, roughness)[:, None]
    metal = metal_share(rays, roughness)[:, None]
    lobes = reflections.from_lobes(rays, roughness, count) * (share / metal)
    return fixed[:, 0], lobes, 1 - share


def _radiance_of_codes(seen: Seen, codes: float) -> Tensor:
    """Radiance (M, 3) that is so many codes about what is seen.

    Of what is clipped nothing is known.
    """
    curve, step = seen.curve.display_from_linear, 0.01 * seen.linear.clamp(min=1e-4)
    slope = (curve(seen.linear + step) - curve(seen.linear)) / step
    return (codes / 255 / slope.clamp(min=0.02)).masked_fill(seen.clipped, UNKNOWN)


def sample_mean(values: Tensor, rays: ViewRays, size: int) -> Tensor:
    """Mean (U, C) of values (M, C) over the observations of each sample."""
    sample = torch.from_numpy(rays.sample)
    count = torch.zeros(size).index_add_(0, sample, torch.ones(len(sample)))
    total = torch.zeros(size, values.shape[1]).index_add_(0, sample, values)
    return total / count.clamp(min=1)[:, None]
