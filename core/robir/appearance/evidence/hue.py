# SPDX-License-Identifier: Apache-2.0
"""Hue of the light as a whole, by the highlights of paint.

Photographs of diffuse surfaces know light and albedo by their product alone: blue light on white
paint is white light on blue paint. A highlight on paint has the colour of the light, whatever the
paint (the dichromatic model: Shafer 1985, "Using color to separate reflection components").

The camera's white balance is evidence as well: what it balanced has a light near grey in its own
colours. A hue far beyond what white balance leaves is a misread highlight, and one within it must
let photographs that had no part in reading it be predicted better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.blocks import block_numbers
from robir.appearance.evidence.witness import BY_ALL, Witness
from robir.appearance.light.lobes import log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.observed import Seen, looked_at, low_mean
from robir.appearance.proof import Proof
from robir.maths.daylight import WHOLE

Floats = NDArray[np.float32]


def told_hue(
    problem: Problem, light: Light, gloss: Gloss, solved: NDArray[np.int64]
) -> tuple[Tensor | None, tuple[Witness, ...]]:
    """Hue of what sky and suns send together, where highlights tell it.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Its light, of which all but the hue as a whole is taken for right.
        gloss: Specular material under it.
        solved: Samples by which the light is solved.

    Returns:
        Log (3,) of the mean irradiance of these, less its mean over the channels; None where too
        few highlights show or they prove nothing. And what white balance, highlights and both tell
        of its red over blue; of highlights only where they prove it.
    """
    config = problem.scene.config
    asked = config.evidence.hue
    balanced = Witness(of="hue", by="white balance", value=0.0, deviation=WHOLE.blue)
    nothing = None, (balanced, replace(balanced, by=BY_ALL))
    if not gloss.has_highlights or not len(light.axes):
        return nothing
    shown, predicted, below, near = _highlights(problem, light, gloss, asked.step)
    is_clear = shown.mean(1) > asked.least_contrast * below.mean(1)
    clear = np.flatnonzero(is_clear & (predicted > 0).all(1))
    if len(clear) < asked.least_views:
        return nothing
    sent = log_sent(light.irradiance(problem, solved), problem.indirect[solved])
    grey = (sent.mean() - sent).numpy()
    off = _off(shown[clear], predicted[clear])
    told = sent + torch.from_numpy(off)
    told = told - told.mean()
    # each fold of the views is predicted with what the others tell
    fold, without = near.view[clear] % config.proof.every, []
    factors = np.zeros((2, len(clear), 3), np.float32)
    for index in np.unique(fold):
        others = clear[fold != index]
        if not len(others):
            return nothing
        read = _off(shown[others], predicted[others])
        brightness = (read - grey).mean()
        without.append(float(sent[0] - sent[2]) + float(read[0] - read[2]))
        factors[:, fold == index] = np.exp([grey + brightness, read])[:, None]
    seen = near.seen.of(torch.from_numpy(clear))
    plain, tinted = (
        seen.squared(torch.from_numpy(below[clear] + predicted[clear] * factor))
        for factor in factors
    )
    is_likely = float(WHOLE.squared(told)) < asked.most_deviations**2
    # what displaces highlights, the mesh, errs place by place
    proof = Proof.of(plain, tinted, (near.block[clear],))
    if not (is_likely and proof.is_given):
        return nothing
    # the jackknife's error of what all views tell, from what it is without each fold
    spread = np.sqrt((len(without) - 1) * np.var(without))
    shine = Witness(
        of="hue", by="highlights", value=float(told[0] - told[2]), deviation=float(spread)
    )
    return told, (balanced, shine, both(balanced, shine))


def both(first: Witness, second: Witness) -> Witness:
    """What two independent witnesses tell together: the product of their normal distributions."""
    weights = [max(witness.deviation, 1e-6) ** -2 for witness in (first, second)]
    value = (weights[0] * first.value + weights[1] * second.value) / sum(weights)
    return Witness(of=first.of, by=BY_ALL, value=value, deviation=sum(weights) ** -0.5)


def _off(shown: Floats, predicted: Floats) -> Floats:
    """Log (3,) of highlights (M, 3) over those predicted, of all together.

    Sums, not medians: the brightest hold least of what the surface itself scatters.
    """
    return np.log(shown.sum(0).clip(1e-9) / predicted.sum(0)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class _Near:
    """Views near a sun's mirror direction.

    Attributes:
        seen: What they show.
        view: (M,) their views.
        block: (M,) block of the surface that each shows.
    """

    seen: Seen
    view: NDArray[np.int64]
    block: NDArray[np.int64]


def _highlights(
    problem: Problem, light: Light, gloss: Gloss, step: int
) -> tuple[Floats, Floats, Floats, _Near]:
    """Highlights (M, 3) of paint that are not clipped, as predicted (M, 3), and what is below.

    Every so manieth of the samples is looked at.
    """
    chosen = problem.radiance.seen.numpy() & gloss.is_paint
    rows = problem.scene.rows[::step]
    rows = rows[chosen[rows]]
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    specular = torch.zeros(len(rays.sample), 3)
    level = gloss.roughness[rows][rays.sample]
    for roughness in np.unique(level):
        own = torch.from_numpy(np.flatnonzero(level == roughness))
        specular[own] = reflections.from_suns(rays.of(own), float(roughness))[:, 0]
    near = reflections.near_highlight(rays)
    near = near[~seen.clipped[near].any(1)]
    statistics = problem.scene.config.photometry.statistics
    below, part = (
        low_mean(values, rays, valid, statistics)[rays.sample] for values in (seen.linear, specular)
    )
    parts = (seen.linear - below, specular - part, below)
    shown, predicted, base = (values[near].numpy() for values in parts)
    sample, view = rays.sample[near.numpy()], rays.view[near.numpy()]
    block = block_numbers(
        problem.scene.transport.surfels.position[rows], problem.scene.config.blocks
    )[sample]
    return shown, predicted, base, _Near(seen.of(near), view, block)
