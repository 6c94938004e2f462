# SPDX-License-Identifier: Apache-2.0
"""The geometry stage's work where the user hands in a mesh: no fit, but looks and repairs.

Two meshes may come of it. Textures belong to the user's: its faces in their order and, where they
are any good, its texture coordinates. Light is solved on a copy with few faces where it has many,
which is faster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from robir.capture.bounds import MARGIN, enclosing_sphere
from robir.capture.capture import GUESSED_MASKS, MESH_MASKS, Bounds, Capture, View
from robir.capture.mesh_file import Given, read_mesh
from robir.errors import CaptureError
from robir.geometry.config import GeometryConfig
from robir.geometry.given.placing import (
    BETTER,
    COARSE_SIDE,
    FINE_SIDE,
    FITS,
    Agreement,
    Outlines,
    better_place,
    covering,
    is_related,
    poor_fit,
    show_fit,
)
from robir.geometry.given.ready import inside_out, made_ready, welded
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.remask import cut_about
from robir.jobs.context import Reporter
from robir.maths.similarity import Similarity

Array = NDArray[np.float64]


# from which cameras are believed to be where they were brought; meshes of other objects reach 0.8
_ALIGNS = 0.85


@dataclass(frozen=True, slots=True, kw_only=True)
class Aligned:
    """A capture that was brought to a mesh."""

    capture: Capture  # in the mesh's frame and unit; if it was moved, its bounds are the mesh's
    # what brings the capture as it was to there, or None where it stood there already
    frame: Similarity | None
    agreement: Agreement  # of the mesh's outlines with the masks
    notes: tuple[str, ...]  # sentences for the user


def aligned(given: Given, capture: Capture, config: GeometryConfig, picture: Path) -> Aligned:
    """Bring cameras in a frame of ours to where their photographs show the mesh.

    Such a frame means nothing, so the mesh stays where the user has it and the capture moves.
    `CaptureError` if outlines and masks agree nowhere, or with the mesh's mirror image only.
    """
    used = given.vertices[np.unique(given.faces)]
    centre, radius = enclosing_sphere(used)
    # about the middle of the unit sphere, for a scan may be far from its origin
    from_unit = _from_unit(centre, radius)
    vertices = from_unit.inverse(given.vertices)
    tracer = covering(vertices, given.faces)
    if not config.fit_mesh:
        now = Outlines(capture.train, FINE_SIDE).of(tracer, from_unit)
        if now.share >= FITS:
            return Aligned(capture=capture, frame=None, agreement=now, notes=())
    to_capture = _from_unit(*Outlines(capture.train, COARSE_SIDE).sphere())
    views = capture.moved(to_capture.inverse).train
    place, then = better_place(from_unit.inverse(used), tracer, views, None)
    if then.share < _ALIGNS or np.linalg.det(place.turn) < 0:
        show_fit(tracer, (place,), views, picture)
        raise CaptureError(_why_not(place, then, picture))
    show_fit(tracer, (place,), views, picture)
    frame = to_capture.after(place).after(from_unit.inverse).inverse
    told = (
        "The photographs' cameras were found and brought to the mesh, which stays where it is: its "
        f"outlines and the masks share {then.share:.1%}, see {picture}."
    )
    bounds = Bounds(centre=centre, radius=MARGIN * radius, origin="the mesh")
    return Aligned(
        capture=replace(capture.moved(frame), bounds=bounds),
        frame=frame,
        agreement=then,
        notes=(told, *poor_fit(then)),
    )


def _from_unit(centre: Array, radius: float) -> Similarity:
    """What brings the unit sphere onto another."""
    return Similarity(turn=np.eye(3), scale=radius, shift=centre)


def _why_not(place: Similarity, then: Agreement, picture: Path) -> str:
    """Why no cameras could be brought to a mesh, and what to do."""
    if np.linalg.det(place.turn) < 0 and then.share >= _ALIGNS:
        return (
            "the mesh is mirrored: no turn makes it fit the photographs, and its mirror image "
            f"shares {then.share:.0%} with the masks; export it without a negative scale; "
            f"{picture} shows the mirror image over them"
        )
    return (
        "the photographs' cameras cannot be brought to the mesh: of what its outlines or the masks "
        f"have, both have {then.share:.0%} at best, of {_ALIGNS:.0%} that it takes. {picture} "
        "shows it. Is it the mesh of this object, whole, and without what it stands on? Are the "
        "masks right (--masks)? Else give photographs with cameras in the mesh's frame, as the "
        "program exports them that made it"
    )


_PROPOSED_SHARE = 0.75  # that a place has at least which is proposed


@dataclass(frozen=True, slots=True, kw_only=True)
class Handed:
    """What was made of the user's mesh, unit frame."""

    mesh: Mesh  # unwrapped; textures belong to it
    light: Mesh | None  # a copy on which light is solved, or None where the mesh itself serves
    # the user's where the result can have them, one or one a tile; else empty
    normal_maps: tuple[NDArray[np.uint8], ...]
    # all views of the capture where their masks had been guessed; the outlines of the mesh take
    # their place. Else None
    views: tuple[View, ...] | None
    # what brings the capture to the mesh, and its bounds there, where it is the one that had to
    # move. Else None
    frame: tuple[Similarity, Bounds] | None
    metrics: dict[str, float | str]  # for the stage's manifest
    notes: tuple[str, ...]  # sentences for the user


