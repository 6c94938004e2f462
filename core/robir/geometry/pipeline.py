# SPDX-License-Identifier: Apache-2.0
"""The steps of the stage: before the fit, at the end of each of its levels, and on its surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from robir.capture.capture import Capture, View
from robir.capture.checks.photographs import POWER, sight, uneven_exposures
from robir.geometry.base import without_cone
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.field import ColourNetwork, Field, restore_missing
from robir.geometry.fit.mirror_pits import Mirroring
from robir.geometry.ground.backdrop import Backdrop, find_ground
from robir.geometry.hull import object_hull
from robir.geometry.lattice import Sampled, resample
from robir.geometry.mesh.quads import quadrangulated
from robir.geometry.mesh.simplify import decimate, with_creases
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import unwrap
from robir.geometry.pits import without_pits
from robir.geometry.rays import RaySampler, ReducedPhoto, reduce_view
from robir.geometry.selection import Dense, PhotographJudge, Selection
from robir.steps import Pipeline, Step
from robir.workers import side_by_side


def equal_brightness(capture: Capture) -> Capture:
    """A capture whose training photographs are equally bright at the points they share.

    The surface is found where photographs agree on colours; exposed apart they agree nowhere, and
    of a plain ground least of all. The tone curve is not known yet: a power stands for it, so that
    what is left is what the curve's slope differs by between dark and bright. The capture itself
    comes back where its photographs count as exposed alike, or are too few to tell.
    """
    views = capture.train
    offsets = uneven_exposures(views, capture.bounds, sight(views, capture.bounds))
    if offsets is None:
        return capture
    dimmed = {
        view.name: _brighter(view, -stops) for view, stops in zip(views, offsets, strict=True)
    }
    return replace(capture, views=tuple(dimmed.get(v.name, v) for v in capture.views))


def _brighter(view: View, stops: float) -> View:
    """A view with so many stops (log2) more light."""
    display = np.rint(view.image_display * 2.0 ** (stops / POWER)).clip(0, 255)
    return replace(view, image_display=display.astype(np.uint8))


# what is done to the photographs before the fit
BRIGHTNESS: tuple[Step[Capture], ...] = (
    Step(
        name="even-brightness",
        purpose="brings photographs that were exposed apart to one brightness for the fit",
        source="ours: a power stands for the tone curve",
        run=equal_brightness,
    ),
)

# distance from the plane within which a surface may be ground that the fit left bumpy (cells)
_BUMPY = 4.0
# lead in standard errors from which the flatter ground is taken: below what hangs over it few
# photographs see it, and what stands there leads by 3 or more
_FLATTER = -1.0
_UNSEEN = 0.1  # distance that fewer faces may move the surface (pixels of the finest photographs)
_BUMPY_GAIN = 1.1  # times as many columns as are ground for certain from which that is asked


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """What the fit starts from."""

    capture: Capture  # evened, unit frame
    config: GeometryConfig  # the stage's configuration
    generator: torch.Generator  # source of random numbers
    photos: list[ReducedPhoto]  # training photographs at the size of the fit
    hull: Sampled  # the visual hull, with flat ground once that is found
    backdrop: Backdrop | None = None  # the ground and what lies behind it; None where there is none

    @property
    def distances(self) -> Tensor:
        """(N,) signed distances that the fit starts from."""
        return self.hull.values if self.backdrop is None else self.backdrop.clear(*self.hull)


def _find_ground(state: Start) -> Start:
    found = find_ground(state.capture.train, state.photos, state.hull, state.generator)
    if found is None:
        return state
    return replace(state, hull=Sampled(state.hull.lattice, found[1]), backdrop=found[0])


def _cut_cone(state: Start) -> Start:
    if state.backdrop is not None:
        return state
    return replace(state, hull=without_cone(state.hull, state.photos))


# what is done to the visual hull before the fit
GROUND: tuple[Step[Start], ...] = (
    Step(
        name="ground",
        purpose="finds the flat ground that the object stands on, if masks include it",
        source="ours: plane by the masks' rim, columns by photo-consistency",
        run=_find_ground,
    ),
    Step(
        name="base",
        purpose="ends what stands on something there: below it the visual hull has a cone",
        source="ours: of the planes below what cameras meet first, the one that cuts off most",
        run=_cut_cone,
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FitLevel:
    """A level of the fit that has ended; steps change its field's distances by `mended`."""

    field: Field  # field of the level
    network: ColourNetwork  # its colour network
    sampler: RaySampler  # source of rays
    hull: Sampled  # the visual hull
    mirroring: Mirroring  # what was learnt of parts that mirror
    selection: Selection  # what photographs say of surfaces
    backdrop: Backdrop | None  # the ground; None where there is none, or none any more
    has_ended: bool = False  # whether the fit goes no further
    changes: int = 0  # how often something was changed in place

    @property
    def surface(self) -> Sampled:
        """The signed distances, to be changed in place."""
        return Sampled(self.field.lattice, self.field.sdf.detach())

    def mended(self, sdf: Tensor) -> FitLevel:
        """The level with other distances (N,), changed in place; itself where they are the same."""
        now = self.surface.values
        if torch.equal(sdf.to(now), now):
            return self
        now.copy_(sdf)
        return replace(self, changes=self.changes + 1)


