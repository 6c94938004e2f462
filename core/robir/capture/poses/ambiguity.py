# SPDX-License-Identifier: Apache-2.0
"""Objects that look alike from several sides, and models that were led astray by them.

A round tub with its label three times over matches itself a third of a turn away, and the mapper
puts whole stretches of a walk on the wrong side. Each stretch fits in itself, but where it ends,
photographs that have a great deal in common are placed far apart.

What two photographs have in common is measured by how much of the picture their matches cover, not
by how many they are: a label that repeats holds many in one place, while neighbours share the
object, the ground and what stands behind. A model is held against the maximum spanning tree of the
covered area: each photograph's surest link to the others. Where links of the tree contradict the
model, they cut the photographs into stretches; the matches by which the model ties different
stretches together are then the suspects.
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

from robir.capture.poses.sfm import Prepared, Workplace

if TYPE_CHECKING:
    import pycolmap

MIN_MATCHES = 30  # fewer verified matches are no link worth arguing about
# cells along the longer side of a picture, by which the area that matches cover is counted
CELLS = 20
# pixels of the copies by which half of a pair's matches may miss their epipolar lines
MAX_OFF = 4.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """A model held against the surest links."""

    # pairs of names of copies whose matches cover a great deal of both and that are far apart in
    # the model; the surest first
    broken: tuple[tuple[str, str], ...]
    # pairs of names of copies by which the model ties together what the broken links separate
    suspects: tuple[tuple[str, str], ...]


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
    """Distances of matches from the epipolar geometry of two posed images, at focal length one.

    First order, after Sampson; Hartley and Zisserman 2003, equation 11.9.
    """
    relative = two.cam_from_world() * one.cam_from_world().inverse()
    a, b, c = relative.translation
    cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    essential = cross @ relative.rotation.matrix()
    x = np.column_stack([x, np.ones(len(x))])
    y = np.column_stack([y, np.ones(len(y))])
    lines_y, lines_x = x @ essential.T, y @ essential
    slopes = (lines_y[:, :2] ** 2).sum(axis=1) + (lines_x[:, :2] ** 2).sum(axis=1)
    return np.abs((y * lines_y).sum(axis=1)) / np.sqrt(np.maximum(slopes, 1e-24))