def hand_in(
    path: Path,
    captures: tuple[Capture, Capture],
    config: GeometryConfig,
    picture: Path,
    reporter: Reporter,
) -> Handed:
    """Read, check, place and unwrap the user's mesh.

    `captures` are the capture in its own frame and in the unit frame. `CaptureError` if it cannot
    be read or does not fit the photographs; says how it would, and `picture` shows it.
    """
    reporter.progress(0.0, "reading the mesh")
    given = read_mesh(path)
    faces = len(given.faces)
    reporter.progress(0.2, "holding the mesh against the photographs")
    frame = None
    if captures[0].has_frame_of_ours:
        found = aligned(given, captures[0], config, picture)
        captures = (found.capture, found.capture.normalised())
        frame = None if found.frame is None else (found.frame, found.capture.bounds)
        given, agreement = _in_unit_frame(given, found.capture).noted(*found.notes), found.agreement
    else:
        given, agreement = _placed(_in_unit_frame(given, captures[0]), captures, config, picture)
    capture = captures[1]
    given = _turned(given, capture)
    reporter.progress(0.4, "making the mesh ready for textures")
    ready = made_ready(given, config, reporter.warn)
    solid = ready.light or ready.mesh
    codes = {finding.code for finding in capture.findings}
    views = None
    reporter.progress(0.8, "drawing the mesh's outlines")
    if codes & {GUESSED_MASKS, MESH_MASKS}:
        tracer = EmbreeTracer(solid.vertices, solid.faces)
        views = tuple(replace(view, mask=outline(tracer, view)) for view in capture.views)
        if MESH_MASKS not in codes:  # else object and background look alike
            views = _without_rims(tracer, views)
    return Handed(
        mesh=ready.mesh,
        light=ready.light,
        normal_maps=ready.normal_maps,
        views=views,
        frame=frame,
        metrics={
            "faces": len(ready.mesh.faces),
            "faces_given": faces,
            "faces_for_light": len(solid.faces),
            "outline_agreement": round(agreement.share, 4),
            "surface": "given",
            "layout": "new" if ready.is_unwrapped_anew else "own",
            **({"tiles": len(ready.mesh.tiles)} if len(ready.mesh.tiles) else {}),
        },
        notes=(*given.notes, *ready.notes),
    )


def _in_unit_frame(given: Given, capture: Capture) -> Given:
    """The mesh where the bounding sphere of a capture in its frame is the unit sphere."""
    bounds = capture.bounds
    return replace(given, vertices=(given.vertices - bounds.centre) / bounds.radius)