def _restore_missing(state: FitLevel) -> FitLevel:
    lattice, sdf = state.surface
    allowed = resample(state.hull.values, state.hull.lattice, lattice).to(sdf.device)
    return state.mended(restore_missing(state.surface, allowed, state.sampler))


def _flat_ground(backdrop: Backdrop, selection: Selection, surface: Sampled) -> Tensor | None:
    """Distances (N,) of a surface with its ground made flat; None where that is a bowl."""
    ground, (lattice, sdf) = backdrop.ground, surface
    top = ground.heights(lattice, sdf)
    columns = ground.settled(top, backdrop.known)
    if not ground.is_flat(lattice.cell, top, columns):
        return None
    flat = ground.flatten(lattice, sdf, columns)
    # glossy or plain ground is bumpy where no photograph's foot tells that it is ground
    nearly = ground.nearly(top, columns, _BUMPY * lattice.cell)
    overhung = ground.overhung(lattice, sdf, nearly)
    if (nearly | np.isfinite(overhung)).sum() > _BUMPY_GAIN * columns.sum():
        flatter = ground.flatten(lattice, sdf, nearly, overhung)
        surfaces = Sampled(lattice, flatter), Sampled(lattice, flat)
        if selection.is_better(*surfaces, least=_FLATTER):
            flat = flatter
    return flat


def _flatten_ground(state: FitLevel) -> FitLevel:
    """A ground that turns out to be a bowl is none."""
    if state.backdrop is None:
        return state
    flat = _flat_ground(state.backdrop, state.selection, state.surface)
    return replace(state, backdrop=None) if flat is None else state.mended(flat)


def _compare(state: FitLevel) -> FitLevel:
    """The ground of depth maps is made flat before they are compared."""

    def with_ground(surface: Sampled) -> Sampled:
        if state.backdrop is None:
            return surface
        flat = _flat_ground(state.backdrop, state.selection, surface)
        return surface if flat is None else surface._replace(values=flat)

    return replace(state, has_ended=state.selection.has_better(state.surface, with_ground))


# what is done at the end of every level of the fit, in this order
LEVEL: tuple[Step[FitLevel], ...] = (
    Step(
        name="missing-parts",
        purpose="brings back thin parts that the masks demand and the fit has lost",
        source="ours",
        run=_restore_missing,
    ),
    Step(
        name="mirror-pits",
        purpose="fills hollows that mirrored light has dug",
        source="ours: one half of a mean curvature flow",
        run=lambda state: state.mended(state.mirroring.filled(state.field, state.network)),
    ),
    Step(
        name="flat-ground",
        purpose="tells columns of ground from what stands on it, and makes ground flat",
        source="ours: photo-consistency of columns' feet",
        run=_flatten_ground,
    ),
    Step(
        name="rivals",
        purpose="ends the fit where depth maps or masks alone explain photographs better",
        source="semi-global matching (Hirschmueller 2008), patch refinement (Furukawa 2010), "
        "visual hull (Laurentini 1994)",
        run=_compare,
    ),
)


