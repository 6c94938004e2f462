# SPDX-License-Identifier: Apache-2.0
"""What the fit starts from, and what is done to its field at the end of every level, as steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from robir.capture.capture import Capture
from robir.geometry.brightness import evened
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.clean import restore_missing
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.mirror_pits import Mirroring
from robir.geometry.ground.backdrop import Backdrop
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import detect
from robir.geometry.hull import HULL_VIEWS, object_hull
from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.prediction import Predictions
from robir.geometry.rays import Photo, RaySampler, reduce_view
from robir.geometry.rival import Judge, Rival
from robir.maths.vectors import farthest_points
from robir.steps import Course, Step

EVENING: tuple[Step[Capture], ...] = (
    Step(
        name="even-brightness",
        purpose="brings photographs that were exposed apart to one brightness for the fit",
        source="ours: a power stands for the tone curve",
        run=evened,
    ),
)
"""What is done to the photographs before the fit."""


# distance from the plane within which a surface may be ground that the fit left bumpy (cells)
_BUMPY = 4.0
_BUMPY_GAIN = 1.1  # times as many columns as are ground for certain from which that is asked
_IMAGE_SIDE = 200  # longer side of the photographs that tell the ground (pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """What the fit starts from.

    Attributes:
        capture: Evened, unit frame.
        config: The stage's configuration.
        generator: Source of random numbers.
        photos: Training photographs at the size of the fit.
        lattice: Of the visual hull.
        hull: (N,) its signed distances, with ground once there is one.
        backdrop: The ground and what lies behind it; None where there is none.
    """

    capture: Capture
    config: GeometryConfig
    generator: torch.Generator
    photos: list[Photo]
    lattice: Lattice
    hull: Tensor
    backdrop: Backdrop | None = None

    @property
    def distances(self) -> Tensor:
        """(N,) signed distances that the fit starts from."""
        return self.hull if self.backdrop is None else self.backdrop.clear(self.lattice, self.hull)


def _find_ground(state: Start) -> Start:
    plane = detect(state.photos, state.lattice, state.hull, state.generator)
    if plane is None:
        return state
    judges = ground_photos(state.capture, state.config)
    ground = Ground(plane, judges, state.lattice, state.hull)
    backdrop = Backdrop(ground, judges)
    hull = ground.flatten(state.lattice, state.hull, ground.start & ~backdrop.foreign)
    return replace(state, hull=hull, backdrop=backdrop)


GROUND: tuple[Step[Start], ...] = (
    Step(
        name="ground",
        purpose="finds the flat ground that the object stands on, and takes it as a backdrop",
        source="ours: plane by the masks' rim, columns by photo-consistency",
        run=_find_ground,
    ),
)
"""What is done to the visual hull before the fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A level of the fit that has ended; steps change its field's distances by `mended`.

    Attributes:
        field: Field of the level.
        network: Its colour network.
        sampler: Source of rays.
        hull: Lattice and signed distances of the visual hull.
        mirroring: What was learnt of parts that mirror.
        judge: What photographs say of surfaces.
        rival: The surfaces by depth maps and by masks alone.
        backdrop: The ground; None where there is none, or none any more.
        has_ended: Whether the fit goes no further.
        changes: How often something was changed in place.
    """

    field: Field
    network: ColourNetwork
    sampler: RaySampler
    hull: Sampled
    mirroring: Mirroring
    judge: Judge
    rival: Rival
    backdrop: Backdrop | None
    has_ended: bool = False
    changes: int = 0

    @property
    def sdf(self) -> Tensor:
        """(N,) signed distances, to be changed in place."""
        return self.field.sdf.detach()

    def mended(self, sdf: Tensor) -> Level:
        """The level with other distances (N,), changed in place; itself where they are the same."""
        if torch.equal(sdf.to(self.sdf), self.sdf):
            return self
        self.sdf.copy_(sdf)
        return replace(self, changes=self.changes + 1)


def _restore_missing(state: Level) -> Level:
    lattice, hull = state.hull
    allowed = resample(hull, lattice, state.field.lattice).to(state.sdf.device)
    return state.mended(restore_missing(state.field, allowed, state.sampler))


def _fill_mirror_pits(state: Level) -> Level:
    return state.mended(state.mirroring.filled(state.field, state.network))


def _flatten_ground(state: Level) -> Level:
    """A ground that turns out to be a bowl is none."""
    if state.backdrop is None:
        return state
    ground, lattice = state.backdrop.ground, state.field.lattice
    top = ground.heights(lattice, state.sdf)
    columns = ground.settled(top, state.backdrop.known)
    if not ground.is_flat(lattice.cell, top, columns):
        return replace(state, backdrop=None)
    flat = ground.flatten(lattice, state.sdf, columns)
    nearly = ground.nearly(top, columns, _BUMPY * lattice.cell)
    if nearly.sum() > _BUMPY_GAIN * columns.sum():
        # glossy or plain ground is bumpy where no photograph's foot tells that it is ground
        flatter = ground.flatten(lattice, state.sdf, nearly)
        if state.judge.is_better(Field(lattice, flatter, 1), Field(lattice, flat, 1)):
            flat = flatter
    return state.mended(flat)


def _ask_rivals(state: Level) -> Level:
    return replace(state, has_ended=state.rival.beats(state.field))


LEVEL: tuple[Step[Level], ...] = (
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
        run=_fill_mirror_pits,
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
        run=_ask_rivals,
    ),
)
"""What is done at the end of every level of the fit, in this order."""


class Settling:
    """What the fit starts from, and what it calls at the end of every level.

    Args:
        capture: Evened, unit frame.
        config: The stage's configuration.
        device: Torch device.
        generator: Source of random numbers.
        course: Of the stage's steps.

    Attributes:
        sampler: Source of rays.
        begun: Lattice and signed distances that the fit starts from.
        backdrop: The ground as far as the fit has got.
        rival: The surfaces by depth maps and by masks alone.
    """

    def __init__(
        self,
        capture: Capture,
        config: GeometryConfig,
        device: str,
        generator: torch.Generator,
        course: Course,
    ) -> None:
        photos = [reduce_view(view, config.image_side) for view in capture.train]
        self.sampler = RaySampler(photos, device, generator)
        lattice, hull = object_hull(capture, photos, config.hull_cells)
        start = Start(
            capture=capture,
            config=config,
            generator=generator,
            photos=photos,
            lattice=lattice,
            hull=hull,
        )
        self._course = course
        start = course.carry_out(GROUND, start)
        self.backdrop, self._hull = start.backdrop, start.hull
        self.begun = Sampled(lattice, start.distances)
        predictions = Predictions(photos)
        self._judge = Judge(predictions)
        cameras = [photo.camera for photo in photos]
        self._mirroring = Mirroring(cameras, self.begun, self._judge)
        self.rival = Rival(capture.train, predictions, (self.begun, Sampled(lattice, hull)), config)

    def __call__(self, field: Field, network: ColourNetwork) -> bool:
        """Mend the field in place; whether the fit ends because the rival leads."""
        level = Level(
            field=field,
            network=network,
            sampler=self.sampler,
            hull=Sampled(self.begun.lattice, self._hull),
            mirroring=self._mirroring,
            judge=self._judge,
            rival=self.rival,
            backdrop=self.backdrop,
        )
        ended = self._course.carry_out(LEVEL, level)
        self.backdrop = ended.backdrop
        return ended.has_ended


def ground_photos(capture: Capture, config: GeometryConfig) -> list[Photo]:
    """The training photographs by which ground is told from what stands on it.

    A few that see through a point free it, and where they do is cleaned of specks by pixels: both
    are right for so many photographs of such a size. Of more and finer ones a few always agree by
    chance, and what mirrors the ground is cut away.

    Args:
        capture: Capture in the unit frame.
        config: The stage's configuration.
    """
    views = capture.train
    positions = np.stack([view.camera.position for view in views])
    side = min(config.image_side, _IMAGE_SIDE)
    return [reduce_view(views[k], side) for k in farthest_points(positions, HULL_VIEWS)]
