# SPDX-License-Identifier: Apache-2.0
"""The capture value that every reader makes and every stage reads."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.support import Plane
from robir.maths.similarity import Similarity

Split = Literal["train", "held_out"]
Level = Literal["note", "warning", "error"]  # of a finding; an error refuses the capture


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """One photograph with its camera."""

    name: str  # unique within the capture, fit for a file name
    image_display: NDArray[np.uint8]  # (H, W, 3), display-referred, straight alpha
    mask: NDArray[np.uint8]  # (H, W) uint8, coverage of the object, 255 inside
    camera: Camera  # camera of exactly this image size
    split: Split  # "train" views are fitted, "held_out" views only judge


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Bounding sphere of the object, in the capture's own frame and unit."""

    centre: NDArray[np.float64]  # (3,) float64
    radius: float  # in the capture's unit, > 0
    origin: str  # how it was found, one clause for the user
    is_limit: bool = False  # whether a format promises that the object lies inside

    def moved(self, place: Similarity) -> Bounds:
        """The sphere where a similarity brings it."""
        centre = place(self.centre[None])[0]
        return replace(self, centre=centre, radius=place.scale * self.radius)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Something `robir check` tells the user."""

    level: Level  # "note" informs, "warning" lowers the result, "error" refuses the capture
    code: str  # short stable name such as "missing-images"
    message: str  # what was found, where
    cure: str = ""  # what to do about it
    files: tuple[str, ...] = ()  # file names concerned, at most a dozen
    numbers: dict[str, Any] = field(default_factory=dict)  # measured, as JSON; the check says what

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Finding:
        """The finding of which `dataclasses.asdict` made plain values."""
        return cls(**{**plain, "files": tuple(plain["files"])})


PHOTOGRAPHS_ALONE = "photos"  # format of photographs, or a video, whose cameras we find
GUESSED_MASKS = "guessed-masks"
# codes of findings about masks that we cut: by colours and poses, by the one colour of the
# backdrop, and roughly about a mesh that was handed in
BACKDROP_MASKS, MESH_MASKS = "backdrop-masks", "mesh-masks"


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """Posed, masked photographs of one object."""

    source: Path  # folder or file it was read from
    format: str  # name of the format as recognised, for example "nerf-synthetic"
    views: tuple[View, ...]  # photographs in the capture's own frame
    bounds: Bounds  # bounding sphere of the object
    findings: tuple[Finding, ...] = field(default=())  # what the readers and checks noticed
    table: Plane | None = None  # what guessed masks found that the object stands on
    is_linear: bool = False  # whether no photograph went through a tone curve but sRGB's
    # file of each view by its name, while it is known; not stored
    photographs: Mapping[str, Path] = field(default_factory=dict)

    @property
    def train(self) -> tuple[View, ...]:
        """Views that are fitted."""
        return tuple(view for view in self.views if view.split == "train")

    @property
    def held_out(self) -> tuple[View, ...]:
        """Views held out to judge the result."""
        return tuple(view for view in self.views if view.split == "held_out")

    @property
    def has_frame_of_ours(self) -> bool:
        """Whether poses were found from the photographs, so that its frame means nothing."""
        return self.format == PHOTOGRAPHS_ALONE

    @property
    def has_guessed_masks(self) -> bool:
        """Whether the object was cut out by us, and without any of the ground it stands on."""
        return any(finding.code == GUESSED_MASKS for finding in self.findings)

    def without(self, names: Collection[str]) -> Capture:
        """The capture without some views."""
        return replace(self, views=tuple(view for view in self.views if view.name not in names))

    def normalised(self) -> Capture:
        """The capture in the frame where its bounding sphere is the unit sphere at the origin."""
        bounds = self.bounds
        views = tuple(
            replace(view, camera=view.camera.normalised(bounds.centre, bounds.radius))
            for view in self.views
        )
        unit = Bounds(centre=np.zeros(3), radius=1.0, origin=bounds.origin)
        table = None if self.table is None else self.table.normalised(bounds.centre, bounds.radius)
        return replace(self, views=views, bounds=unit, table=table)

    def moved(self, place: Similarity) -> Capture:
        """The capture in another frame, to which a similarity that does not mirror brings it."""
        views = tuple(replace(view, camera=view.camera.moved(place)) for view in self.views)
        table = None if self.table is None else self.table.moved(place)
        return replace(self, views=views, bounds=self.bounds.moved(place), table=table)
