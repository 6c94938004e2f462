# SPDX-License-Identifier: Apache-2.0
"""Textures of the whole atlas, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.photograph_check import Asset, CheckResult, PhotographCheck, check_asset
from robir.appearance.texture.albedo import texel_albedo
from robir.appearance.texture.detail import finer
from robir.appearance.texture.texel_size import (
    most_side,
    pixel_width,
    solved_side,
    texture_side,
)
from robir.appearance.texture.texels import TexelAlbedo, Texels
from robir.capture.capture import Capture, View
from robir.capture.images.loading import resize_views
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.steps import Pipeline, Step
from robir.transport.observe import spread_views
from robir.transport.surfels import interpolate

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
    own_tracer: EmbreeTracer  # of the mesh itself, by whose faces texels are found
    capture: Capture  # photographs that take part, unit frame
    views: tuple[View, ...]  # those that albedo is read from, at the size that they are read at
    config: AppearanceConfig  # sizes
    inside: NDArray[np.bool_]  # (T, T) bool, texels that belong to a chart, row 0 at v = 1
    # face (N,) and barycentric coordinates (N, 3) of the texels that were solved
    atlas: tuple[NDArray[np.int32], Floats]
    values: TexelAlbedo  # of these texels
    pipeline: Pipeline = field(compare=False)  # of the stage's steps, for what is read again
    # result of the photograph check; None before it
    checked: CheckResult | None = field(default=None, compare=False)


def textured(
    solved: tuple[Problem, Light, SpecularMaterial],
    surface: tuple[Mesh, EmbreeTracer, EmbreeTracer],
    capture: Capture,
    config: AppearanceConfig,
    pipeline: Pipeline,
) -> Texture:
    """Texels of the atlas at the side that photographs resolve.

    Of an unwrapped mesh, unit frame, with the tracer of the mesh for light and its own. `capture`
    must lack photographs under another light: their shade would darken the texture of all.
    """
    (problem, light, specular), (mesh, tracer, own_tracer) = solved, surface
    side = solved_side(config, mesh.cells)
    face, barycentric = rasterise_atlas(mesh, side)
    inside = face >= 0
    atlas = (face[inside], barycentric[inside].astype(np.float32))
    position, normal = interpolate(mesh, *atlas)
    texels = Texels(position=position, normal=normal)
    # a pixel about as large as a texel
    spread = spread_views(capture.train, _ALBEDO_VIEWS)
    views = resize_views(spread, side)
    start = Texture(
        problem=problem,
        light=light,
        specular=specular,
        mesh=mesh,
        tracer=tracer,
        own_tracer=own_tracer,
        capture=capture,
        views=views,
        config=config,
        inside=inside,
        atlas=atlas,
        values=texel_albedo(solved, texels, views, tracer, pipeline),
        pipeline=pipeline,
    )
    return pipeline.run(TEXTURE, start)


def _check_photographs(state: Texture) -> Texture:
    asset = Asset(
        problem=state.problem, light=state.light, specular=state.specular, values=state.values
    )
    position, normal = interpolate(state.mesh, *state.atlas)
    texels = Texels(position=position, normal=normal)

    def read(specular: SpecularMaterial) -> TexelAlbedo:
        solved = (state.problem, state.light, specular)
        return texel_albedo(solved, texels, state.views, state.tracer, state.pipeline)

    check = PhotographCheck(state.problem, texels, state.views, state.tracer)
    checked = check_asset(check, asset, read, texels)
    return replace(
        state, specular=checked.asset.specular, values=checked.asset.values, checked=checked
    )


def _refine_detail(state: Texture) -> Texture:
    cameras = {view.name: view.camera for view in state.capture.views}
    width = pixel_width(state.problem.scene.transport, cameras)
    most = most_side(state.config, state.mesh.cells)
    side = texture_side(state.mesh, width, (len(state.inside), most))
    views = spread_views(state.capture.train, _DETAIL_VIEWS)
    photographs = (views, state.problem.curve)
    surface = (state.mesh, state.tracer)
    inside, values = finer(state.values, state.inside, surface, photographs, side)
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
        purpose="adds what the sharpest photographs show finer than the solved texels",
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
