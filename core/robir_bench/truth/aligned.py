# SPDX-License-Identifier: Apache-2.0
"""Brings the truth of photographs to where a result stands.

Poses that were found, or that have errors, stand in a frame of another turn, scale and origin than
the truth. What a photograph shows must fall on the same pixels: the similarity is the one that
brings points of the true surface nearest to their true places in all photographs, as the result's
cameras see them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.store import load_settled
from robir.errors import CaptureError
from robir.jobs.paths import JobPaths
from robir.maths.similarity import Similarity, turn_in_words
from robir_bench.truth.files import TrueView, Truth, load_truth, true_environment

Array = NDArray[np.floating[Any]]

FEWEST = 4  # photographs that the result and the truth must share
_POINTS = 60
_OUTLIER = 2.0  # pixels beyond which a point counts by its distance, no longer by its square


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """How the truth's frame lies in the result's."""

    place: Similarity  # brings the truth's frame to the result's
    # root mean square distance of points of the true surface from their true places in the
    # photographs, seen by the result's cameras, pixels of the photographs
    pixels: float
    photographs: int  # how many the result and the truth share

    def described(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "pixels": self.pixels,
            "photographs": self.photographs,
            "turn": turn_in_words(self.place.turn),
            "scale": self.place.scale,
        }


def truth_of(capture: Path, paths: JobPaths) -> tuple[Truth, Alignment | None]:
    """The truth where a result stands, and how it was brought there, if so; or a `CaptureError`."""
    known = load_truth(capture)
    if not known.cameras:
        return known, None
    alignment = align(known, load_settled(paths).views)
    return moved(known, alignment.place), alignment


def align(truth: Truth, views: Sequence[View]) -> Alignment:
    """The similarity from the truth's frame to that of views; `CaptureError` if few are shared."""
    found = {v.name: v.camera for v in views if v.name in truth.cameras}
    if len(found) < FEWEST:
        raise CaptureError(
            f"only {len(found)} photographs of the result are named like those of {truth.root}; "
            "evaluate a result of that capture"
        )
    true = {name: truth.cameras[name] for name in found}
    step = -(-len(truth.vertices) // _POINTS)
    points = truth.vertices[::step].astype(np.float64)
    places = np.stack([_share(camera, points) for camera in true.values()])
    width = next(iter(true.values())).width

    def off(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distances in pixels of the photographs, in both directions."""
        moved = _similarity(numbers)(points)
        seen = np.stack([_share(camera, moved) for camera in found.values()])
        return ((seen - places) * width).ravel()

    start = _by_cameras(true, found)
    turn = Rotation.from_matrix(start.turn).as_rotvec()
    numbers = np.array([*turn, np.log(start.scale), *start.shift])
    solved = least_squares(off, numbers, loss="soft_l1", f_scale=_OUTLIER, x_scale="jac")
    distances = off(solved.x).reshape(-1, 2)
    return Alignment(
        place=_similarity(solved.x),
        pixels=float(np.sqrt((distances**2).sum(axis=1).mean())),
        photographs=len(found),
    )


def moved(truth: Truth, place: Similarity) -> Truth:
    """The truth where a similarity brings it."""
    return replace(
        truth,
        views=tuple(_moved_view(view, place) for view in truth.views),
        cameras={name: camera.moved(place) for name, camera in truth.cameras.items()},
        environment_linear=true_environment(truth.root, truth.scene, place.turn),
        sun_direction=place.turn @ truth.sun_direction,
        vertices=place(truth.vertices.astype(np.float64)).astype(np.float32),
        radius=place.scale * truth.radius,
    )


def _moved_view(view: TrueView, place: Similarity) -> TrueView:
    shape = view.position.shape
    position = place(view.position.reshape(-1, 3).astype(np.float64)).reshape(shape)
    return replace(
        view,
        camera=view.camera.moved(place),
        normal=(view.normal @ place.turn.T).astype(np.float32),
        position=np.where(view.hit[..., None], position, 0.0).astype(np.float32),
    )


def _similarity(numbers: NDArray[np.float64]) -> Similarity:
    turn = Rotation.from_rotvec(numbers[:3]).as_matrix()
    return Similarity(turn=turn, scale=float(np.exp(numbers[3])), shift=numbers[4:])


def _share(camera: Camera, points: Array) -> Array:
    """Where points (N, 3) are in the whole photograph, (N, 2), both in its widths."""
    pose = camera.camera_to_world
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    depth = np.maximum(-local[:, 2], 1e-6)
    left, top, right, _ = camera.whole or (0.0, 0.0, float(camera.width), float(camera.height))
    x = camera.cx + camera.fx * local[:, 0] / depth
    y = camera.cy - camera.fy * local[:, 1] / depth
    return np.stack([x - left, y - top], axis=1) / (right - left)


def _by_cameras(true: Mapping[str, Camera], found: Mapping[str, Camera]) -> Similarity:
    """A first guess: the mean turn between cameras, then scale and shift of their centres."""
    turns = [
        found[name].camera_to_world[:3, :3] @ camera.camera_to_world[:3, :3].T
        for name, camera in true.items()
    ]
    turn = Rotation.from_matrix(np.array(turns)).mean().as_matrix()
    before = np.array([camera.position for camera in true.values()]) @ turn.T
    after = np.array([found[name].position for name in true])
    spread = before - before.mean(axis=0)
    scale = float((spread * (after - after.mean(axis=0))).sum() / (spread**2).sum())
    scale = max(scale, 1e-9)
    return Similarity(
        turn=turn, scale=scale, shift=after.mean(axis=0) - scale * before.mean(axis=0)
    )
