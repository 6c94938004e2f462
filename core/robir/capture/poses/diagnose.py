# SPDX-License-Identifier: Apache-2.0
"""What an outcome means to someone with a camera in the hand: how many were placed, why not all.

Objects that look alike from several sides lead models astray: a tub with its label three times over
matches itself a third of a turn away. Each stretch of a walk fits in itself, but where it ends,
photographs that have a great deal in common are placed far apart. What two have in common is
measured by how much of the picture their matches cover, not by how many they are: a label that
repeats holds many in one place. A model is held against the maximum spanning tree of the covered
area. Where its links contradict the model, they cut the photographs into stretches; the matches by
which the model ties different stretches together are then the suspects.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from robir.capture.capture import Finding
from robir.capture.poses.sfm import MIN_PHOTOGRAPHS, MORE_PHOTOGRAPHS, Prepared, Workplace
from robir.capture.refusal import MAX_FILES, error, note, warning

if TYPE_CHECKING:
    import pycolmap

MIN_MATCHES = 30  # fewer verified matches are no link worth arguing about
CELLS = 20  # along the longer side, by which the area that matches cover is counted
MAX_OFF = 4.0  # pixels of the copies by which half of a pair's matches may miss epipolar lines


@dataclass(frozen=True, slots=True)
class Verdict:
    """A model held against the surest links."""

    broken: tuple[tuple[str, str], ...]  # of copies with much in common, far apart in the model
    suspects: tuple[tuple[str, str], ...]  # ties between what broken links separate


def hold_against_links(
    place: Workplace, photographs: Sequence[Prepared], model: pycolmap.Reconstruction
) -> Verdict:
    """Find the surest links of all that were tried that a model contradicts."""
    names = [photograph.copy for photograph in photographs]
    rows, covered, off = _misses(place, names, model)
    if not len(rows):
        return Verdict((), ())
    i, j = rows.T
    count = len(names)
    weights = coo_array((-covered.astype(float), (i, j)), shape=(count, count))
    tree = minimum_spanning_tree(weights.tocsr()).tocoo()
    edges = {frozenset(edge) for edge in zip(tree.row.tolist(), tree.col.tolist(), strict=True)}
    in_tree = np.array([frozenset(pair) in edges for pair in rows.tolist()])
    holds = off <= MAX_OFF
    broken = np.flatnonzero(in_tree & ~holds)
    broken = broken[np.argsort(-covered[broken], kind="stable")]
    # What is as sure as the surest broken link belongs together, whichever of them is in the tree.
    sure = holds & (in_tree | (covered >= covered[broken].max(initial=0)))
    together = coo_array((np.ones(sure.sum()), (i[sure], j[sure])), shape=(count, count))
    _, stretch = connected_components(together, directed=False)
    # Without a broken link all of the model is one stretch, and nothing is suspect.
    suspects = np.flatnonzero(holds & (stretch[i] != stretch[j])) if len(broken) else broken

    def named(which: NDArray[np.int64]) -> tuple[tuple[str, str], ...]:
        return tuple((names[a], names[b]) for a, b in rows[which].tolist())

    return Verdict(named(broken), named(suspects))


def forget(place: Workplace, pairs: Sequence[tuple[str, str]]) -> None:
    """Take the verified matches of pairs of copies out of the database."""
    import pycolmap

    with closing(pycolmap.Database.open(place.database)) as database:
        numbers = {image.name: image.image_id for image in database.read_all_images()}
        for one, two in pairs:
            database.delete_two_view_geometry(numbers[one], numbers[two])


def _misses(
    place: Workplace, names: Sequence[str], model: pycolmap.Reconstruction
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Pairs of rows (P, 2), cells that their matches cover, and by how many pixels these miss."""
    import pycolmap

    order = {name: row for row, name in enumerate(names)}
    images = {image.name: image for image in model.images.values() if image.has_pose}
    rows, covered, off = [], [], []
    with closing(pycolmap.Database.open(place.database)) as database:
        placed = {
            entry.image_id: images[entry.name]
            for entry in database.read_all_images()
            if entry.name in images
        }
        lens = {number: model.camera(image.camera_id) for number, image in placed.items()}
        pixels = {n: database.read_keypoints(n)[:, :2].astype(np.float64) for n in placed}
        points = {n: lens[n].cam_from_img(pixels[n]) for n in placed}
        cells = {n: _cells(pixels[n], max(lens[n].width, lens[n].height)) for n in placed}
        for number, geometry in zip(*database.read_two_view_geometries(), strict=True):
            one, two = pycolmap.pair_id_to_image_pair(number)
            found = geometry.inlier_matches
            if len(found) < MIN_MATCHES or one not in placed or two not in placed:
                continue
            error = _sampson(
                placed[one], placed[two], points[one][found[:, 0]], points[two][found[:, 1]]
            )
            rows.append((order[placed[one].name], order[placed[two].name]))
            sides = cells[one][found[:, 0]], cells[two][found[:, 1]]
            covered.append(min(len(np.unique(side)) for side in sides))
            off.append(lens[one].mean_focal_length() * float(np.median(error)))
    return np.array(rows, dtype=np.int64).reshape(-1, 2), np.array(covered), np.array(off)