def outline(tracer: EmbreeTracer, view: View) -> NDArray[np.uint8]:
    """Mask (H, W) of what a view shows of a mesh, its rim half covered."""
    camera = view.camera
    origins, directions = camera.rays(camera.pixel_centres())
    hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    shown = (hits.face >= 0).reshape(camera.height, camera.width).astype(np.float32)
    return np.rint(255 * uniform_filter(shown, 3, mode="nearest")).astype(np.uint8)


def _without_rims(tracer: EmbreeTracer, views: tuple[View, ...]) -> tuple[View, ...]:
    """Views without the background that the outline of a mesh, never quite right, takes in."""
    cut = zip(views, cut_about(tracer, views), strict=True)
    return tuple(replace(view, mask=np.minimum(view.mask, other.mask)) for view, other in cut)


def _placed(
    given: Given, captures: tuple[Capture, Capture], config: GeometryConfig, picture: Path
) -> tuple[Given, Agreement]:
    """The mesh where the photographs show it, as it is or, if that is asked for, moved."""
    views = captures[1].train
    vertices, faces = given.vertices, given.faces
    # of the mesh as a unit sphere: a ray meets nothing of faces that are much smaller or larger
    centre, radius = enclosing_sphere(vertices[np.unique(faces)])
    here = Similarity(turn=np.eye(3), scale=radius, shift=centre)
    tracer = covering(here.inverse(vertices), faces)
    now = Outlines(views, FINE_SIDE).of(tracer, here)
    is_judge = not any(finding.code == MESH_MASKS for finding in captures[1].findings)
    if not is_judge or (now.share >= FITS and not config.fit_mesh):
        return given, now
    there, then = better_place(here.inverse(vertices[np.unique(faces)]), tracer, views, here)
    place, bounds = there.after(here.inverse), captures[0].bounds
    own = place.outside(bounds.centre, bounds.radius)
    how = f"its outline and the masks share {now.share:.0%} of what either has"
    gain = 0.0 if config.fit_mesh else BETTER
    if then.share < _PROPOSED_SHARE or then.share <= now.share + gain:
        if is_related(now):
            return given.noted(*poor_fit(now)), now
        show_fit(tracer, (here, there), views, picture)
        raise CaptureError(
            f"the mesh does not belong to these photographs: {how}, and no turn, scale and shift "
            f"makes it more than {then.share:.0%}; give the mesh of this object, and look at "
            f"{picture} and at the masks"
        )
    if np.linalg.det(place.turn) < 0:
        show_fit(tracer, (here, there), views, picture)
        raise CaptureError(
            f"the mesh is mirrored: {how}, its mirror image {then.share:.0%}; export it with the "
            f"axes of the capture, without a negative scale; {picture} shows both"
        )
    if config.fit_mesh:
        normals = None if given.normals is None else given.normals @ place.turn.T
        moved = replace(given, vertices=place(vertices), normals=normals)
        return moved.noted(f"The mesh was {own.described()}.", *poor_fit(then)), then
    show_fit(tracer, (here, there), views, picture)
    raise CaptureError(
        f"the mesh does not fit the photographs: {how}. {own.described().capitalize()} it shares "
        f"{then.share:.0%}; have that done with --fit-mesh and --resume, or export the mesh in the "
        f"cameras' frame. {picture} shows both"
    )


def _turned(given: Given, capture: Capture) -> Given:
    """The mesh with the sides outward that cameras look at."""
    vertices, faces = welded(given)
    rays = Outlines(capture.train, FINE_SIDE)
    wrong = inside_out(vertices, faces, (rays.origins, rays.directions))
    if not wrong.any():
        return given
    turned = given.faces.copy()
    turned[wrong] = turned[wrong, ::-1]
    return replace(given, faces=turned).noted(
        f"{wrong.mean():.0%} of the mesh's faces showed their back to the cameras and were turned."
    )
