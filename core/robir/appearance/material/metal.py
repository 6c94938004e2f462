# SPDX-License-Identifier: Apache-2.0
"""Which samples are metal, and the base colour and roughness of each metal part.

Polished metal shows its surroundings, displaced by every error of the mesh, so one sample's views
say little. Three figures of a neighbourhood are weighed: how badly a dielectric explains its views,
how much better metal does, and whether it is as bright as metals are (logistic regression on
captures of known truth). The log odds of many neighbourhoods are averaged over the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.highlights import LEVELS
from robir.appearance.material.observed import dense, looked_at
from robir.appearance.material.reflections import Reflections, ViewRays, tilts_of
from robir.appearance.material.trial import MaterialTrial
from robir.jobs.context import Choice
from robir.workers import num_workers, side_by_side

Array = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]

# Ashman's distance of two halves' means, in their mean deviations, from which they are two hues.
# Hues spread evenly along a line have 3.5 when cut in the middle, a normal distribution 2.7.
_CLEAR_GAP = 4.0


def pieces(position: Array, hue: Array, gap: float, fewest: int) -> Rows:
    """Number (N,) of the piece of every sample: near each other and of one hue.

    Links lead across borders, where hues blend; so a touching piece is cut in two where its log
    hues (N, 3) lie in two heaps. `gap` is the distance of neighbours, `fewest` the samples of
    either side.
    """
    near = cKDTree(position).query_pairs(gap, output_type="ndarray")
    ones = np.ones(len(near))
    links = coo_matrix((ones, (near[:, 0], near[:, 1])), shape=(len(position), len(position)))
    count, touching = connected_components(links, directed=False)
    waiting = [np.flatnonzero(touching == index) for index in range(count)]
    number, done = np.zeros(len(position), np.int64), 0
    while waiting:
        rows = waiting.pop()
        is_low = _two_heaps(hue[rows], fewest, _CLEAR_GAP)
        if is_low is None:
            number[rows] = done
            done += 1
        else:
            waiting += [rows[is_low], rows[~is_low]]
    return number


def _two_heaps(hue: Array, fewest: int, clear_gap: float) -> NDArray[np.bool_] | None:
    """Which of hues (N, 3) lie in the lower of two heaps, by Otsu's cut; None if in one."""
    count = len(hue)
    if count < 2 * fewest:
        return None
    centred = hue - hue.mean(0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    order = np.argsort(along)
    # means are 0 together, so the sum of the lower ones tells how far apart both are
    size = np.arange(fewest, count - fewest + 1)
    lower = np.cumsum(along[order])[size - 1]
    cut = size[int((lower**2 / (size * (count - size))).argmax())]
    low, high = along[order[:cut]], along[order[cut:]]
    deviation = np.sqrt(0.5 * (low.var() + high.var()))
    if high.mean() - low.mean() <= clear_gap * max(deviation, 1e-9):
        return None
    is_low = np.zeros(count, bool)
    is_low[order[:cut]] = True
    return is_low


def clusters(features: Array, count: int, seed: int) -> Rows:
    """k-means labels (N,)."""
    count = min(count, len(features))
    _, labels = kmeans2(
        features.astype(np.float64), count, minit="++", seed=np.random.default_rng(seed)
    )
    return labels.astype(np.int64)


def means(features: Array, cluster: Rows) -> Array:
    """Means (K, D) over each cluster; 0 where k-means left one empty."""
    size = np.bincount(cluster).clip(1)
    return np.stack([np.bincount(cluster, column) / size for column in features.T], axis=1)


Floats = NDArray[np.float32]
Reals = NDArray[np.float64]

# blue over red, and green over the mean of both, of log colours
HUE_OF_LOG = np.array([[-1.0, 0.0, 1.0], [-0.5, 1.0, -0.5]])

LOG_OF_HUE = np.linalg.pinv(HUE_OF_LOG)  # log colours, but for their mean, of these two

_PER_DIELECTRIC_ERROR = 1.4  # log odds per logarithm of the display error, codes, that paint leaves
_PER_METAL_ERROR = -2.98  # the same of metal's error over paint's
_PER_BRIGHTNESS = -1.26  # the same of bright metal's error over that of any
_CONSTANT = -1.3  # log odds where all these are 0
_LEAST_RATIO = 0.35  # metal's error over paint's below which less tells no more
_MOST_ODDS = 4.0  # log odds, either way, that one neighbourhood may tell
# how many of the roughnesses metal is tried at: a rougher one looks like a dielectric of another
# shade
_TILTS_TOGETHER = 4  # tilts of the normal tried at a time: each holds all observations
_NUM_LEVELS = 5
_NUM_CLASSIFIED = 3400  # samples that are judged; the others go by those about them
_NEIGHBOURS = 8  # of these, those that judge together under one roughness
_NUM_AVERAGED = 12  # of these, those whose log odds are averaged
_CANDIDATE_ODDS = 0.5  # log odds from which a sample may be part of metal
# mean log odds from which such a part is metal: paint that is taken for metal costs a good albedo
# more than metal that is missed costs a bad one
_METAL_ODDS = 2.45
# standard errors by which metal must predict a part's views better than paint does. A highlight on
# paint comes to 2.2 at most, metal that is found mostly to more.
_PROVEN = 2.5
_GAP = 3.0  # gap, in spacings of the judged samples, across which samples belong to one part
_FEWEST = 8  # judged samples of a part
_BRIGHTEST_CHANNEL = 0.5  # brightest channel that bright metal has at least
_ENOUGH = 8.0  # judged samples whose own errors are as large as what those of a part have in common
_BRIGHTNESS = -0.35  # usual log of a base colour's brightest channel
_BRIGHTNESS_SPREAD = 0.35  # its standard deviation among metals
_BLUE = -0.35  # usual log of blue over red of a base colour
_BLUE_SPREAD = 0.6  # its standard deviation; from silver to gold and copper
_GREEN_SPREAD = 0.25  # of the log of green over the mean of red and blue
_ALIKE = 0.4  # spread among the metals of one scene, over that among all metals
_BRIGHTNESS_ERROR = 0.35  # of a part's reading, in logarithms
_BLUE_ERROR = 0.45  # the same of its blue over red: light differs along the line of daylight
_GREEN_ERROR = 0.1  # the same across it
_MISREAD_SHARE = 0.15  # chance that a reading is wrong altogether, for what is mirrored is
_MISREAD_ERROR = 1.5  # error of such a reading, in logarithms
SOLVED_WITHOUT = 0.1  # least share of paint with which the light is solved by paint alone


@dataclass(frozen=True, slots=True)
class MetalParts:
    """Connected metal parts."""

    part: Rows  # (U,) part of every sample, -1 where it is no metal after all
    base: Floats  # (P, 3) base colour, linear Rec.709
    roughness: Floats  # (P,) perceptual

    def of(self, kept: NDArray[np.bool_]) -> MetalParts:
        """Some (P,) of the parts, numbered anew."""
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return MetalParts(number[self.part], self.base[kept], self.roughness[kept])


def find_metal(
    solved: tuple[Problem, Light],
    rows: Rows,
    alike: tuple[Floats, Floats],
    trial: MaterialTrial,
    dielectric: Floats,
) -> MetalParts:
    """Parts of samples (U,) that are likely metal; some are classified and speak for others.

    `alike` are points (U, 9) by which they are classified together, and log hues (U, 3);
    `dielectric` (U, L) is the mean display error over each one's views at every roughness.
    """
    (problem, light), (points, hue) = solved, alike
    surfels = problem.scene.transport.surfels
    classified = np.arange(0, len(rows), -(-len(rows) // _NUM_CLASSIFIED) or 1)
    metal = metal_errors(problem, light, rows[classified])
    together = near(points[classified], points[classified], _NEIGHBOURS)
    averaged = near(points[classified], points, _NUM_AVERAGED)
    odds = metal_odds(dielectric[classified], metal, together)[averaged].mean(1)
    nearest = averaged[:, 0]
    spacing = surfels.spacing * float(np.sqrt(len(surfels) / len(rows)))
    place = surfels.position[rows], hue[classified][together].mean(1)[nearest], spacing
    observed = trial.reflections, trial.rays, trial.seen.linear
    return metal_parts(odds, place, observed, metal[0][nearest])


def near(points: Floats, places: Floats, count: int) -> Rows:
    """Nearest so many (N, C) of some points (U, D) to places (N, D), themselves among them."""
    count = min(count, len(points))
    return (
        cKDTree(points).query(places, k=count, workers=num_workers())[1].reshape(len(places), count)
    )


def metal_errors(problem: Problem, light: Light, rows: Rows) -> tuple[Floats, Floats]:
    """Mean display error (U, L) of samples as metal of any base colour, and of a bright one.

    Each with its own base colour and tilt of its normal, as what metal shows moves by twice the
    normal's error. A dark metal explains dark glossy paint, so a bright base is tried as well.
    """
    levels = LEVELS[:_NUM_LEVELS]
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    sample, shape = torch.from_numpy(rays.sample), (valid.shape[0], valid.shape[1])

    def errors(tilt: tuple[float, float]) -> Tensor:
        found = torch.empty(2, len(rows), len(levels))
        mirrored = reflections.tilted(rays, tilt)
        for index, level in enumerate(levels):
            sky = reflections.from_sky(mirrored, level)
            white = (sky + reflections.from_suns(rays, level, tilt))[:, 1]
            ratio = dense(seen.linear / white.clamp(min=1e-5), rays, shape)
            base = ratio.masked_fill(~valid[..., None], float("nan")).nanmedian(1).values
            base = base.clamp(1e-3, 1)
            bright = base * (_BRIGHTEST_CHANNEL / base.amax(1, keepdim=True)).clamp(min=1)
            for kind, tried in enumerate((base, bright)):
                error = seen.error(tried[sample] * white)
                found[kind, :, index] = torch.zeros(len(rows)).index_add_(0, sample, error)
        return found

    best = torch.stack(side_by_side(errors, tilts_of(), _TILTS_TOGETHER)).amin(0)
    free, bright = (best / valid.sum(1).clamp(min=1)[:, None]).numpy()
    return free, bright


def metal_odds(
    dielectric: Floats, metal: tuple[Floats, Floats], around: Rows
) -> NDArray[np.float64]:
    """Log odds (U,) that neighbourhoods `around` (U, C) are of metal.

    By mean display errors (U, L) as dielectric, and as metal from `metal_errors`.
    """
    matched, free, bright = (
        errors[around].mean(1).min(1).clip(1e-6) for errors in (dielectric, *metal)
    )
    odds = (
        _CONSTANT
        + _PER_DIELECTRIC_ERROR * np.log(255 * matched + 0.5)
        + _PER_METAL_ERROR * np.log((free / matched).clip(_LEAST_RATIO))
        + _PER_BRIGHTNESS * np.log(bright / free)
    )
    return odds.clip(-_MOST_ODDS, _MOST_ODDS)


def metal_parts(
    odds: NDArray[np.float64],
    place: tuple[Floats, Floats, float],
    observed: tuple[Reflections, ViewRays, Tensor],
    errors: Floats,
) -> MetalParts:
    """Gather metal samples into parts of one hue and read what each is made of.

    `odds` (U,) are log odds, as averaged over each sample's surroundings; `place` is positions (U,
    3), unit frame, log hues (U, 3) about them, and their spacing; `observed` what the samples
    reflect, their rays (M), and the radiance (M, 3) that is seen; `errors` (U, L) the mean display
    error of each sample as metal.
    """
    levels = LEVELS[:_NUM_LEVELS]
    rows = np.flatnonzero(odds > _CANDIDATE_ODDS)
    position, hue, spacing = place
    piece, part = np.full(len(odds), -1), np.full(len(odds), -1)
    if len(rows):
        piece[rows] = pieces(position[rows], hue[rows], _GAP * spacing, _FEWEST)
    reflections, rays, linear = observed
    bases, roughness, sizes = [], [], []
    readings: dict[float, Floats] = {}
    for index in range(piece.max(initial=-1) + 1):
        inside = piece == index
        if inside.sum() < _FEWEST or odds[inside].mean() < _METAL_ODDS:
            continue
        level = levels[int(errors[inside].mean(0).argmin())]
        if level not in readings:
            white = reflections.radiance(rays, level)[:, 1].clamp(min=1e-5)
            readings[level] = (linear / white).numpy()
        part[inside] = len(bases)
        bases.append(np.median(readings[level][inside[rays.sample]], axis=0))
        roughness.append(level)
        sizes.append(inside.sum())
    log = np.log(np.reshape(bases, (-1, 3)).clip(1e-3))
    base = np.exp(base_colour_posterior(log, np.array(sizes)))
    return MetalParts(
        part=part,
        base=base.astype(np.float32),
        roughness=np.array(roughness, np.float32),
    )


def base_colour_posterior(read: Reals, count: NDArray[np.int64]) -> Reals:
    """Posterior mean of the log base colours (P, 3) of parts read so by `count` (P,) samples each.

    The parts of a scene are drawn from what all of them read, and that from what metals there are
    (random effects, Laird and Ware 1982, "Random-effects models for longitudinal data"). None above
    0.
    """
    if not len(read):
        return read
    share = count / count.sum()
    shown = np.column_stack([read.max(1), read @ HUE_OF_LOG.T])
    metals = np.array([_BRIGHTNESS, _BLUE, 0.0])
    spread = np.array([_BRIGHTNESS_SPREAD, _BLUE_SPREAD, _GREEN_SPREAD])
    together = _weighted_median(shown, share)[None]
    chance = np.sqrt(1 + _ENOUGH / count.clip(1))[:, None]
    scene = _posterior(together, (metals, spread), np.sqrt((share**2).sum()) * chance.min())
    brightest, *hue = _posterior(shown, (scene[0], _ALIKE * spread), chance).T
    log = np.stack(hue, axis=1) @ LOG_OF_HUE.T
    return np.minimum(log - log.max(1, keepdims=True) + brightest[:, None], 0.0)


def _posterior(read: Reals, prior: tuple[Reals, Reals], chance: Reals | float) -> Reals:
    """Posterior means (P, 3) of brightness and hue read so, of a prior's mean and deviation."""
    # the error is a mixture, as some readings are wrong altogether (Box and Tiao 1968, "A Bayesian
    # approach to some outlier problems"); `chance` (P, 1) scales it
    known, spread = prior
    off = read - known
    weights, means = [], []
    usual = (_BRIGHTNESS_ERROR, _BLUE_ERROR, _GREEN_ERROR)
    for share, error in ((1 - _MISREAD_SHARE, usual), (_MISREAD_SHARE, 3 * (_MISREAD_ERROR,))):
        whole = spread**2 + (chance * np.array(error)) ** 2
        weights.append(share * np.exp(-0.5 * (off**2 / whole + np.log(whole)).sum(1)))
        means.append(off * spread**2 / whole)
    good, bad = weights
    trust = (good / np.maximum(good + bad, 1e-300))[:, None]
    return known + trust * means[0] + (1 - trust) * means[1]


def _weighted_median(values: Reals, share: Reals) -> Reals:
    """Median (D,) of values (P, D) whose shares (P,) come to 1."""
    order = values.argsort(0)
    half = (share[order].cumsum(0) >= 0.5 - 1e-9).argmax(0)
    return np.take_along_axis(values, order, 0)[half, np.arange(values.shape[1])]


def tested_parts(
    parts: MetalParts, trial: MaterialTrial, dielectric: Floats
) -> tuple[MetalParts, Choice]:
    """The parts (numbered anew) that held-out photographs prove to be metal, and the choice.

    Each is compared with a dielectric, matt or of its best roughness. `dielectric` (U, L) is the
    display error of each sample at every roughness.
    """
    count = len(trial.rays.sample)
    plain, metal, single = np.zeros(count), np.zeros(count), []
    for index, roughness in enumerate(parts.roughness):
        inside = parts.part == index
        own = trial.rays_of(inside)
        level = LEVELS[int(dielectric[inside].mean(0).argmin())]
        glossy = trial.dielectric_errors(own, np.full(len(inside), level))
        plain[own] = min(trial.dielectric_errors(own, None), glossy, key=np.sum)
        metal[own] = trial.metal_errors(own, float(roughness))
        single.append(trial.compare(own, plain[own], metal[own]))
    every = trial.rays_of(parts.part >= 0)
    whole = trial.compare(every, plain[every], metal[every])
    passed = np.array([one.leads_by(_PROVEN) for one in single], bool)
    why = f"{passed.sum()} of {len(passed)} parts that may be metal are proven"
    if len(passed):
        why += f"; of all together {whole.words(_PROVEN)}"
    kept_parts = parts.of(passed)
    choice = Choice(
        choice="metal",
        chosen=f"{(kept_parts.part >= 0).mean():.0%} of the surface",
        alternatives=("none",),
        held_out_error=whole.rich if passed.all() and len(passed) else None,
        why=why,
    )
    return kept_parts, choice
