# SPDX-License-Identifier: Apache-2.0
"""Fewer and larger charts: neighbours are joined while they still lie flat without much stretch.

xatlas makes many small charts. Two that share a long border are glued along it and flattened as
rigidly as possible (Liu et al. 2008, "A Local/Global Approach to Mesh Parameterization"). They stay
joined if no face is turned over, their rim does not cross itself and the stretch is small.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# mean of (s - 1)^2 over a chart's area, summed over both singular values of each face: what is
# nearly flat is joined first, then what is stretched by 6 %
_MOST_STRETCH = (0.002, 0.007)
_LEAST_WIDTH = 0.05  # smallest singular value of a face; below 0 it is turned over
_ROUNDS = 6  # of flattening: turns of all faces, then places of all corners
_MOST_BEND = 0.3  # of a border's length, by which two charts may miss each other along it
_LEAST_OVERLAP = 1e-6  # of a chart's size, by which its rim must reach over itself to cross it
_MOST_VISITS = 4_000_000  # faces flattened in all, which bounds the time; 8,000 faces need 500,000


def merged_charts(
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    atlas: tuple[NDArray[np.float32], NDArray[np.int32]],
) -> tuple[Array, Ints]:
    """Texture coordinates (Nu, 2) in the mesh's own size, not packed, and their indices (Nf, 3).

    `atlas` holds those of the charts to begin with.
    """
    charts = _Charts(vertices.astype(np.float64), faces.astype(np.int64), atlas)
    charts.merge()
    used, corners = np.unique(charts.corners, return_inverse=True)
    return charts.uvs[used], corners.reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class _Joined:
    """Two charts as one: names of its corners and where they lie, its faces and their corners."""

    names: Ints
    uvs: Array
    faces: Ints
    corners: Ints


class _Charts:
    """Charts by number, and the borders between them; a corner's name is that of a coordinate."""

    def __init__(self, vertices: Array, faces: Ints, atlas: tuple[NDArray, NDArray]) -> None:
        self.uvs, self.corners = atlas[0].astype(np.float64), atlas[1].astype(np.int64)
        self._rest = _flat(vertices[faces])
        self._area = np.linalg.det(self._rest) / 2
        self._inverse = np.linalg.inv(self._rest)
        self._owner = _parts(self.corners, len(self.uvs))
        count = int(self._owner.max()) + 1
        self._faces = {chart: np.flatnonzero(self._owner == chart) for chart in range(count)}
        self._ends, self._sides, self._slots = _shared_edges(faces, len(vertices))
        self._length = np.linalg.norm(np.diff(vertices[self._ends], axis=1)[:, 0], axis=1)
        self._borders: dict[int, dict[int, list[int]]] = {chart: {} for chart in self._faces}
        self._seams: dict[int, list[int]] = {chart: [] for chart in self._faces}
        for edge, (one, other) in enumerate(self._owner[self._sides].tolist()):
            if one != other:
                self._borders[one].setdefault(other, []).append(edge)
                self._borders[other].setdefault(one, []).append(edge)
            elif (np.diff(self._names(edge), axis=1) != 0).any():
                self._seams[one].append(edge)
        self._perimeter = {chart: self._rim(chart) for chart in self._faces}
        self._version = dict.fromkeys(self._faces, 0)
        self._queue: list[tuple[float, int, int, int]] = []
        self._folded: set[tuple[int, int, int]] = set()
        for chart in self._faces:
            self._scale(chart)

    def merge(self) -> None:
        """Join charts, those with the longest border first, until none fit."""
        visits = 0
        for most in _MOST_STRETCH:
            visits = self._merge(most, visits)

    def _merge(self, most: float, visits: int) -> int:
        for chart, others in self._borders.items():
            for other in others:
                if chart < other:
                    self._enqueue(chart, other)
        while self._queue and visits < _MOST_VISITS:
            _, one, other, version = heapq.heappop(self._queue)
            is_there = one in self._faces and other in self._borders.get(one, ())
            is_there &= (one, other, version) not in self._folded
            if is_there and version == self._version[one] + self._version[other]:
                visits += len(self._faces[one]) + len(self._faces[other])
                joined = self._joined(one, other, most)
                if isinstance(joined, _Joined):
                    self._take(one, other, joined)
                elif joined == np.inf:
                    self._folded.add((one, other, version))
        return visits

    def _scale(self, chart: int) -> None:
        """Bring a chart to the size of its faces, unmirrored."""
        corners = self.corners[self._faces[chart]]
        doubled = np.linalg.det(_edges(self.uvs, corners))
        names = np.unique(corners)
        size = 2 * self._area[self._faces[chart]].sum() / max(np.abs(doubled).sum(), 1e-30)
        self.uvs[names] *= np.sqrt(size) * np.array([-1.0 if doubled.sum() < 0 else 1.0, 1.0])

    def _rim(self, chart: int) -> float:
        edges = [edge for some in self._borders[chart].values() for edge in some]
        return float(self._length[edges].sum())

    def _names(self, edge: int) -> Ints:
        """Names of the corners at both ends of an edge, (2 ends, 2 sides)."""
        (one, other), (k, n) = self._sides[edge], self._slots[edge]
        a, b = self.corners[one], self.corners[other]
        return np.array([[a[k], b[(n + 1) % 3]], [a[(k + 1) % 3], b[n]]])

    def _enqueue(self, one: int, other: int) -> None:
        shorter = max(min(self._perimeter[one], self._perimeter[other]), 1e-30)
        share = float(self._length[self._borders[one][other]].sum()) / shorter
        version = self._version[one] + self._version[other]
        heapq.heappush(self._queue, (-share, min(one, other), max(one, other), version))

    def _joined(self, one: int, other: int, most: float) -> _Joined | float:
        """Two charts as one; where it stretches them more, their stretch, infinite if they fold."""
        border = self._borders[one][other]
        run = self._longest_run(border)
        pairs = np.concatenate([self._names(edge) for edge in run])
        is_first = np.repeat(self._owner[self._sides[run, 0]] == one, 2)
        pairs = np.unique(np.where(is_first[:, None], pairs, pairs[:, ::-1]), axis=0)
        moved, miss = _moved(self.uvs[pairs[:, 1]], self.uvs[pairs[:, 0]])
        if miss > _MOST_BEND * self._length[run].sum():
            return np.inf
        glued: dict[int, int] = {}
        for first, second in pairs.tolist():
            _unite(glued, first, second)
        seams = [*(set(border) - set(run)), *self._seams[one], *self._seams[other]]
        zipped = self._zipped(sorted(seams), glued)
        least = np.inf
        for same in (zipped, glued) if len(zipped) > len(glued) else (glued,):
            found, stretch = self._flattened(one, other, same, moved)
            if stretch >= most:
                least = min(least, stretch)
            elif not _crosses(found.uvs, np.searchsorted(found.names, found.corners)):
                return found
        return least

    def _longest_run(self, edges: Iterable[int]) -> list[int]:
        """Of the edges between two charts those of the longest piece in one."""
        at: dict[int, list[int]] = {}
        for edge in edges:
            for end in self._ends[edge].tolist():
                at.setdefault(end, []).append(edge)
        left, runs = dict.fromkeys(edges), []
        while left:
            run = [left.popitem()[0]]
            for edge in run:
                for end in self._ends[edge].tolist():
                    for following in at[end] if len(at[end]) == 2 else ():
                        if following in left:
                            del left[following]
                            run.append(following)
            runs.append(run)
        return max(runs, key=lambda run: self._length[run].sum())

    def _zipped(self, seams: list[int], glued: Mapping[int, int]) -> dict[int, int]:
        """Corners that are one, those of seams too that begin where two have become one."""
        same, is_new = dict(glued), True
        while is_new:
            is_new = False
            for edge in seams:
                first, last = (
                    [_root(same, int(name)) for name in end] for end in self._names(edge)
                )
                if (first[0] == first[1]) != (last[0] == last[1]):
                    _unite(same, *(last if first[0] == first[1] else first))
                    is_new = True
        return same

    def _flattened(
        self, one: int, other: int, same: Mapping[int, int], moved: tuple[complex, Array, Array]
    ) -> tuple[_Joined, float]:
        """Two charts glued where corners are the same, and their stretch; infinite if they fold."""
        faces = np.concatenate([self._faces[one], self._faces[other]])
        before = np.unique(self.corners[faces])
        start = self.uvs[before]
        is_moved = np.isin(before, self.corners[self._faces[other]])
        start[is_moved] = _placed(start[is_moved], moved)
        roots = np.array([_root(same, name) for name in before.tolist()])
        names, where = np.unique(roots, return_inverse=True)
        corners = roots[np.searchsorted(before, self.corners[faces])]
        local = np.searchsorted(names, corners)
        count = np.bincount(where)
        start = np.stack([np.bincount(where, start[:, k]) / count for k in (0, 1)], axis=1)
        try:
            uvs = _as_rigid(self._rest[faces], self._inverse[faces], local, start)
        except RuntimeError:  # faces without an area leave corners without a place
            return _Joined(names, start, faces, corners), np.inf
        large, small = _singular(_edges(uvs, local) @ self._inverse[faces])
        area = self._area[faces]
        stretch = (area * ((large - 1) ** 2 + (small - 1) ** 2)).sum() / area.sum()
        folds = not (small > _LEAST_WIDTH).all()
        return _Joined(names, uvs, faces, corners), np.inf if folds else float(stretch)

    def _take(self, one: int, other: int, joined: _Joined) -> None:
        """Let a chart be another's part."""
        self.uvs[joined.names] = joined.uvs
        self.corners[joined.faces] = joined.corners
        self._owner[self._faces.pop(other)] = one
        self._faces[one] = joined.faces
        self._version[one] += self._version[other] + 1
        self._seams[one] += self._borders[one].pop(other) + self._seams.pop(other)
        names = {edge: self._names(edge) for edge in self._seams[one]}
        self._seams[one] = [e for e, ends in names.items() if (ends[:, 0] != ends[:, 1]).any()]
        for chart, edges in self._borders.pop(other).items():
            if chart != one:
                del self._borders[chart][other]
                both = self._borders[one].get(chart, []) + edges
                self._borders[one][chart] = self._borders[chart][one] = both
        self._perimeter[one] = self._rim(one)
        for chart in self._borders[one]:
            self._enqueue(one, chart)