class Levels:
    """What the fit starts from (`begun`), and what it calls at the end of every level."""

    def __init__(
        self,
        capture: Capture,
        config: GeometryConfig,
        device: str,
        generator: torch.Generator,
        pipeline: Pipeline,
    ) -> None:
        photos = side_by_side(lambda view: reduce_view(view, config.image_side), capture.train)
        self.sampler = RaySampler(photos, device, generator)
        hull = object_hull(capture, photos, config.hull_cells)
        start = Start(capture=capture, config=config, generator=generator, photos=photos, hull=hull)
        self._pipeline = pipeline
        start = pipeline.run(GROUND, start)
        self.backdrop, self._hull = start.backdrop, start.hull
        by_masks = start.hull if start.backdrop is None else hull
        self.begun = Sampled(hull.lattice, start.distances)
        self.selection = Selection(
            capture.train,
            photos,
            (self.begun, by_masks),
            config,
            holds_masks=not capture.has_guessed_masks,
        )
        cameras = [photo.camera for photo in photos]
        self._mirroring = Mirroring(cameras, self.begun, self.selection)

    def __call__(self, field: Field, network: ColourNetwork) -> bool:
        """Mend the field in place; whether the fit ends because another surface leads."""
        level = FitLevel(
            field=field,
            network=network,
            sampler=self.sampler,
            hull=self._hull,
            mirroring=self._mirroring,
            selection=self.selection,
            backdrop=self.backdrop,
        )
        ended = self._pipeline.run(LEVEL, level)
        self.backdrop = ended.backdrop
        return ended.has_ended


@dataclass(frozen=True, slots=True, kw_only=True)
class PostProcessing:
    """A surface on its way to a mesh."""

    dense: Dense  # as it was extracted
    mesh: Mesh  # as far as it has got
    config: GeometryConfig  # the stage's configuration
    judge: PhotographJudge | None  # what photographs say of it; None where they are not asked
    warn: Callable[[str], None]  # takes a sentence for the user


def post_processed(
    dense: Dense,
    config: GeometryConfig,
    warn: Callable[[str], None],
    pipeline: Pipeline,
    judge: PhotographJudge | None = None,
) -> Mesh:
    """The unwrapped mesh of an extracted surface; without a judge flat parts and pits stay."""
    start = PostProcessing(dense=dense, mesh=dense.mesh, config=config, judge=judge, warn=warn)
    return pipeline.run(POST_PROCESSING, start).mesh


def _make_flat(state: PostProcessing) -> PostProcessing:
    if state.judge is None:
        return state
    mesh = state.mesh
    for width in state.dense.widths:
        mesh = state.judge.with_flat_parts(mesh, width, follows=state.dense.is_smooth)
    return replace(state, mesh=mesh)


def _decimate(state: PostProcessing) -> PostProcessing:
    if state.config.quads:
        made = quadrangulated(state.mesh, state.dense.faces)
        if made is not None:
            return replace(state, mesh=made)
        state.warn(
            "The surface is made of triangles: with quads of this size a part of it would be lost. "
            "Allow more faces (geometry.face_budget), or thicken thin parts in Blender."
        )
    tolerance = 0.0 if state.judge is None else _UNSEEN * state.judge.pixel
    return replace(state, mesh=decimate(state.mesh, state.dense.faces, tolerance))


def _fill_pits(state: PostProcessing) -> PostProcessing:
    if state.judge is None:
        return state
    return replace(state, mesh=without_pits(state.mesh, state.judge.predictions))


# what is done to the surface that was chosen, in this order
POST_PROCESSING: tuple[Step[PostProcessing], ...] = (
    Step(
        name="facets",
        purpose="makes large flat parts flat, with sharp edges, where photographs do not object",
        source="RANSAC for planes (Schnabel et al. 2007), seeds at even steps of area",
        run=_make_flat,
    ),
    Step(
        name="decimate",
        purpose="leaves the triangles that photographs resolve",
        source="quadric error metrics (Garland and Heckbert 1997)",
        run=_decimate,
        is_on_trial=False,
    ),
    Step(
        name="pits",
        purpose="fills lone craters that photographs do not ask for",
        source="ours: depth below a mean curvature flow, medians over photographs",
        run=_fill_pits,
    ),
    Step(
        name="unwrap",
        purpose="gives texture coordinates",
        source="xatlas",
        run=lambda state: replace(
            state, mesh=unwrap(state.mesh, state.config.unwrap_seconds, state.warn)
        ),
        is_on_trial=False,
    ),
    Step(
        name="creases",
        purpose="gives each side of a sharp edge normals of its own",
        source="smoothing groups by angle",
        run=lambda state: replace(state, mesh=with_creases(state.mesh)),
    ),
)
