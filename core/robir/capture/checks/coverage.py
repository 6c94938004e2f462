# SPDX-License-Identifier: Apache-2.0
"""From which directions photographs are missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robir.capture.capture import Bounds, Finding, View
from robir.capture.frames import Array
from robir.capture.refusal import note, warning

WIDE_GAP = 60.0  # degrees without a camera around a direction that count as a side not photographed
_SEEN = 30.0  # degrees around a camera that count as photographed
_MISSING = 45.0  # degrees around a camera beyond which a direction counts as missing
_BELOW = -15.0  # elevation in degrees under which nothing is missed: objects stand on something
_SAMPLES = 500


def directions_to(views: Sequence[View], bounds: Bounds) -> Array:
    """Unit vectors from the object's centre to the cameras, (V, 3), capture frame."""
    offsets = np.array([view.camera.position - bounds.centre for view in views])
    return offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-12)


def upwards(views: Sequence[View]) -> Array:
    """The direction that level cameras agree is up, unit, (3,).

    It is the one most nearly at right angles to the rows of all pictures.
    """
    axes = np.array([view.camera.camera_to_world[:3, :3] for view in views])
    _, vectors = np.linalg.eigh(np.einsum("vi,vj->ij", axes[:, :, 0], axes[:, :, 0]))
    up = vectors[:, 0]
    return up if up @ axes[:, :, 1].sum(axis=0) >= 0 else -up


def check_coverage(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """How much of the sphere of directions is photographed, and where most is missing.

    One finding, whose numbers are: `seen_share`, of the directions above -15 degrees those within
    30 degrees of a camera, in [0, 1]; `gap_degrees`, the widest angle to the nearest camera;
    `gap_direction`, the unit vector in the capture's frame that it belongs to; `up`, unit; and
    `missing`, unit vectors (N, 3) farther than 45 degrees from every camera.
    """
    cameras, up = directions_to(views, bounds), upwards(views)
    sphere = _spread(_SAMPLES)
    sphere = sphere[sphere @ up >= np.sin(np.radians(_BELOW))]
    angles = np.degrees(np.arccos(np.clip((sphere @ cameras.T).max(axis=1), -1.0, 1.0)))
    widest = int(np.argmax(angles))
    gap, direction = float(angles[widest]), sphere[widest]
    share = float((angles <= _SEEN).mean())
    nearest = views[int(np.argmax(cameras @ direction))].name
    elevation = float(np.degrees(np.arcsin(np.clip(direction @ up, -1.0, 1.0))))
    message = (
        f"Photographs look at {100 * share:.0f} % of the object's sides above the ground from "
        f"within {_SEEN:.0f} degrees; the widest gap is {gap:.0f} degrees from the nearest "
        f"photograph, {nearest}, {_words(elevation)}"
    )
    numbers: dict[str, Any] = {"seen_share": round(share, 3), "gap_degrees": round(gap, 1)}
    vectors = {"gap_direction": direction, "up": up, "missing": sphere[angles > _MISSING]}
    numbers |= {key: np.round(vector, 4).tolist() for key, vector in vectors.items()}
    if gap <= WIDE_GAP:
        return [note("coverage", message, **numbers)]
    cure = "Add photographs from there; what no photograph shows is guessed."
    return [warning("coverage-gap", message, cure, nearest, **numbers)]


def _words(elevation: float) -> str:
    if elevation > 60:
        return "from above"
    height = "at the height of the object" if abs(elevation) < 15 else f"{elevation:.0f} degrees up"
    return height if elevation > -15 else f"{-elevation:.0f} degrees down"


def _spread(count: int) -> Array:
    """Directions spread evenly over the sphere by the golden angle, (count, 3), without torch."""
    steps = np.arange(count) + 0.5
    z = 1 - 2 * steps / count
    turn = np.pi * (3 - np.sqrt(5)) * steps
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
