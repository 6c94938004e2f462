# SPDX-License-Identifier: Apache-2.0
"""The last check: no part of the asset may show photographs worse than their plain mean does.

That mean knows no light, metal or shadow. Where the model is worse on a block of the surface, by
more than chance, metal, specular layer and smoothing are reverted there in turn, and what shows the
photographs better stays. A gain over the mean proves nothing: a light of the wrong colour explains
photographs well and turns the albedo brown.

Before that the specular layer of the whole object is compared with none. Its trial on samples lets
each have the diffuse light that suits it; here albedo is read once, and cannot be negative where
more is reflected than photographs show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.appearance.held_out_test import HeldOutTest
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.roughness import MATTE
from robir.appearance.material.specular import SpecularMaterial, with_material
from robir.appearance.photometry.statistics import display_mean, linear_observations
from robir.appearance.texture.texels import TexelAlbedo, Texels, radiance_towards
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.jobs.context import Choice
from robir.maths.vectors import farthest_points
from robir.transport.observe import Observations, observe, spread_views

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

# blocks of the surface: each is about 2 % of it, the smallest part that a person sees at once
_NUM_BLOCKS = 64

_NUM_TEXELS = 12_000  # texels that are judged, some 200 a block

_NUM_VIEWS = 12  # photographs that judge; they lie far apart

_LEAST_VIEWS = 3  # photographs that must show a block before it is judged

# weight of a normal's direction beside places in the unit frame: a thin plate has two sides
_FACING = 0.5

# standard errors over photographs by which a block must be worse than the mean, or a specular layer
# worse than none
_MARGIN = 2.0

# dB against the mean that a person sees. True metal under normals that are a few degrees off loses
# less, and so does smoothing, which removes shading that the light did not explain on purpose.
_LOSS = 3.0

# share of the way from one block's middle to the next over which what is reverted fades
_FADE = 0.4

# display error that nobody sees beside a texture; it is added to both sides of a comparison
_UNSEEN = 5.0 / 255

_PARTS = ("metal", "specular", "smoothing")


@dataclass(frozen=True, slots=True, kw_only=True)
class Asset:
    """A textured surface under its light."""

    problem: Problem  # scene under the chosen tone curve
    light: Light  # solved light
    specular: SpecularMaterial  # specular material of the samples
    values: TexelAlbedo  # of the texels


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """How the blocks of a surface are shown, against the mean of the photographs."""

    # (B,) mean squared display error of the asset, 0..1; NaN where too few photographs show the
    # block
    ours: Floats
    mean: Floats  # (B,) the same of the photographs' mean
    error: Floats  # (B,) standard error of the difference, over photographs

    @property
    def decibels(self) -> Floats:
        """(B,) by how much the asset is worse, where both also err by what nobody sees."""
        ours, mean = (np.nan_to_num(errors) + _UNSEEN**2 for errors in (self.ours, self.mean))
        return (10 * np.log10(ours / mean)).astype(np.float32)

    def beyond(self, decibels: float) -> NDArray[np.bool_]:
        """(B,) blocks that are worse by more than so much, and by more than chance."""
        is_significant = np.nan_to_num(self.ours - self.mean) > _MARGIN * np.nan_to_num(self.error)
        return is_significant & (self.decibels > decibels)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """What was reverted, and what is still worse than the mean."""

    asset: Asset  # what is left
    taken_back: dict[str, float]  # share of the blocks on which each part was reverted
    worst: float  # largest significant loss of a block, dB; 0 without one
    unexplained: float  # share of the blocks that are visibly worse than the mean

    @property
    def choice(self) -> Choice:
        """For the report."""
        reverted = [f"{part} on {share:.0%}" for part, share in self.taken_back.items() if share]
        left = f"; {self.unexplained:.0%} of the surface still is" if self.unexplained else ""
        return Choice(
            choice="taken back",
            chosen=", ".join(reverted) or "nothing",
            alternatives=_PARTS,
            why="blocks of the surface that the asset shows worse than the photographs' mean, by "
            f"more than {_MARGIN:g} standard errors and {_LOSS:g} dB{left}",
        )

    @property
    def plain(self) -> dict[str, object]:
        """As plain values."""
        return {
            "taken_back": self.taken_back,
            "worst_loss": self.worst,
            "unexplained": self.unexplained,
        }


class PhotographCheck:
    """The photographs, and the blocks of the surface on which they are compared."""

    def __init__(
        self,
        problem: Problem,
        texels: Texels,
        views: tuple[View, ...],
        tracer: EmbreeTracer,
    ) -> None:
        """Read photographs, whose pixels are about as large as texels, once."""
        self._problem = problem
        places = _places(texels.position, texels.normal)
        some = np.linspace(0, len(places) - 1, min(_NUM_TEXELS, len(places))).astype(np.int64)
        seeds = farthest_points(places[some], min(_NUM_BLOCKS, len(some)))
        self._seeds = places[some][seeds]
        chosen = spread_views(views, min(_NUM_VIEWS, len(views)))
        position, normal = texels.position[some], texels.normal[some]
        seen = observe(tracer, position, normal, chosen, problem.scene.offset)
        shown = (seen.weight > 0).sum(1) >= 2
        self._some = some[shown]
        self._points = Texels(position=position[shown], normal=normal[shown])
        self._seen = seen.subset(shown)
        self._block = self.blocks(self._points.position, self._points.normal)
        self._mean = self._codes(_mean_radiance(problem, self._seen, self._points))

    def blocks(self, position: Floats, normal: Floats) -> Rows:
        """(N,) number of the block that each point belongs to."""
        return cKDTree(self._seeds).query(_places(position, normal))[1].astype(np.int64)

    def faded(self, chosen: NDArray[np.bool_], position: Floats, normal: Floats) -> Floats:
        """(N,) share, 0..1, that blocks (B,) hold of each point: half of it where others begin."""
        if chosen.all():
            return np.ones(len(position), np.float32)
        places = _places(position, normal)
        near, far = (cKDTree(self._seeds[some]).query(places)[0] for some in (chosen, ~chosen))
        share = 0.5 + (far / np.maximum(near + far, 1e-12) - 0.5) / _FADE
        return np.clip(share, 0, 1).astype(np.float32)

    def errors(self, asset: Asset) -> Floats:
        """(N, V) squared display errors, 0..1, of all observations; anything where none is."""
        return self._squared(self._codes(self._radiance(asset)))

    def is_worse(self, errors: Floats, than: Floats) -> bool:
        """Whether errors (N, V) are larger than others by more than chance, over photographs."""
        valid = self._seen.weight > 0
        test = HeldOutTest.of(than[valid], errors[valid], (valid.nonzero()[1],))
        return test.gain < -_MARGIN * test.error

    def loss(self, asset: Asset) -> Loss:
        """How each block of an asset is shown, against the mean of the photographs."""
        return self.loss_by(self.errors(asset))

    def loss_by(self, errors: Floats) -> Loss:
        """The same by `errors` of an asset."""
        valid = self._seen.weight > 0
        count, views = len(self._seeds), valid.shape[1]
        cell = self._block[:, None] * views + np.arange(views)
        size = np.bincount(cell[valid], minlength=count * views).reshape(count, views)
        tables = []
        for squared in (errors, self._squared(self._mean)):
            total = np.bincount(cell[valid], squared[valid], count * views)
            tables.append(total.reshape(count, views) / np.maximum(size, 1))
        is_compared = size > 0
        number = is_compared.sum(1)
        means = [np.where(is_compared, table, 0).sum(1) / np.maximum(number, 1) for table in tables]
        apart = np.where(is_compared, tables[0] - tables[1], 0)
        spread = np.where(is_compared, (apart - (means[0] - means[1])[:, None]) ** 2, 0).sum(1)
        error = np.sqrt(spread / np.maximum(number * (number - 1), 1))
        hidden = number < _LEAST_VIEWS
        mine, mean = (np.where(hidden, np.nan, values).astype(np.float32) for values in means)
        return Loss(ours=mine, mean=mean, error=error.astype(np.float32))

    def _squared(self, codes: Floats) -> Floats:
        """(N, V) squared difference of codes (N, V, 3) to the photographs."""
        photo = self._seen.display.astype(np.float32) / 255
        return ((codes - photo) ** 2).mean(2)

    def _radiance(self, asset: Asset) -> Floats:
        """(N, V, 3) that an asset sends to the photographs' cameras."""
        points, seen, values = self._points, self._seen, asset.values
        point, view = np.nonzero(seen.weight > 0)
        towards = seen.positions[view] - points.position[point]
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        texel = self._some[point]
        whole, _ = radiance_towards(
            (asset.problem, asset.light, asset.specular),
            points,
            (point, towards.astype(np.float32)),
            (values.albedo[texel], values.metallic[texel, None]),
        )
        sent = np.zeros((*seen.weight.shape, 3), np.float32)
        sent[point, view] = whole
        return sent

    def _codes(self, radiance: Floats) -> Floats:
        """(N, V, 3) display values of radiance at the common exposure, as photographed."""
        seen, problem = self._seen, self._problem
        gain = problem.gains.at(seen.views, seen.off_axis, self._points.normal[:, None])
        shown = problem.curve.display_from_linear(gain * torch.from_numpy(radiance))
        return shown.clamp(0, 1).numpy().astype(np.float32)