def _flat(triangles: Array) -> Array:
    """Triangles (N, 3, 3) laid into a plane: their two edges (N, 2, 2) from the first corner."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    length = np.linalg.norm(a, axis=1).clip(1e-12)
    along = (a * b).sum(axis=1) / length
    across = np.linalg.norm(np.cross(a, b), axis=1) / length
    flat = np.zeros((len(triangles), 2, 2))
    flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1] = length, along, across.clip(1e-9 * length)
    return flat


def _edges(uvs: Array, corners: Ints) -> Array:
    """Both edges (N, 2, 2) of faces from their first corner, as columns."""
    a, b, c = np.moveaxis(uvs[corners], 1, 0)
    return np.stack([b - a, c - a], axis=2)


def _parts(corners: Ints, count: int) -> Ints:
    """Which chart each face belongs to, (Nf,), from the names of its corners."""
    one, other = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    _, label = connected_components(links, directed=False)
    return np.unique(label[corners[:, 0]], return_inverse=True)[1]


def _shared_edges(faces: Ints, count: int) -> tuple[Ints, Ints, Ints]:
    """Edges of two faces that go round alike: ends, faces and their first corners, (Ne, 2) each."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = ends.min(axis=1) * count + ends.max(axis=1)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    two = first[np.diff(first, append=len(order)) == 2]
    pairs = np.stack([order[two], order[two + 1]], axis=1)
    pairs = pairs[ends[pairs[:, 0], 0] == ends[pairs[:, 1], 1]]
    return ends[pairs[:, 0]], pairs % len(faces), pairs // len(faces)


