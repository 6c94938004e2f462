# SPDX-License-Identifier: Apache-2.0
"""Textures of the whole atlas, step by step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.photograph_check import Asset, CheckResult, PhotographCheck, check_asset
from robir.appearance.texture.albedo import LitTexels, texel_albedo
from robir.appearance.texture.detail import SharpestViews, finer
from robir.appearance.texture.lost_detail import regained
from robir.appearance.texture.texels import TexelAlbedo, Texels
from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.capture.images.loading import resize_views
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh, face_geometry
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.steps import Pipeline, Step
from robir.transport.baked import Transport
from robir.transport.observe import spread_views
from robir.transport.surfels import interpolate

_MOST_TOGETHER = 8192  # along a side of an atlas of UDIM tiles: what memory is planned for (texels)


def solved_side(config: AppearanceConfig, cells: int = 1) -> int:
    """Texels along a side of the atlas that is solved: no more than the textures may have.

    `cells` are along a side of an atlas of UDIM tiles, each of which has a power of two.
    """
    if cells == 1:
        return min(config.shading_size, config.texture_size)
    wanted = 2 ** round(math.log2(max(1.0, config.shading_size / cells)))
    return min(cells * wanted, most_side(config, cells))


def most_side(config: AppearanceConfig, cells: int = 1) -> int:
    """Most texels along a side of the atlas; all UDIM tiles together have `_MOST_TOGETHER`."""
    if cells == 1:
        return config.texture_size
    most = _MOST_TOGETHER / cells
    return cells * 2 ** int(math.log2(min(config.texture_size, most)))


def pixel_width(transport: Transport, cameras: Mapping[str, Camera]) -> float:
    """Median width on the surface, unit frame, of a pixel of the view that shows a spot best.

    Cameras have the size that photographs are read at; infinite if no view shows anything.
    """
    seen = transport.observations
    best = np.full(len(seen.weight), np.inf)
    for column, name in enumerate(seen.views):
        camera = cameras[name]
        depth = (transport.surfels.position - camera.position) @ camera.forward
        cosine = seen.weight[:, column]
        shown = cosine > 0
        area = depth[shown] ** 2 / (camera.fx * camera.fy * cosine[shown])
        best[shown] = np.minimum(best[shown], area)
    known = best[np.isfinite(best)]
    return math.sqrt(float(np.median(known))) if len(known) else math.inf


def texture_side(mesh: Mesh, width: float, sizes: tuple[int, int]) -> int:
    """Side of a square texture whose texels are no wider than `width` on an unwrapped mesh.

    The least of `sizes` doubled as often as it takes, and at most the most.
    """
    area = face_geometry(mesh.vertices, mesh.faces)[1].sum()
    u, v, w = (mesh.uvs[mesh.uv_faces[:, k]].astype(np.float64) for k in range(3))
    (ax, ay), (bx, by) = (v - u).T, (w - u).T
    filled = 0.5 * np.abs(ax * by - ay * bx).sum()
    wanted = math.sqrt(area / max(filled, 1e-9)) / width
    least, most = sizes
    side = min(least, most)
    while side < wanted and 2 * side <= most:
        side *= 2
    return side


Floats = NDArray[np.float32]

_ALBEDO_VIEWS = 48  # of which albedo is read
_DETAIL_VIEWS = 96  # of which the best show a spot's detail


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    """Texels of the atlas on their way."""

    problem: Problem  # scene under the chosen tone curve
    light: Light  # solved light
    specular: SpecularMaterial  # specular material of the samples
    mesh: Mesh  # unwrapped, unit frame
    tracer: EmbreeTracer  # of the mesh that light is solved on
    capture: Capture  # photographs that take part, unit frame
    views: tuple[View, ...]  # those that albedo is read from, at the size that they are read at
    config: AppearanceConfig  # sizes
    inside: NDArray[np.bool_]  # (T, T) bool, texels that belong to a chart, row 0 at v = 1
    # face (N,) and barycentric coordinates (N, 3) of the texels that were solved
    atlas: tuple[NDArray[np.int32], Floats]
    values: TexelAlbedo  # of these texels
    # the same, whatever their material; None once photographs were heard, as it takes much memory
    lit: LitTexels | None = field(compare=False)
    pipeline: Pipeline = field(compare=False)  # of the stage's steps, for what is read again
    # result of the photograph check; None before it
    checked: CheckResult | None = field(default=None, compare=False)

    @classmethod
    def of(
        cls,
        solved: tuple[Problem, Light, SpecularMaterial],
        surface: tuple[Mesh, EmbreeTracer],
        capture: Capture,
        config: AppearanceConfig,
        pipeline: Pipeline,
    ) -> Texture:
        """Texels as they are read in the photographs.

        Of an unwrapped mesh, unit frame, with the tracer of the mesh for light. `capture` must lack
        photographs under another light: their shade would darken the texture of all.
        """
        (problem, light, specular), (mesh, tracer) = solved, surface
        side = solved_side(config, mesh.cells)
        face, barycentric = rasterise_atlas(mesh, side)
        inside = face >= 0
        atlas = (face[inside], barycentric[inside].astype(np.float32))
        position, normal = interpolate(mesh, *atlas)
        # a pixel about as large as a texel
        spread = spread_views(capture.train, _ALBEDO_VIEWS)
        views = resize_views(spread, side)
        texels = Texels(position=position, normal=normal)
        lit = LitTexels.of((problem, light), texels, views, tracer)
        return cls(
            problem=problem,
            light=light,
            specular=specular,
            mesh=mesh,
            tracer=tracer,
            capture=capture,
            views=views,
            config=config,
            inside=inside,
            atlas=atlas,
            lit=lit,
            values=texel_albedo(lit, specular, pipeline),
            pipeline=pipeline,
        )


def _check_photographs(state: Texture) -> Texture:
    asset = Asset(
        problem=state.problem, light=state.light, specular=state.specular, values=state.values
    )
    if (lit := state.lit) is None:
        raise RuntimeError("photographs were heard before")
    texels = lit.texels

    def read(specular: SpecularMaterial) -> TexelAlbedo:
        return texel_albedo(lit, specular, state.pipeline)

    check = PhotographCheck(state.problem, texels, state.views, state.tracer)
    checked = check_asset(check, asset, read, texels)
    return replace(
        state,
        lit=None,
        specular=checked.asset.specular,
        values=checked.asset.values,
        checked=checked,
    )


def _refine_detail(state: Texture) -> Texture:
    cameras = {view.name: view.camera for view in state.capture.views}
    width = pixel_width(state.problem.scene.transport, cameras)
    most = most_side(state.config, state.mesh.cells)
    side = texture_side(state.mesh, width, (len(state.inside), most))
    photographs = spread_views(state.capture.train, _DETAIL_VIEWS)
    views = SharpestViews((state.mesh, state.tracer), photographs, state.problem.curve)
    values = regained(state.values, state.atlas, views, width)
    inside, values = finer(values, state.inside, views, side)
    return replace(state, inside=inside, values=values)


def _hold_to_known_albedo(state: Texture) -> Texture:
    known = state.problem.scene.known_albedo
    if known is None:
        return state
    off = known.off(state.values.albedo[known.texels(state.inside)])
    values = replace(
        state.values,
        albedo=state.values.albedo * np.exp(-off),
        read=state.values.read * np.exp(-off),
    )
    return replace(state, values=values, light=state.light.tinted(torch.from_numpy(off)))


# what is done to the texels once their albedo was read, in this order
TEXTURE: tuple[Step[Texture], ...] = (
    Step(
        name="last-word",
        purpose="takes back, block by block, what shows photographs worse than their mean does",
        source="ours: no block of the surface may be worse than the mean by more than chance",
        run=_check_photographs,
    ),
    Step(
        name="detail",
        purpose="adds what the sharpest photographs show finer than the mean of all does",
        source="multi-band blending (Burt and Adelson 1983; Allene et al. 2008)",
        run=_refine_detail,
    ),
    Step(
        name="known-paint",
        purpose="makes a spot of known paint what it is, and the light as much dimmer",
        source="calibration by a known patch, as of a colour checker",
        run=_hold_to_known_albedo,
        is_on_trial=False,
    ),
)