def check_asset(
    check: PhotographCheck,
    asset: Asset,
    read: Callable[[SpecularMaterial], TexelAlbedo],
    texels: Texels,
) -> CheckResult:
    """Revert, block by block, what shows the photographs worse than their mean.

    `read` reads the texels again under another specular material.
    """
    surfels = asset.problem.scene.transport.surfels
    of_sample = check.blocks(surfels.position, surfels.normal)
    taken: dict[str, float] = dict.fromkeys(_PARTS, 0.0)
    errors = check.errors(asset)
    if asset.specular.has_highlights:
        matt = _matt(asset, read)
        without = check.errors(matt)
        if check.is_worse(errors, without):
            asset, errors, taken["specular"] = matt, without, 1.0
    loss = check.loss_by(errors)
    for part in _PARTS:
        wanted = loss.beyond(_LOSS)
        tried = _without(part, asset, wanted[of_sample], read) if wanted.any() else None
        if tried is None:
            continue
        after = check.loss(tried)
        # compared with what the mean leaves, not with each other: both have its errors
        better = wanted & (np.nan_to_num(after.ours) < np.nan_to_num(loss.ours))
        if not better.any():
            continue
        shares = [check.faded(better, at.position, at.normal) for at in (surfels, texels)]
        if part == "metal":  # there is no half metal
            shares = [np.round(share) for share in shares]
        asset = _joined(asset, tried, *shares)
        loss = check.loss(asset)
        taken[part] = float(better.mean())
    worst = loss.decibels[loss.beyond(0.0)]
    return CheckResult(
        asset=asset,
        taken_back=taken,
        worst=float(worst.max()) if len(worst) else 0.0,
        unexplained=float(loss.beyond(_LOSS).mean()),
    )