def _root(same: Mapping[int, int], name: int) -> int:
    while name in same:
        name = same[name]
    return name


def _unite(same: dict[int, int], one: int, other: int) -> None:
    one, other = _root(same, one), _root(same, other)
    if one != other:
        same[other] = one


def _moved(points: Array, targets: Array) -> tuple[tuple[complex, Array, Array], float]:
    """The turn and shift that bring points (N, 2) onto others, and the distance that is left."""
    middle, there = points.mean(axis=0), targets.mean(axis=0)
    one, other = ((p - m) @ np.array([1, 1j]) for p, m in ((points, middle), (targets, there)))
    turn = complex(np.vdot(one, other))
    move = turn / max(abs(turn), 1e-30), middle, there
    miss = ((_placed(points, move) - targets) ** 2).sum(axis=1).mean() ** 0.5
    return move, float(miss)


def _placed(points: Array, move: tuple[complex, Array, Array]) -> Array:
    turn, middle, there = move
    moved = (points - middle) @ np.array([1, 1j]) * turn
    return np.stack([moved.real, moved.imag], axis=1) + there


def _as_rigid(rest: Array, inverse: Array, corners: Ints, uvs: Array) -> Array:
    """Coordinates (N, 2) with which faces are turned and hardly stretched, from a first guess."""
    own = np.concatenate([np.zeros((len(rest), 1, 2)), np.swapaxes(rest, 1, 2)], axis=1)
    sides, weights = [], []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        a, b = own[:, i] - own[:, k], own[:, j] - own[:, k]
        cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).clip(1e-12)
        sides.append((corners[:, i], corners[:, j], own[:, i] - own[:, j]))
        weights.append(((a * b).sum(axis=1) / cross).clip(0.02, 20.0))
    one, other = (np.concatenate([side[k] for side in sides]) for k in (0, 1))
    weight, count = np.concatenate(weights), len(uvs)
    links = (np.r_[-weight, -weight, weight, weight], (np.r_[one, other, one, other],
             np.r_[other, one, one, other]))  # fmt: skip
    matrix = coo_matrix(links, shape=(count, count)).tocsc()[1:, 1:]
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                  options={"SymmetricMode": True})  # fmt: skip
    for _ in range(_ROUNDS):
        slope = _edges(uvs, corners) @ inverse
        turn = slope[:, 0, 0] + slope[:, 1, 1] + 1j * (slope[:, 1, 0] - slope[:, 0, 1])
        turn /= np.abs(turn).clip(1e-12)
        pulls = [turn * (side[2] @ np.array([1, 1j])) for side in sides]
        pull = weight * np.concatenate(pulls)
        sums = [
            np.bincount(one, part, count) - np.bincount(other, part, count)
            for part in (pull.real, pull.imag)
        ]
        uvs = np.zeros((count, 2))
        uvs[1:] = solver.solve(np.stack(sums, axis=1)[1:])
    return uvs


