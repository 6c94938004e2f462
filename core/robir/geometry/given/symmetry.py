# SPDX-License-Identifier: Apache-2.0
"""Turns of a mesh that its outlines hardly tell apart: about an axis, or onto its other side.

An axis of symmetry goes through the centroid of the surface and is a principal axis of its second
moments, so that is where turns are tried; where moments are equal, as a cube's, axes between these
are tried as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robir.geometry.given.placing import Agreement, Outlines, downhill
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.similarity import Similarity, turn_about, turn_in_words

Array = NDArray[np.float64]


_TURNS = 12  # turns about an axis, the mesh's own among them
# share of outline and mask that a turn may cost, before it is followed downhill, to be one that
# masks hardly tell: those that are guessed are wrong by about as much
_ALIKE = 0.04
_TOLD = 0.02  # the same after that, from which outlines tell in any case
# standard errors over the photographs from which outlines tell by less than that as well
_SURE = 3.0
_FOLLOWED = 4  # turns that are followed
# of the first steps of a search downhill; what is followed by fine outlines is nearly right
_REACH = 0.3
_APART = 15.0  # angle by which turns differ at least that count as two (degrees)


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Where a mesh stands by its outlines, and how sure that is.

    Attributes:
        place: Brings it there.
        agreement: Of its outlines with the masks there.
        axes: (A, 3) unit, mesh frame: it is round about them, as far as outlines show.
        others: Other places where it fits as well, with what they share, none about `axes`.
    """

    place: Similarity
    agreement: Agreement
    axes: Array
    others: tuple[tuple[Similarity, float], ...]

    def notes(self) -> tuple[str, ...]:
        """What outlines do not tell, for the user."""
        if len(self.axes) > 1:
            return (
                "The mesh is as good as a ball: outlines do not tell how it is turned. The result "
                "is right about its shape, and its light may come from elsewhere in the mesh's "
                "frame than it did.",
            )
        notes = []
        if len(self.axes):
            about = ", ".join(f"{x:.3f}" for x in self.axes[0])
            notes.append(
                f"Outlines do not tell the turn about ({about}): the mesh is round about it. What "
                "its texture showed may lie elsewhere in the new one, and its light may come from "
                "elsewhere about this axis."
            )
        if self.others:
            turned = "; ".join(
                f"{turn_in_words(self.place.turn.T @ other.turn)} it shares {share:.1%}"
                for other, share in self.others
            )
            notes.append(
                f"Outlines hardly tell how the mesh stands: it shares {self.agreement.share:.1%} "
                f"with the masks, and turned by {turned}. Look whether photographs and result show "
                "the same side."
            )
        return tuple(notes)


def best_turned(
    place: Similarity,
    surface: tuple[Array, NDArray[np.int32]],
    tracer: EmbreeTracer,
    outlines: tuple[Outlines, Outlines],
) -> Standing:
    """The best of a place and its turns that outlines hardly tell from it, and what those are.

    Args:
        place: Where the mesh fits.
        surface: Vertices (Nv, 3) and faces (Nf, 3) of the mesh.
        tracer: Of the mesh.
        outlines: The masks, coarse and fine.
    """
    coarse, fine = outlines
    middle, axes = _axes(*surface)
    share = fine.of(tracer, place).share
    turns = _turns(axes, _TURNS)
    tried = [place.after(turn_about(turn, middle)) for turn in turns]
    shares = np.array([fine.of(tracer, one).share for one in tried])
    alike = shares >= share - _ALIKE
    per_axis = _TURNS - 1
    about = alike[: 3 * per_axis].reshape(3, -1).all(axis=1)
    order = [k for k in np.argsort(-shares) if alike[k]]
    # about an axis of something round all are the same, and the best of them is enough
    same = [k for k in order if k < 3 * per_axis and about[k // per_axis]]
    order = [k for k in order if k not in same[1:]][:_FOLLOWED]
    found = [place, *(downhill(tried[k], tracer, coarse)[0] for k in order)]
    found = [downhill(one, tracer, fine, _REACH)[0] for one in found]
    agreements = [fine.of(tracer, one) for one in found]
    best = max(range(len(found)), key=lambda k: agreements[k].share)
    others: list[tuple[Similarity, float]] = []
    for k in sorted(range(len(found)), key=lambda k: -agreements[k].share):
        near = [found[best], *(one for one, _ in others)]
        is_new = all(_is_another(found[k], one, axes.T[about], _APART) for one in near)
        if is_new and _is_as_good(agreements[k], agreements[best]):
            others.append((found[k], agreements[k].share))
    return Standing(
        place=found[best],
        agreement=agreements[best],
        axes=axes.T[about],
        others=() if about.sum() > 1 else tuple(others),
    )


def _axes(vertices: Array, faces: NDArray[np.int32]) -> tuple[Array, Array]:
    """Centroid (3,) of a surface and its principal axes, the columns of a (3, 3) rotation."""
    corners = vertices[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(first, second), axis=1)
    area /= area.sum()
    places = corners.mean(axis=1)
    middle = area @ places
    _, axes = np.linalg.eigh((area[:, None] * (places - middle)).T @ (places - middle))
    return middle, axes * np.sign(np.linalg.det(axes))


def _turns(axes: Array, count: int) -> Array:
    """Turns that are tried, (N, 3, 3): `count - 1` about each axis first, axis by axis."""
    angles = np.radians(360.0 / count * np.arange(1, count))
    about = [Rotation.from_rotvec(a * axis).as_matrix() for axis in axes.T for a in angles]
    between = [
        axes @ turn @ axes.T
        for turn in Rotation.create_group("O").as_matrix()
        if turn.diagonal().max() < 0.5  # neither about one of the axes nor none
    ]
    return np.array([*about, *between])


def _is_as_good(one: Agreement, best: Agreement) -> bool:
    """Whether the best place is not surely better than another, photograph by photograph."""
    lead = best.shares - one.shares
    error = lead.std(ddof=1) / len(lead) ** 0.5 if len(lead) > 1 else np.inf
    return bool(lead.mean() < min(_TOLD, _SURE * error + 1e-9))


def _is_another(one: Similarity, other: Similarity, round_about: Array, apart: float) -> bool:
    """Whether two places differ by `apart` degrees and by no turn about these axes (A, 3)."""
    between = Rotation.from_matrix(one.turn.T @ other.turn)
    if np.degrees(between.magnitude()) < apart:
        return False
    moved = between.apply(round_about) if len(round_about) else np.zeros((0, 3))
    cosine = np.einsum("ad,ad->a", moved, round_about)
    return bool((np.degrees(np.arccos(cosine.clip(-1, 1))) > apart).all())
