# SPDX-License-Identifier: Apache-2.0
"""The geometry stage: capture in, unwrapped mesh out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from robir.capture.capture import Capture
from robir.capture.store import load_capture, save_masks, save_turned
from robir.errors import CaptureError
from robir.geometry.brightness import evened
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.clean import restore_missing
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.field_preview import Preview, Renderer
from robir.geometry.fit.held_out import save_field_views
from robir.geometry.fit.mirror_pits import Mirroring
from robir.geometry.fit.optimise import fit
from robir.geometry.fit.pose_trial import CamerasChangedError, PoseTrial
from robir.geometry.ground.backdrop import Backdrop
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import detect
from robir.geometry.ground.undercut import undercut
from robir.geometry.hull import object_hull
from robir.geometry.lattice import resample
from robir.geometry.mesh.facets import flattened
from robir.geometry.mesh.simplify import decimate, fill_holes, with_creases
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import unwrap
from robir.geometry.rays import Photo, RaySampler, reduce_view
from robir.geometry.remask import remasked
from robir.geometry.rival import Rival, smooth_surface
from robir.jobs.choice import Choice
from robir.jobs.context import Reporter, StageContext
from robir.jobs.paths import write_json
from robir.maths.vectors import farthest_points

REVISION = 29
"""Raised whenever the same input gives another result."""

MASKING = 0.02
"""Share of the stage that cutting masks again takes."""

GROUND_SIDE = 200
"""Longer side of the photographs that tell the ground, pixels."""


def run(context: StageContext[GeometryConfig]) -> dict[str, float | str]:
    """Reconstruct the surface of the stored capture.

    Args:
        context: Configuration, paths, seed, device and reporter.

    Returns:
        Metrics for the stage's manifest.
    """
    capture = load_capture(context.paths.stage("capture")).normalised()
    if capture.has_guessed_masks and context.config.stereo.image_side:
        capture = remasked(
            capture,
            context.config,
            lambda share: context.reporter.progress(
                MASKING * share, "cutting the object out again, by its surface"
            ),
        )
        save_masks(context.paths, capture.views)
    preview = Preview(capture, context.paths.preview, context.device, context.reporter)
    trial = PoseTrial(capture, context.seed, context.device)
    total = sum(context.config.level_steps)
    held_out = context.paths.stage("geometry") / "field_held_out.npz"

    def watch(share: float, render: Renderer, sampler: RaySampler) -> None:
        if share == 1.0:
            save_field_views(held_out, trial.capture.held_out, render, context.device)
            return
        preview.show(render)
        if context.config.refine_poses:
            trial.look(round(share * total), render, sampler)

    while True:
        try:
            surface = reconstruct(
                trial.capture, context.config, context.seed, context.device, context.reporter, watch
            )
            break
        except CamerasChangedError:
            context.reporter.progress(0.0, "beginning anew with cameras that fit better")
    folder = context.paths.stage("geometry")
    surface.mesh.save(folder / "mesh.npz")
    write_json(folder / "choices.json", [choice.plain() for choice in surface.choices])
    metrics = surface.metrics
    if trial.turns.any():
        metrics |= _tell(context, trial)
    context.reporter.progress(1.0, "surface done")
    return metrics


def _tell(context: StageContext[GeometryConfig], trial: PoseTrial) -> dict[str, float | str]:
    """Store the cameras that were turned, tell the user, and give figures for the manifest."""
    angles = np.degrees(np.linalg.norm(trial.turns, axis=1))
    names = [view.name for view in trial.capture.views]
    save_turned(context.paths, {view.name: view.camera for view in trial.capture.views})
    context.reporter.warn(
        f"The photographs contradict the given cameras, which were turned by "
        f"{np.median(angles):.2f} degrees in the median, at most by {angles.max():.2f} "
        f"({names[int(angles.argmax())]}). The result stands in the given cameras' frame; their "
        "files are as they were. Good cameras from the start give a better result."
    )
    return {
        "turned_degrees_median": round(float(np.median(angles)), 4),
        "turned_degrees_largest": round(float(angles.max()), 4),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """What the stage finds.

    Attributes:
        mesh: Unwrapped, unit frame.
        metrics: For the stage's manifest.
        choices: What was chosen, for the report.
    """

    mesh: Mesh
    metrics: dict[str, float | str]
    choices: tuple[Choice, ...]


def reconstruct(
    capture: Capture,
    config: GeometryConfig,
    seed: int,
    device: str,
    reporter: Reporter,
    watch: Callable[[float, Renderer, RaySampler], None] | None = None,
) -> Surface:
    """Surface of a capture whose bounding sphere is the unit sphere.

    Args:
        capture: Capture in the unit frame.
        config: The stage's configuration.
        seed: Seed of every random choice.
        device: Torch device.
        reporter: Progress and warnings.
        watch: Called every few steps of the fit with the share of it that is done, what renders
            its field, and the source of its rays, or None; at last with 1.0 and the finished field.

    Raises:
        CaptureError: If there are fewer than three training views with a mask.
    """
    if len(capture.train) < 3:
        raise CaptureError(
            f"{capture.source} has {len(capture.train)} training views; the geometry stage needs "
            "at least 3, and about 20 for a good surface."
        )
    reporter.progress(0.0, "carving the visual hull")
    capture = evened(capture)
    photos = [reduce_view(view, config.image_side) for view in capture.train]
    generator = torch.Generator().manual_seed(seed)
    sampler = RaySampler(photos, device, generator)
    settling = _Settling(capture, photos, config, sampler, generator)

    def progress(share: float, render: Renderer) -> None:
        reporter.progress(0.03 + 0.82 * share, "fitting the surface")
        if watch is not None:
            watch(share, render, sampler)

    lattice, start = settling.lattice, settling.start
    field = fit(sampler, (lattice, start.to(device)), config, generator, progress, settling)
    rival = settling.rival
    if rival.leads:
        reporter.progress(0.86, "moving the mesh to where photographs agree")
        mesh = rival.finished()
    else:
        reporter.progress(0.86, "cleaning the mesh")
        mesh = clean_mesh(field, config.face_budget)
    reporter.progress(0.92, "unwrapping the mesh")
    mesh = with_creases(unwrap(mesh, config.unwrap_seconds, reporter.warn))
    has_ground = settling.backdrop is not None and not rival.leads
    metrics: dict[str, float | str] = {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "cell": field.lattice.cell,
        "ground": "flattened" if has_ground else "none",
        "surface": "stereo" if rival.leads else "field",
    }
    return Surface(mesh=mesh, metrics=metrics, choices=rival.choices)


class _Settling:
    """What the fit starts from, and what is done to its field at the end of every level.

    Args:
        capture: Evened, unit frame.
        photos: Its training photographs at the size of the fit.
        config: The stage's configuration.
        sampler: Source of rays.
        generator: Source of random numbers.

    Attributes:
        lattice: Of the visual hull.
        start: (N,) signed distances that the fit starts from.
        backdrop: The ground and what lies behind it; None where there is none.
        rival: The surface by stereo.
    """

    def __init__(
        self,
        capture: Capture,
        photos: list[Photo],
        config: GeometryConfig,
        sampler: RaySampler,
        generator: torch.Generator,
    ) -> None:
        self.lattice, hull = object_hull(capture, photos, config)
        self.backdrop: Backdrop | None = None
        plane = detect(photos, self.lattice, hull, generator)
        if plane is not None:
            judges = ground_photos(capture, config)
            ground = Ground(plane, judges, self.lattice, hull)
            backdrop = Backdrop(ground, judges)
            hull = ground.flatten(self.lattice, hull, ground.start & ~backdrop.foreign)
            self.backdrop = backdrop
        self._hull, self._sampler = hull, sampler
        self.start = hull if self.backdrop is None else self.backdrop.clear(self.lattice, hull)
        begun = self.lattice, self.start
        self._mirroring = Mirroring([photo.camera for photo in photos], begun)
        self.rival = Rival(capture.train, photos, begun, config)

    def __call__(self, field: Field, network: ColourNetwork) -> bool:
        """Mend the field in place; whether the fit ends because the rival leads."""
        sdf = field.sdf.detach()
        allowed = resample(self._hull, self.lattice, field.lattice).to(sdf.device)
        sdf.copy_(restore_missing(field, allowed, self._sampler))
        sdf.copy_(self._mirroring.filled(field, network))
        if self.backdrop is not None:
            ground = self.backdrop.ground
            top = ground.heights(field.lattice, sdf)
            settled = ground.settled(top, self.backdrop.known)
            ground.find_terraces(top, settled)
            if ground.is_flat(field.lattice.cell, top, settled):
                sdf.copy_(ground.flatten(field.lattice, sdf, settled))
                sdf.copy_(undercut(self.backdrop, settled, field.lattice, sdf))
            else:
                self.backdrop = None
        return self.rival.beats(field)


def clean_mesh(field: Field, face_budget: int) -> Mesh:
    """Surface of a field: extracted, freed of loose pieces, smoothed and decimated."""
    mesh = flattened(smooth_surface(field), field.lattice.cell)
    return fill_holes(decimate(mesh, face_budget))


def ground_photos(capture: Capture, config: GeometryConfig) -> list[Photo]:
    """The training photographs by which ground is told from what stands on it.

    A few that see through a point free it, and where they do is cleaned of specks by pixels: both
    are right for so many photographs of such a size. Of more and finer ones a few always agree by
    chance, and what mirrors the ground is cut away: of a vase and a bottle the lower halves.

    Args:
        capture: Capture in the unit frame.
        config: The stage's configuration.
    """
    views = capture.train
    positions = np.stack([view.camera.position for view in views])
    side = min(config.image_side, GROUND_SIDE)
    return [reduce_view(views[k], side) for k in farthest_points(positions, config.hull_views)]
