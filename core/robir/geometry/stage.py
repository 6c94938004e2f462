# SPDX-License-Identifier: Apache-2.0
"""The geometry stage: capture in, unwrapped mesh out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from robir.capture.capture import Capture
from robir.capture.store import load_capture, save_frame, save_masks
from robir.errors import CaptureError
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.optimise import fit
from robir.geometry.fit.preview import Present, Preview, save_field_views, save_growing
from robir.geometry.given.surface import hand_in
from robir.geometry.ground.plane import SupportPlane
from robir.geometry.lattice import Sampled
from robir.geometry.mesh.quads import refuse_without_library
from robir.geometry.mesh.triangles import LIGHT, Mesh
from robir.geometry.pipeline import (
    BRIGHTNESS,
    GROUND,
    LEVEL,
    POST_PROCESSING,
    Levels,
    post_processed,
)
from robir.geometry.remask import remasked
from robir.geometry.selection import FIELD
from robir.jobs.context import Choice, Reporter, StageContext
from robir.jobs.paths import of_tile, replacing, write_json
from robir.steps import Pipeline, Step, check_left_out

REVISION = 56  # raised whenever the same input gives another result

MASKING = 0.02  # share of the stage that cutting masks again takes

# all steps of the stage, in their order; LEVEL's once a level of the fit
STEPS: tuple[Step[Any], ...] = (*BRIGHTNESS, *GROUND, *LEVEL, *POST_PROCESSING)


def run(context: StageContext[GeometryConfig]) -> dict[str, float | str]:
    """Reconstruct the surface of the stored capture; metrics for the stage's manifest."""
    check_left_out(STEPS, context.config.without, "geometry.without")
    if context.config.quads:
        refuse_without_library()
    stored = load_capture(context.paths.stage("capture"))
    context.paths.growing.unlink(missing_ok=True)  # of another run, perhaps of another capture
    if context.mesh is not None:
        return _take(context, context.mesh, stored)
    capture = stored.normalised()
    if capture.has_guessed_masks and context.config.stereo_side:
        capture = remasked(
            capture,
            context.config,
            lambda share: context.reporter.progress(
                MASKING * share, "cutting the object out again, by its surface"
            ),
        )
        save_masks(context.paths, capture.views)
    preview = Preview(capture, context.paths.preview, context.device, context.reporter)
    folder = context.paths.stage("geometry")

    def watch(share: float, present: Present) -> None:
        if share == 1.0:
            file = folder / "field_held_out.npz"
            save_field_views(file, capture.held_out, present.render, context.device)
        elif preview.show(present.render):
            save_growing(context.paths.growing, present.surface, stored.bounds)

    surface = reconstruct(
        capture, context.config, context.seed, context.device, context.reporter, watch
    )
    surface.mesh.save(folder / "mesh.npz")
    write_json(folder / "choices.json", [choice.plain() for choice in surface.choices])
    write_json(context.paths.steps("geometry"), surface.steps)
    if surface.ground is not None:
        normal = surface.ground.axes[2]
        plane = {"normal": normal.tolist(), "offset": float(normal @ surface.ground.origin)}
        write_json(context.paths.ground, plane)
    context.reporter.progress(1.0, "surface done")
    return surface.metrics


def _take(
    context: StageContext[GeometryConfig], mesh: Path, capture: Capture
) -> dict[str, float | str]:
    """Take the user's mesh instead of a surface of our own."""
    folder = context.paths.stage("geometry")
    captures = (capture, capture.normalised())
    handed = hand_in(mesh, captures, context.config, context.paths.mesh_fit, context.reporter)
    for note in handed.notes:
        context.reporter.warn(note)
    if handed.views is not None:
        save_masks(context.paths, handed.views)
    if handed.frame is not None:
        save_frame(context.paths, *handed.frame)
    handed.mesh.save(folder / "mesh.npz")
    if handed.light is not None:
        handed.light.save(folder / LIGHT)
    tiles = handed.mesh.tiles.tolist() or [None]
    for tile, normals in zip(tiles, handed.normal_maps, strict=bool(handed.normal_maps)):
        with replacing(of_tile(context.paths.normal_map, tile)) as temporary:
            Image.fromarray(normals).save(temporary, format="PNG", compress_level=1)
    context.reporter.progress(1.0, "mesh taken")
    return handed.metrics


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundSurface:
    """What the stage finds."""

    mesh: Mesh  # unwrapped, unit frame
    metrics: dict[str, float | str]  # for the stage's manifest
    choices: tuple[Choice, ...]  # what was chosen, for the report
    # which steps changed nothing, and what each cost, as `Pipeline.plain` has it
    steps: dict[str, Any]
    ground: SupportPlane | None  # the flat ground that the mesh shows too; None where it shows none


def reconstruct(
    capture: Capture,
    config: GeometryConfig,
    seed: int,
    device: str,
    reporter: Reporter,
    watch: Callable[[float, Present], None] | None = None,
) -> FoundSurface:
    """Surface of a capture in the unit frame.

    `watch` is called every few steps of the fit with the share of it that is done and its field as
    it is, at last with 1.0 and the finished field. `CaptureError` if there are fewer than three
    training views with a mask.
    """
    if len(capture.train) < 3:
        raise CaptureError(
            f"{capture.source} has {len(capture.train)} training views; the geometry stage needs "
            "at least 3, and about 20 for a good surface."
        )
    reporter.progress(0.0, "carving the visual hull")
    pipeline = Pipeline(config.without)
    capture = pipeline.run(BRIGHTNESS, capture)
    generator = torch.Generator().manual_seed(seed)
    levels = Levels(capture, config, device, generator, pipeline)

    def progress(share: float, present: Present) -> None:
        reporter.progress(0.03 + 0.82 * share, "fitting the surface")
        if watch is not None:
            watch(share, present)

    start = levels.begun._replace(values=levels.begun.values.to(device))
    with levels.selection.prepared():
        field = fit(levels.sampler, start, config, generator, progress, levels)
    cell = field.lattice.cell
    best = levels.selection.best
    reporter.progress(0.86, "cleaning the mesh")
    if best is not None:
        dense = best.dense
    else:
        dense = levels.selection.of_fit(Sampled(field.lattice, field.sdf))
    mesh = post_processed(dense, config, reporter.warn, pipeline, levels.selection.judge)
    backdrop = levels.backdrop if best is None else None
    metrics: dict[str, float | str] = {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "cell": cell,
        "ground": "none" if backdrop is None else "flattened",
        "surface": FIELD if best is None else best.name,
    }
    return FoundSurface(
        mesh=mesh,
        metrics=metrics,
        choices=levels.selection.choices,
        steps=pipeline.plain(STEPS),
        ground=None if backdrop is None else backdrop.ground.columns.plane,
    )
