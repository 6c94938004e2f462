# SPDX-License-Identifier: Apache-2.0
"""Similarities: what brings one frame onto another of another turn, scale and origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """x -> scale * turn @ x + shift."""

    turn: Array  # (3, 3) rotation; with a determinant of -1 it mirrors as well
    scale: float  # above 0
    shift: Array  # (3,)

    def __call__(self, points: Array) -> Array:
        """Points (N, 3) where it brings them."""
        return self.scale * points @ self.turn.T + self.shift

    @property
    def inverse(self) -> Similarity:
        """What brings everything back."""
        back = self.turn.T
        return Similarity(
            turn=back, scale=1.0 / self.scale, shift=-(back @ self.shift) / self.scale
        )

    def after(self, first: Similarity) -> Similarity:
        """What the first and then this one do."""
        return Similarity(
            turn=self.turn @ first.turn,
            scale=self.scale * first.scale,
            shift=self(first.shift[None])[0],
        )

    def outside(self, centre: Array, radius: float) -> Similarity:
        """The same in the frame in which the unit sphere has a centre (3,) and a radius."""
        shift = centre + radius * self.shift - self.scale * self.turn @ centre
        return Similarity(turn=self.turn, scale=self.scale, shift=shift)

    def described(self) -> str:
        """In words, for the user."""
        by = ", ".join(f"{x:.5g}" for x in self.shift)
        return (
            f"turned by {turn_in_words(self.turn)}, scaled by {self.scale:.6g} and "
            f"shifted by ({by})"
        )


AS_IT_IS = Similarity(turn=np.eye(3), scale=1.0, shift=np.zeros(3))


def turn_in_words(turn: Array) -> str:
    """Angle and axis of a rotation (3, 3), for the user."""
    axis = Rotation.from_matrix(turn).as_rotvec(degrees=True)
    angle = float(np.linalg.norm(axis))
    about = ", ".join(f"{x:.3f}" for x in axis / max(angle, 1e-9))
    return f"{angle:.2f} degrees about ({about})"
