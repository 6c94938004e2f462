# SPDX-License-Identifier: Apache-2.0
"""Given cameras on trial: do points that stand out fall where photographs show them?

Cameras that an app or a program estimated may be a few pixels off: for a lens it did not know, or a
phone's own estimate of where it is. Points of the photographs that stand out are followed through
them, and pycolmap moves cameras and one factor on all focal lengths until these points meet. The
cameras are taken only if held-out points of the object meet better for it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.capture.frames import OPENGL_FROM_OPENCV
from robir.capture.masks import matching
from robir.capture.masks.guess import sampled
from robir.capture.masks.matching import Features, Tracks
from robir.capture.poses import sfm
from robir.capture.refusal import note, warning
from robir.maths.similarity import Similarity

Array = NDArray[np.float64]

_NEIGHBOURS = 6  # photographs each photograph is compared with
_FEATURES = 1200  # of a photograph at most, the strongest
_SHORTEST = 3  # photographs that must show a point: two agree on some point too easily
_OFF = 6.0  # pixels by which a point may be off in one photograph and be followed still
_FEWEST = 100  # points on the object from which cameras can be judged
_HELD_OUT = 5  # one point in so many takes no part in the adjustment
_CAPPED = 3.0  # pixels beyond which a point is only known to be wrong
_ROUNDS = 50  # iterations at most
_MOST_ZOOM = 0.05  # change of focal lengths; free ones of a ring of exact cameras shrank to 0.65
_LEAST_LEAD = 2.0  # standard errors by which held-out points must meet better
_NOTEWORTHY = 0.8  # share of the distance before, at which the user is warned of the cameras


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjustment:
    """Cameras that meet the photographs better than the given ones."""

    cameras: dict[str, Camera]  # by the view's name, in the given cameras' frame
    before: float  # mean pixels, at `matching.SIDE`, of held-out points with the given cameras
    after: float  # the same with these


def with_adjusted_cameras(capture: Capture) -> Capture:
    """A capture with the cameras that meet its photographs best, and a finding if these are new."""
    found = adjust(capture.views) if sfm.is_available() else None
    if found is None:
        return capture
    views = tuple(replace(view, camera=found.cameras[view.name]) for view in capture.views)
    what = f"Points of the object fall {found.after:.2f} pixels from where photographs show them, "
    what += f"in the mean, once the cameras are moved a little, and {found.before:.2f} with the "
    what += "cameras as given"
    cure = "The result stands in the given cameras' frame; their files are as they were. To keep "
    cure += "the given cameras: --set capture.adjust_cameras=false."
    finding = note("cameras-adjusted", f"{what}. {cure}")
    if found.after < _NOTEWORTHY * found.before:
        finding = warning("cameras-off", what, cure)
    return replace(capture, views=views, findings=(*capture.findings, finding))


def adjust(views: Sequence[View]) -> Adjustment | None:
    """Cameras that meet the photographs better, or None where the given ones are as good."""
    found = matching.features(views, _FEATURES)
    tracks = matching.followed(found, _SHORTEST, _NEIGHBOURS)
    if tracks.count < _FEWEST:
        return None
    named = {view.name: view for view in views}
    given = [named[f.name].camera.resized(f.camera.width, f.camera.height) for f in found]
    worst = np.zeros(tracks.count)
    np.maximum.at(worst, tracks.point, _misses(given, tracks))
    tracks = tracks.of(worst < _OFF)
    on_object = _on_object([named[each.name] for each in found], found, tracks)
    is_held_out = np.arange(tracks.count) % _HELD_OUT == 0
    if (on_object & is_held_out).sum() * _HELD_OUT < _FEWEST:
        return None
    fitted, judges = tracks.of(~is_held_out), tracks.of(is_held_out & on_object)
    best, errors = given, np.minimum(_misses(given, judges), _CAPPED)
    before = errors
    for zooms in (False, True):  # points of one thing hardly tell a focal length from a distance
        moved = moved_cameras(given, fitted, zooms=zooms)
        after = np.minimum(_misses(moved, judges), _CAPPED)
        is_sane = abs(moved[0].fx / given[0].fx - 1.0) < _MOST_ZOOM
        if is_sane and lead(judges.view, errors, after) >= _LEAST_LEAD:
            best, errors = moved, after
    if best is given:
        return None
    cameras = {view.name: view.camera for view in views}
    for each, old, new in zip(found, given, best, strict=True):
        own, zoom = cameras[each.name], new.fx / old.fx
        moved = replace(own, fx=zoom * own.fx, fy=zoom * own.fy)
        cameras[each.name] = replace(moved, camera_to_world=new.camera_to_world)
    return Adjustment(cameras=cameras, before=float(before.mean()), after=float(errors.mean()))


def moved_cameras(given: Sequence[Camera], tracks: Tracks, *, zooms: bool) -> list[Camera]:
    """Cameras of least robust error (Cauchy), in the frame of the given ones, of one free lens."""
    pycolmap = sfm.library()
    focal = float(np.median([camera.fx for camera in given]))
    model = pycolmap.Reconstruction()
    lens = pycolmap.Camera(
        camera_id=1, model="SIMPLE_PINHOLE", width=1, height=1, params=[focal, 0, 0]
    )
    model.add_camera_with_trivial_rig(lens)
    elements: list[list[Any]] = [[] for _ in range(tracks.count)]
    for number, camera in enumerate(given):
        own = np.flatnonzero(tracks.view == number)
        plain = (tracks.pixels[own] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        image = pycolmap.Image(f"{number}", focal * plain, camera_id=1, image_id=number + 1)
        world = np.linalg.inv(camera.camera_to_world @ OPENGL_FROM_OPENCV)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(world[:3]))
        for row, point in enumerate(tracks.point[own]):
            elements[point].append(pycolmap.TrackElement(number + 1, row))
    for place, seen in zip(matching.triangulated(given, tracks), elements, strict=True):
        model.add_point3D(place, pycolmap.Track(seen))
    options = sfm.adjustment_options(pycolmap, 1.0, _ROUNDS)
    options.refine_focal_length = zooms
    options.refine_extra_params = False
    sfm.solve(pycolmap, options, model)
    zoom = model.camera(1).focal_length / focal
    moved = []
    for number, camera in enumerate(given):
        pose = np.eye(4)
        pose[:3] = model.image(number + 1).cam_from_world().inverse().matrix()
        pose = pose @ OPENGL_FROM_OPENCV
        zoomed = replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy)
        moved.append(replace(zoomed, camera_to_world=pose))
    return aligned(moved, given)


def aligned(cameras: Sequence[Camera], others: Sequence[Camera]) -> list[Camera]:
    """Cameras in the frame where their centres lie nearest to those of others (least squares)."""
    own, its = (np.array([c.position for c in some]) for some in (cameras, others))
    found = sfm.library().estimate_sim3d(own, its)
    if found is None:
        return list(cameras)
    turn = found.rotation.matrix()
    place = Similarity(turn=turn, scale=found.scale, shift=found.translation)
    return [camera.moved(place) for camera in cameras]


def lead(view: NDArray[np.int64], before: Array, after: Array) -> float:
    """By how many standard errors the second errors (O,) are smaller, photographs being apart."""
    count = np.bincount(view)
    gain = np.bincount(view, before - after)[count > 0] / count[count > 0]
    if len(gain) < 2:
        return 0.0
    return float(gain.mean() / max(gain.std(ddof=1) / len(gain) ** 0.5, 1e-9))


def _misses(cameras: Sequence[Camera], tracks: Tracks) -> Array:
    """Pixels (O,) by which points that are triangulated anew fall beside where they are seen."""
    return matching.errors(cameras, tracks, matching.triangulated(cameras, tracks))


def _on_object(
    views: Sequence[View], found: Sequence[Features], tracks: Tracks
) -> NDArray[np.bool_]:
    """Which points (N,) lie on the object in most of their photographs."""
    inside = np.zeros(len(tracks.view))
    for row, (view, each) in enumerate(zip(views, found, strict=True)):
        own = tracks.view == row
        scale = view.camera.width / each.camera.width
        inside[own] = sampled(view.mask, scale * tracks.pixels[own]) > 127
    share = np.bincount(tracks.point, inside) / np.bincount(tracks.point)
    return share > 0.5
