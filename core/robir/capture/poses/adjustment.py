# SPDX-License-Identifier: Apache-2.0
"""Given cameras on trial: do points that stand out fall where photographs show them?

Cameras that an app or a program estimated may be a few pixels off: for a lens it did not know, or a
phone's own estimate of where it is. Points of the photographs that stand out are followed through
them, and cameras are moved until these points meet. They are moved only if points that had no part
in it, and lie on the object, meet better for it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.capture.masks import matching
from robir.capture.masks.matching import Features
from robir.capture.masks.sight import sampled
from robir.capture.poses.bundle import Bundle, Tracks, adjusted
from robir.capture.refusal import note, warning

Array = NDArray[np.float64]

NEIGHBOURS = 6  # photographs each photograph is compared with
FEATURES = 1200  # of a photograph at most, the strongest
# photographs that must show a point for it to be followed: two agree on some point too easily
SHORTEST = 3
# distance of a match from its epipolar line by the given cameras at most, longer sides of a
# photograph: what is further off is no error of cameras, but another point
OFF_LINE = 0.01
OFF = 6.0  # pixels by which a point may be off in one photograph and be followed still
FEWEST = 100  # points on the object from which cameras can be judged
KEPT = 5  # one point in so many takes no part in the adjustment
CAPPED = 3.0  # pixels beyond which a point is only known to be wrong
ROUNDS = 25

LEAST_LEAD = 2.0  # standard errors by which points that took no part must meet better
# share of the distance before, to which it must fall for the user to be warned of the cameras
NOTEWORTHY = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjustment:
    """Cameras that meet the photographs better than the given ones.

    Attributes:
        cameras: By the view's name, in the given cameras' frame.
        before: Mean distance, pixels of photographs `matching.SIDE` long, between where points of
            the object that took no part fall and where they are seen, with the given cameras.
        after: The same with these.
    """

    cameras: dict[str, Camera]
    before: float
    after: float


def with_adjusted_cameras(capture: Capture) -> Capture:
    """A capture with the cameras that meet its photographs best, and a finding if these are new."""
    found = adjust(capture.views)
    if found is None:
        return capture
    views = tuple(replace(view, camera=found.cameras[view.name]) for view in capture.views)
    what = (
        f"Points of the object fall {found.after:.2f} pixels from where photographs show them, in "
        f"the mean, once the cameras are moved a little, and {found.before:.2f} with the cameras "
        "as given"
    )
    cure = (
        "The result stands in the given cameras' frame; their files are as they were. To keep the "
        "given cameras: --set capture.adjust_cameras=false."
    )
    if found.after < NOTEWORTHY * found.before:
        finding = warning("cameras-off", what, cure)
    else:
        finding = note("cameras-adjusted", f"{what}. {cure}")
    return replace(capture, views=views, findings=(*capture.findings, finding))


def adjust(views: Sequence[View]) -> Adjustment | None:
    """Look for cameras that meet the photographs better.

    Args:
        views: Photographs with masks and given cameras, any frame.

    Returns:
        The cameras, or None where the given ones are as good or too little stands out to tell.
    """
    found = matching.features(views, FEATURES)
    tracks = followed(found)
    if tracks.count < FEWEST:
        return None
    named = {view.name: view for view in views}
    reduced = [
        named[each.name].camera.resized(each.camera.width, each.camera.height) for each in found
    ]
    given = Bundle.of(reduced)
    tracks = _met(given, tracks)
    on_object = _on_object([named[each.name] for each in found], found, tracks)
    is_kept = np.arange(tracks.count) % KEPT == 0
    if (on_object & is_kept).sum() * KEPT < FEWEST:
        return None
    fitted, judges = tracks.of(~is_kept), tracks.of(is_kept & on_object)
    points = adjusted(given, fitted, given.triangulated(fitted), ROUNDS, moves_cameras=False)[1]
    better = adjusted(given, fitted, points, ROUNDS, moves_cameras=True)[0].aligned(given)
    before, after = (_errors(bundle, judges) for bundle in (given, better))
    if lead(judges.view, before, after) < LEAST_LEAD:
        return None
    moved = {
        each.name: _camera(named[each.name].camera, reduced[row], better, row)
        for row, each in enumerate(found)
    }
    return Adjustment(
        cameras={view.name: moved.get(view.name, view.camera) for view in views},
        before=float(before.mean()),
        after=float(after.mean()),
    )


def followed(found: Sequence[Features]) -> Tracks:
    """Points that are seen in at least `SHORTEST` photographs, none twice in one.

    Args:
        found: What stands out in the photographs.
    """
    starts = np.cumsum([0, *(len(each.pixels) for each in found)])
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for one, two in matching.pairs([each.camera for each in found], NEIGHBOURS):
        own, its = matching.matches(found[one], found[two])
        near = _off_line(found[one], found[two], own, its) < OFF_LINE
        first.append(starts[one] + own[near])
        second.append(starts[two] + its[near])
    ends = np.concatenate(first), np.concatenate(second)
    total = int(starts[-1])
    links = coo_array((np.ones(len(ends[0])), ends), shape=(total, total))
    number, label = connected_components(links, directed=False)
    view = np.repeat(np.arange(len(found)), np.diff(starts))
    length = np.bincount(label, minlength=number)
    # two features of one photograph cannot be one point
    twice = np.bincount(
        np.unique(label.astype(np.int64) * len(found) + view) // max(len(found), 1),
        minlength=number,
    )
    good = (length >= SHORTEST) & (twice == length)
    rows = np.flatnonzero(good[label])
    pixels = np.concatenate([each.pixels for each in found]) if found else np.zeros((0, 2))
    return Tracks(
        view=view[rows],
        point=np.unique(label[rows], return_inverse=True)[1].reshape(-1),
        pixels=pixels[rows],
    )


def lead(view: NDArray[np.int64], before: Array, after: Array) -> float:
    """By how many standard errors the second errors (O,) are smaller, photographs being apart."""
    count = np.bincount(view)
    gain = np.bincount(view, before - after)[count > 0] / count[count > 0]
    if len(gain) < 2:
        return 0.0
    return float(gain.mean() / max(gain.std(ddof=1) / len(gain) ** 0.5, 1e-9))


def _off_line(
    one: Features, two: Features, own: NDArray[np.int64], its: NDArray[np.int64]
) -> Array:
    """Angles between matched rays' planes through both centres, as shares of a longer side."""
    start, ray = one.camera.rays(one.pixels[own])
    end, other = two.camera.rays(two.pixels[its])
    apart = end - start
    normal = np.cross(ray, apart)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    camera = two.camera
    return np.abs((normal * other).sum(1)) * camera.fx / max(camera.width, camera.height)


def _met(given: Bundle, tracks: Tracks) -> Tracks:
    """The points that are near where they are seen in all their photographs."""
    points = adjusted(given, tracks, given.triangulated(tracks), ROUNDS, moves_cameras=False)[1]
    worst = np.zeros(tracks.count)
    np.maximum.at(worst, tracks.point, given.errors(tracks, points))
    return tracks.of(worst < OFF)


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


def _errors(bundle: Bundle, tracks: Tracks) -> Array:
    """Capped distances (O,), pixels, of points that are triangulated anew."""
    start = bundle.triangulated(tracks)
    points = adjusted(bundle, tracks, start, ROUNDS, moves_cameras=False)[1]
    return np.minimum(bundle.errors(tracks, points), CAPPED)


def _camera(given: Camera, reduced: Camera, bundle: Bundle, row: int) -> Camera:
    """A given camera, at its size, with pose and focal length of the bundle."""
    pose = np.eye(4)
    pose[:3, :3] = bundle.rotations[row].T
    pose[:3, 3] = bundle.centres[row]
    zoom = bundle.focal[row, 0] / reduced.fx
    return replace(given, camera_to_world=pose, fx=zoom * given.fx, fy=zoom * given.fy)