def _singular(slope: Array) -> tuple[Array, Array]:
    """Singular values (N,) of matrices (N, 2, 2), the smaller one below 0 where they mirror."""
    a, b, c, d = slope[:, 0, 0], slope[:, 0, 1], slope[:, 1, 0], slope[:, 1, 1]
    turned, mirrored = np.hypot(a + d, c - b) / 2, np.hypot(a - d, c + b) / 2
    return turned + mirrored, turned - mirrored


def _crosses(uvs: Array, corners: Ints) -> bool:
    """Whether the rim of faces crosses itself; also true where there is none."""
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True,
                                return_counts=True)  # fmt: skip
    rim = edges[first[count == 1]]
    start, step = uvs[rim[:, 0]], uvs[rim[:, 1]] - uvs[rim[:, 0]]

    # what lies in one line is on neither side
    least = _LEAST_OVERLAP * np.linalg.norm(step, axis=1) * np.ptp(uvs)

    def side(points: Array) -> Array:
        to = points[None] - start[:, None]
        value = step[:, None, 0] * to[..., 1] - step[:, None, 1] * to[..., 0]
        return np.where(np.abs(value) > least[:, None], value, 0.0)

    apart = side(start) * side(uvs[rim[:, 1]]) < 0
    touch = (rim[:, None, :, None] == rim[None, :, None, :]).any(axis=(2, 3))
    return not len(rim) or bool((apart & apart.T & ~touch).any())
