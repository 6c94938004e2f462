# SPDX-License-Identifier: Apache-2.0
"""What an outcome means to someone with a camera in the hand: how many were placed, why not all."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Finding
from robir.capture.poses.ambiguity import Verdict
from robir.capture.poses.prepare import MIN_PHOTOGRAPHS, MORE_PHOTOGRAPHS, Prepared
from robir.capture.poses.solve import Workplace
from robir.capture.refusal import MAX_FILES, error, note, warning

if TYPE_CHECKING:
    import pycolmap

LINK = 30  # verified matches from which on two photographs count as showing the same thing
# median motion of matched points, in longer sides, below which the camera has not moved
STILL = 0.004
COMPARABLE = 0.5  # a second model of this share of the first is no leftover but half of the capture
# photographs stand side by side within this angle and this share of the cameras' distance from
# their middle
BESIDE_DEGREES, BESIDE_SHARE = 15.0, 0.3
# matches of photographs side by side, against what either has with its third best partner, below
# which they are strangers. The right models of five captures have no such pair; one of a round tub
# with sides laid on each other has nine.
STRANGE = 0.35
MIN_STRANGE = 3  # pairs of strangers side by side from which on sides were laid on each other
FEW = 0.7  # below this share of photographs placed, the user is warned
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
    """What pairs of photographs have in common.

    Attributes:
        matches: (N, N) int, verified matches, symmetric.
        compared: (N, N) bool, pairs that were looked at, symmetric.
        motion: Median motion of matched points over all linked pairs, in longer sides of the
            picture; NaN without any.
        flat_share: Share of the linked pairs that a plane or a mere turn of the camera explains.
    """

    matches: NDArray[np.int64]
    compared: NDArray[np.bool_]
    motion: float
    flat_share: float


def read_links(place: Workplace, photographs: Sequence[Prepared]) -> Links:
    """Read from the database what the pairs of photographs have in common.

    Args:
        place: Work folder whose database holds the matches.
        photographs: In the order the rows get.
    """
    import pycolmap

    kinds = pycolmap.TwoViewGeometryConfiguration
    flat_kinds = [int(k) for k in (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)]
    rows = {photograph.copy: row for row, photograph in enumerate(photographs)}
    matches = np.zeros((len(rows), len(rows)), dtype=np.int64)
    compared = np.zeros(matches.shape, dtype=bool)
    motions, flat = [], []
    with closing(pycolmap.Database.open(place.database)) as database:
        images = {image.image_id: rows[image.name] for image in database.read_all_images()}
        points = {number: database.read_keypoints(number)[:, :2] for number in images}
        for pair, geometry in zip(*database.read_two_view_geometries(), strict=True):
            one, two = pycolmap.pair_id_to_image_pair(pair)
            i, j = images[one], images[two]
            inliers = geometry.inlier_matches
            compared[i, j] = compared[j, i] = True
            matches[i, j] = matches[j, i] = len(inliers)
            if len(inliers) < LINK:
                continue
            sides = [max(photographs[row].width, photographs[row].height) for row in (i, j)]
            moved = points[one][inliers[:, 0]] / sides[0] - points[two][inliers[:, 1]] / sides[1]
            motions.append(np.median(np.linalg.norm(moved, axis=1)))
            flat.append(geometry.config in flat_kinds)
    motion = float(np.median(motions)) if motions else float("nan")
    return Links(matches, compared, motion, float(np.mean(flat)) if flat else 0.0)


def judge(
    photographs: Sequence[Prepared], links: Links, models: Sequence[pycolmap.Reconstruction]
) -> list[Finding]:
    """What came out, in words.

    Args:
        photographs: All that were tried, in order.
        links: What their pairs have in common.
        models: The largest first.

    Returns:
        Findings; an error among them means that the largest model is of no use.
    """
    placed = [_names(model, photographs) for model in models]
    if not placed or len(placed[0]) < MIN_PHOTOGRAPHS:
        return [_failure(photographs, links, placed[0] if placed else [])]
    first, total = placed[0], len(photographs)
    rest = [p.relative for p in photographs if p.relative not in set(first)]
    second = [name for name in placed[1] if name in rest] if len(placed) > 1 else []
    if not second and _are_apart(photographs, links, first, rest):
        second = rest
    if len(second) >= max(MIN_PHOTOGRAPHS, COMPARABLE * len(first)):
        return [_two_groups(total, first, second)]
    points, fault = models[0].num_points3D(), models[0].compute_mean_reprojection_error()
    found = [
        note(
            "placed",
            f"{len(first)} of {total} photographs were placed by {points} common points, which "
            f"they see {fault:.2f} pixels off (of copies of {photographs[0].width}x"
            f"{photographs[0].height})",
        ),
        note(
            "frame",
            "The cameras' axes and unit are COLMAP's: photographs do not tell which way is up, "
            "nor how large the object is",
        ),
    ]
    found += _strangers(photographs, links, models[0])
    if rest:
        severity = "Only " if len(first) < FEW * total else ""
        found.append(
            warning(
                "unregistered",
                f"{severity}{len(first)} of {total} photographs could be placed; these "
                f"{len(rest)} are left out{_why(photographs, links, first, rest)}",
                "They share too little with the others: photograph their side in smaller steps, "
                "sharp and in the same light.",
                *rest,
            )
        )
    return found


def look_alikes(photographs: Sequence[Prepared], verdict: Verdict, forgotten: int) -> list[Finding]:
    """What sides that look alike did to the model, in words.

    Args:
        photographs: All that were tried.
        verdict: On the model that is used.
        forgotten: Pairs whose matches were left out to make it, 0 if all were used.
    """
    if not verdict.broken and not forgotten:
        return []
    if not verdict.broken:
        return [
            warning(
                "look-alike",
                "The object looks alike from several sides; matches of different sides "
                f"contradicted the surest links between photographs, and {forgotten} pairs were "
                "left out until none did",
                "Look at the cameras before you go on.",
            )
        ]
    names = {photograph.copy: photograph.relative for photograph in photographs}
    between = (f"{names[one]} and {names[two]}" for one, two in verdict.broken[:MAX_FILES])
    return [
        warning(
            "look-alike",
            "The object looks alike from several sides, and some photographs may have been put on "
            f"the wrong one: {len(verdict.broken)} pairs that have much in common are far apart",
            _TELL_APART,
            *between,
        )
    ]


def _strangers(
    photographs: Sequence[Prepared], links: Links, model: pycolmap.Reconstruction
) -> list[Finding]:
    """A warning where the model puts photographs side by side that have little in common."""
    posed = {image.name: image for image in model.images.values() if image.has_pose}
    placed = [row for row, photograph in enumerate(photographs) if photograph.copy in posed]
    images = [posed[photographs[row].copy] for row in placed]
    turned = np.stack([image.cam_from_world().rotation.matrix() for image in images])
    centres = np.stack([image.projection_center() for image in images])
    away = np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1))
    near = np.linalg.norm(centres[:, None] - centres, axis=2) < BESIDE_SHARE * away
    cosine = (np.einsum("aij,bij->ab", turned, turned) - 1) / 2
    beside = near & (cosine > np.cos(np.radians(BESIDE_DEGREES)))
    among = np.ix_(placed, placed)
    third = np.sort(links.matches[among], axis=1)[:, -3]
    expected = np.minimum(third[:, None], third)
    strange = beside & links.compared[among] & (expected >= LINK)
    strange &= links.matches[among] < STRANGE * expected
    pairs = np.argwhere(np.triu(strange, 1))
    if len(pairs) < MIN_STRANGE:
        return []
    names = [photographs[row].relative for row in placed]
    return [
        warning(
            "look-alike",
            f"{len(pairs)} pairs of photographs were placed side by side and yet have little in "
            "common: sides that look alike may have been laid on each other",
            _TELL_APART,
            *(f"{names[one]} and {names[two]}" for one, two in pairs),
        )
    ]


def _names(model: pycolmap.Reconstruction, photographs: Sequence[Prepared]) -> list[str]:
    """Photographs of a model, in order."""
    posed = {image.name for image in model.images.values() if image.has_pose}
    return [photograph.relative for photograph in photographs if photograph.copy in posed]


def _are_apart(
    photographs: Sequence[Prepared], links: Links, placed: Sequence[str], rest: Sequence[str]
) -> bool:
    """Whether those left out are linked with each other but with none that was placed."""
    rows = {photograph.relative: row for row, photograph in enumerate(photographs)}
    inside, outside = [rows[name] for name in placed], [rows[name] for name in rest]
    linked = links.matches >= LINK
    to_each_other = linked[np.ix_(outside, outside)].any(axis=1)
    return not linked[np.ix_(outside, inside)].any() and bool(to_each_other.all())


def _why(
    photographs: Sequence[Prepared], links: Links, placed: Sequence[str], rest: Sequence[str]
) -> str:
    """What the photographs left out have in common with the others."""
    rows = {photograph.relative: row for row, photograph in enumerate(photographs)}
    inside = [rows[name] for name in placed]
    best = [int(links.matches[rows[name], inside].max()) for name in rest]
    return f" (at best {min(best)} to {max(best)} points in common with one that was placed)"


def _two_groups(total: int, first: Sequence[str], second: Sequence[str]) -> Finding:
    return error(
        "two-groups",
        f"The {total} photographs fall into groups without overlap: {_range(first)} and "
        f"{_range(second)} show two different objects, or two sides with nothing in common",
        _OVERLAP,
    )


def _failure(photographs: Sequence[Prepared], links: Links, placed: Sequence[str]) -> Finding:
    """Why no model, or none worth the name, came out; the surest reason first."""
    count, total = len(placed), len(photographs)
    outcome = (
        f"Only {count} of {total} photographs could be placed"
        if count
        else (f"None of the {total} photographs could be placed")
    )
    linked = links.matches >= LINK
    if not linked.any():
        i, j = divmod(int(np.argmax(links.matches)), len(photographs))
        best = (
            f"the best pair, {photographs[i].relative} and {photographs[j].relative}, has "
            f"{links.matches[i, j]} points in common and needs {LINK}"
        )
        return error(
            "no-matches",
            f"{outcome}: no two have enough in common; {best if i != j else 'no pair has any'}",
            f"{_TEXTURE} Neighbouring photographs should share two thirds of what they show.",
        )
    if links.motion < STILL:
        return error(
            "no-baseline",
            f"{outcome}: they are all taken from the same place (points move by "
            f"{100 * links.motion:.2f} % of the picture), so nothing tells distances",
            MORE_PHOTOGRAPHS,
        )
    groups = _groups(linked)
    if len(groups) > 1 and len(groups[1]) >= max(2, COMPARABLE * len(groups[0])):
        names = [[photographs[row].relative for row in group] for group in groups[:2]]
        most = links.matches[np.ix_(groups[0], groups[1])].max()
        return error(
            "no-overlap",
            f"{outcome}: {_range(names[0])} and {_range(names[1])} have at most {most} points in "
            "common",
            _OVERLAP,
        )
    if links.flat_share > 0.8:
        return error(
            "no-parallax",
            f"{outcome}: the camera only turned on the spot, or all it sees is flat",
            MORE_PHOTOGRAPHS,
        )
    neighbours = int(np.median(linked.sum(axis=0)))
    return error(
        "too-few-placed",
        f"{outcome}: a photograph has enough in common with {neighbours} others only",
        f"{_TEXTURE} {MORE_PHOTOGRAPHS}",
    )


def _groups(linked: NDArray[np.bool_]) -> list[list[int]]:
    """Connected sets of photographs, the largest first."""
    left = set(range(len(linked)))
    groups = []
    while left:
        group, border = set(), {min(left)}
        while border:
            group |= border
            border = {int(j) for i in border for j in np.flatnonzero(linked[i])} - group
        left -= group
        groups.append(sorted(group))
    return sorted(groups, key=len, reverse=True)


def _range(names: Sequence[str]) -> str:
    if len(names) < 2:
        return ", ".join(names)
    return f"{names[0]} to {names[-1]} ({len(names)} photographs)"