def _matt(asset: Asset, read: Callable[[SpecularMaterial], TexelAlbedo]) -> Asset:
    """The asset whose dielectrics have no specular layer; how rough they would be stays."""
    before = asset.specular
    nothing, all_of_it = np.zeros_like(before.floor), np.ones_like(before.kept)
    specular = replace(before, has_highlights=False, floor=nothing, kept=all_of_it)
    return replace(asset, specular=specular, values=read(specular))


def _without(
    part: str,
    asset: Asset,
    chosen: NDArray[np.bool_],
    read: Callable[[SpecularMaterial], TexelAlbedo],
) -> Asset | None:
    """The asset without a part on chosen samples (S,), None where these have no such part."""
    if part == "smoothing":
        return replace(asset, values=replace(asset.values, albedo=asset.values.read))
    is_metal = asset.specular.metallic > 0.5
    affected = chosen & (is_metal if part == "metal" else ~is_metal & asset.specular.has_highlights)
    if not affected.any():
        return None
    # as dull as a dielectric can be: what it then reflects no view tells from its diffuse light
    dull = np.full(len(chosen), MATTE, np.float32), np.zeros(len(chosen), np.float32)
    specular, _ = with_material(asset.problem, asset.light, asset.specular, affected, dull)
    return replace(asset, specular=specular, values=read(specular))


def _joined(asset: Asset, other: Asset, samples: Floats, texels: Floats) -> Asset:
    """The asset with so much of the other, 0..1, at each sample (S,) and texel (N,)."""
    specular = {
        name: _mixed(getattr(asset.specular, name), getattr(other.specular, name), samples)
        for name in ("roughness", "metallic", "floor", "kept")
    }
    values = {
        name: _mixed(getattr(asset.values, name), getattr(other.values, name), texels)
        for name in ("albedo", "read", "uncertainty", "roughness", "metallic")
    }
    return replace(
        asset,
        specular=replace(asset.specular, **specular),
        values=replace(asset.values, **values),
    )


def _mixed(values: Floats, others: Floats, share: Floats) -> Floats:
    """Values (N, ...) with so much (N,) of others."""
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.where(share < 1, values + share * (others - values), others)


def _places(position: Floats, normal: Floats) -> Floats:
    """(N, 6) points that lie close together where the surface does and faces alike."""
    return np.concatenate([position, _FACING * normal], axis=1).astype(np.float32)


def _mean_radiance(problem: Problem, seen: Observations, points: Texels) -> Floats:
    """(N, V, 3) radiance whose display value is the mean of each point's photographs."""
    linear = linear_observations(seen, problem.curve, problem.gains, points.normal)
    shown = torch.from_numpy((seen.weight > 0).astype(np.float32))
    mean = display_mean(linear, shown, problem.curve).numpy()
    return np.broadcast_to(mean[:, None], (*seen.weight.shape, 3)).copy()