def _cells(pixels: NDArray[np.float64], longer_side: int) -> NDArray[np.int64]:
    """Numbers (N,) of the cells that points (N, 2) of a picture lie in."""
    column, row = (pixels * CELLS / longer_side).astype(np.int64).T
    return column + (CELLS + 1) * row


def _sampson(
    one: Any, two: Any, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of matches from epipolar lines, focal length one (Hartley and Zisserman, 11.9)."""
    relative = two.cam_from_world() * one.cam_from_world().inverse()
    a, b, c = relative.translation
    cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    essential = cross @ relative.rotation.matrix()
    x = np.column_stack([x, np.ones(len(x))])
    y = np.column_stack([y, np.ones(len(y))])
    lines_y, lines_x = x @ essential.T, y @ essential
    slopes = (lines_y[:, :2] ** 2).sum(axis=1) + (lines_x[:, :2] ** 2).sum(axis=1)
    return np.abs((y * lines_y).sum(axis=1)) / np.sqrt(np.maximum(slopes, 1e-24))


if TYPE_CHECKING:
    import pycolmap

_LINK = 30  # verified matches from which on two photographs count as showing the same thing
_STILL = 0.004  # median motion of matches, in longer sides, below which the camera has not moved
_COMPARABLE = 0.5  # a second model of this share of the first is half of the capture
_FEW = 0.7  # below this share of photographs placed, the user is warned
_TEXTURE = (
    "Features are corners and patterns: light the object evenly, keep photographs sharp, and put "
    "a plain or glossy object on a patterned cloth or a newspaper that stays in place."
)
_OVERLAP = (
    "Photograph the way between them in steps of at most 15 degrees, in one sitting and without "
    "moving the object, or give the photographs of one of them alone."
)
_TELL_APART = (
    "Look at the cameras before you go on. Something that is different on every side, such as a "
    "newspaper or a few things around the object, tells the sides apart."
)


@dataclass(frozen=True, slots=True)
class Links:
    """What pairs of photographs have in common."""

    matches: NDArray[np.int64]  # (N, N), verified matches, symmetric
    motion: float  # median of matched points over linked pairs, in longer sides, or NaN
    flat_share: float  # share of the linked pairs that a plane or a mere turn explains


def read_links(place: Workplace, photographs: Sequence[Prepared]) -> Links:
    """Read from the database what the pairs of photographs, in this order, have in common."""
    import pycolmap

    kinds = pycolmap.TwoViewGeometryConfiguration
    flat_kinds = [int(k) for k in (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)]
    rows = {photograph.copy: row for row, photograph in enumerate(photographs)}
    matches = np.zeros((len(rows), len(rows)), dtype=np.int64)
    motions, flat = [], []
    with closing(pycolmap.Database.open(place.database)) as database:
        images = {image.image_id: rows[image.name] for image in database.read_all_images()}
        points = {number: database.read_keypoints(number)[:, :2] for number in images}
        for pair, geometry in zip(*database.read_two_view_geometries(), strict=True):
            one, two = pycolmap.pair_id_to_image_pair(pair)
            i, j = images[one], images[two]
            inliers = geometry.inlier_matches
            matches[i, j] = matches[j, i] = len(inliers)
            if len(inliers) >= _LINK:
                a, b = (max(photographs[row].width, photographs[row].height) for row in (i, j))
                moved = points[one][inliers[:, 0]] / a - points[two][inliers[:, 1]] / b
                motions.append(np.median(np.linalg.norm(moved, axis=1)))
                flat.append(geometry.config in flat_kinds)
    motion = float(np.median(motions)) if motions else float("nan")
    return Links(matches, motion, float(np.mean(flat)) if flat else 0.0)


def judge(
    photographs: Sequence[Prepared], links: Links, models: Sequence[pycolmap.Reconstruction]
) -> list[Finding]:
    """What came out, in words, models with the largest first; an error if that is of no use."""
    placed = []
    for model in models:
        posed = {image.name for image in model.images.values() if image.has_pose}
        placed.append([row for row, one in enumerate(photographs) if one.copy in posed])
    names = [photograph.relative for photograph in photographs]
    if not placed or len(placed[0]) < MIN_PHOTOGRAPHS:
        return [_failure(names, links, len(placed[0]) if placed else 0)]
    first, total = placed[0], len(photographs)
    rest = [row for row in range(total) if row not in set(first)]
    second = [row for row in placed[1] if row in rest] if len(placed) > 1 else []
    linked = links.matches >= _LINK
    is_apart = not linked[np.ix_(rest, first)].any() and linked[np.ix_(rest, rest)].any(1).all()
    if not second and is_apart:  # linked with each other but with none that was placed
        second = rest
    if len(second) >= max(MIN_PHOTOGRAPHS, _COMPARABLE * len(first)):
        message = f"The {total} photographs fall into groups without overlap: "
        message += f"{_range(names, first)} and {_range(names, second)} show two different "
        message += "objects, or two sides with nothing in common"
        return [error("two-groups", message, _OVERLAP)]
    points, fault = models[0].num_points3D(), models[0].compute_mean_reprojection_error()
    message = f"{len(first)} of {total} photographs were placed by {points} common points, which "
    message += f"they see {fault:.2f} pixels off (of copies of {photographs[0].width}x"
    found = [note("placed", f"{message}{photographs[0].height})")]
    message = "The cameras' axes and unit are COLMAP's: photographs do not tell which way is up, "
    found.append(note("frame", message + "nor how large the object is"))
    if rest:
        best = [int(links.matches[row, first].max()) for row in rest]
        message = "Only " if len(first) < _FEW * total else ""
        message += f"{len(first)} of {total} photographs could be placed; these {len(rest)} are "
        message += f"left out (at best {min(best)} to {max(best)} points in common with one that "
        cure = "They share too little with the others: photograph their side in smaller steps, "
        cure += "sharp and in the same light."
        lost = [names[row] for row in rest]
        found.append(warning("unregistered", message + "was placed)", cure, *lost))
    return found


def look_alikes(photographs: Sequence[Prepared], verdict: Verdict, forgotten: int) -> list[Finding]:
    """What sides that look alike did to the model, of which so many pairs were left out."""
    if not verdict.broken and not forgotten:
        return []
    message = "The object looks alike from several sides"
    names = {photograph.copy: photograph.relative for photograph in photographs}
    between = [f"{names[one]} and {names[two]}" for one, two in verdict.broken[:MAX_FILES]]
    if between:
        message += ", and some photographs may have been put on the wrong one: "
        message += f"{len(verdict.broken)} pairs that have much in common are far apart"
    else:
        message += "; matches of different sides contradicted the surest links between "
        message += f"photographs, and {forgotten} pairs were left out until none did"
    return [warning("look-alike", message, _TELL_APART, *between)]


def _failure(names: Sequence[str], links: Links, count: int) -> Finding:
    """Why no model, or none worth the name, came out; the surest reason first."""
    outcome = f"{f'Only {count}' if count else 'None'} of {'' if count else 'the '}{len(names)} "
    outcome += "photographs could be placed"
    linked = links.matches >= _LINK
    if not linked.any():
        i, j = divmod(int(np.argmax(links.matches)), len(names))
        best = f"the best pair, {names[i]} and {names[j]}, has {links.matches[i, j]} points in "
        best += f"common and needs {_LINK}"
        message = f"{outcome}: no two have enough in common; "
        cure = f"{_TEXTURE} Neighbouring photographs should share two thirds of what they show."
        return error("no-matches", message + (best if i != j else "no pair has any"), cure)
    if links.motion < _STILL:
        message = f"{outcome}: they are all taken from the same place (points move by "
        message += f"{100 * links.motion:.2f} % of the picture), so nothing tells distances"
        return error("no-baseline", message, MORE_PHOTOGRAPHS)
    number, label = connected_components(linked, directed=False)
    groups = sorted((np.flatnonzero(label == k).tolist() for k in range(number)), key=len)[::-1]
    if len(groups) > 1 and len(groups[1]) >= max(2, _COMPARABLE * len(groups[0])):
        most = links.matches[np.ix_(groups[0], groups[1])].max()
        message = f"{outcome}: {_range(names, groups[0])} and {_range(names, groups[1])} have at "
        return error("no-overlap", f"{message}most {most} points in common", _OVERLAP)
    if links.flat_share > 0.8:
        message = f"{outcome}: the camera only turned on the spot, or all it sees is flat"
        return error("no-parallax", message, MORE_PHOTOGRAPHS)
    message = f"{outcome}: a photograph has enough in common with "
    message += f"{int(np.median(linked.sum(axis=0)))} others only"
    return error("too-few-placed", message, f"{_TEXTURE} {MORE_PHOTOGRAPHS}")


def _range(names: Sequence[str], rows: Sequence[int]) -> str:
    first, last = names[rows[0]], names[rows[-1]]
    return first if len(rows) < 2 else f"{first} to {last} ({len(rows)} photographs)"
