# SPDX-License-Identifier: Apache-2.0
"""Cameras turned until the photographs agree with what a field shows of them.

A pixel of the rendering that should be found at p in a photograph I is found at p + J w once the
camera turns by w; to first order r = render(p) - I(p) = grad I(p) J w, three unknowns a camera
(Lucas and Kanade 1981, "An iterative image registration technique"). Field and cameras take turns,
as in Lin et al. 2021, "BARF: bundle-adjusting neural radiance fields", with the least squares of a
camera solved in closed form. Cameras turn about their own centres, which stay: from outside an
object, a small shift of a camera looks like a turn.

All cameras together may follow a shift of the object, which no photograph tells. What the turns
share with a motion of the world is therefore taken out of them: the result keeps to the frame of
the given cameras.

Batch letters: V cameras, P pixels, K points, B motions of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.geometry.fit.field_preview import RAYS, Renderer
from robir.geometry.rays import Photo, reduce_view

Array = NDArray[np.float64]


# longer side of the photographs that are compared (pixels); a coarse field shows no more
_IMAGE_SIDE = 200
_PIXELS = 600  # pixels of a photograph that are compared, drawn where it changes most
_BLUR = 0.7  # standard deviation of the filter under which a photograph's slopes are taken (pixels)
_BORDER = 2  # left out along a picture's border (pixels)
# difference from the rendering, in multiples of the photograph's median, at which a pixel counts
# half: what the field does not show yet must not turn the camera
_TOLERANCE = 3.0
# standard deviation that is expected of a given camera about each of its axes; it only holds what
# the photograph does not tell, as the roll about a plain ball (degrees)
_PRIOR = 1.0
# rounds of reweighting by which the motion of the world is found without the worst cameras
_FRAME_ROUNDS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sample:
    """What is compared of one photograph.

    Attributes:
        camera: As given, unit frame.
        pixels: (P, 2) pixel centres.
        wanted: (P, 4) display RGB times coverage, and coverage.
        slope: (P, 4, 2) its change along x and y, per pixel.
    """

    camera: Camera
    pixels: Array
    wanted: Array
    slope: Array


class Alignment:
    """Turns of cameras that make photographs fit a field.

    Args:
        views: Photographs, unit frame.
        seed: Of the choice of pixels.

    Attributes:
        turns: (V, 3) rotation vectors in each camera's own axes, radians.
    """

    def __init__(self, views: Sequence[View], seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._samples = [_sample(reduce_view(view, _IMAGE_SIDE), rng) for view in views]
        self.turns: Array = np.zeros((len(views), 3))
        self._frame = _Frame([sample.camera for sample in self._samples], _FRAME_ROUNDS)

    @property
    def cameras(self) -> list[Camera]:
        """The turned cameras."""
        samples = zip(self._samples, self.turns, strict=True)
        return [turned(sample.camera, turn) for sample, turn in samples]

    def shifts(self, turns: Array) -> Array:
        """(V,) by how many pixels turns (V, 3) move the object in each photograph."""
        return self._frame.shifts(turns)

    def improve(self, render: Renderer, device: str) -> Array:
        """Turn every camera by one step.

        Args:
            render: Draws the present field.
            device: Torch device of the rays.

        Returns:
            (V,) median difference of each photograph from the rendering before the step, display
            values.
        """
        shown = self._rendered(render, device)
        prior = np.radians(_PRIOR)
        steps, misfits = np.zeros_like(self.turns), np.zeros(len(shown))
        for number, (sample, rendered) in enumerate(zip(self._samples, shown, strict=True)):
            residual = rendered - sample.wanted
            size = np.sqrt((residual**2).sum(1))
            misfits[number] = np.median(size)
            # Cauchy's weights: what the field does not show yet must not turn the camera
            scale = _TOLERANCE * misfits[number] + 2e-3
            weight = 1.0 / (1.0 + (size / scale) ** 2)
            motion = np.einsum(
                "pcx,pxw->pcw", sample.slope, image_motion_of_turns(sample.camera, sample.pixels)
            )
            stiffness = (0.5 * scale / prior) ** 2
            matrix = np.einsum("pci,pcj,p->ij", motion, motion, weight) + stiffness * np.eye(3)
            side = np.einsum("pci,pc,p->i", motion, residual, weight)
            steps[number] = np.linalg.solve(matrix, side - stiffness * self.turns[number])
        self.turns = self._frame.kept(self.turns + steps)
        return misfits

    def _rendered(self, render: Renderer, device: str) -> list[Array]:
        """(P, 4) display RGB times coverage, and coverage, at every camera's pixels."""
        rays = [
            camera.rays(sample.pixels)
            for camera, sample in zip(self.cameras, self._samples, strict=True)
        ]
        origins, directions = (
            torch.from_numpy(np.concatenate(part)).float().to(device).split(RAYS)
            for part in zip(*rays, strict=True)
        )
        shown = []
        with torch.no_grad():
            for one, two in zip(origins, directions, strict=True):
                rgb, coverage = render(one, two)
                alpha = coverage.clamp(0.0, 1.0)[:, None]
                shown.append(torch.cat([rgb * alpha, alpha], dim=1).cpu())
        whole = torch.cat(shown).double().numpy()
        ends = np.cumsum([len(sample.pixels) for sample in self._samples])
        return np.split(whole, ends[:-1])


def turned(camera: Camera, turn: Array) -> Camera:
    """A camera turned about its own centre by a rotation vector (3,) in its own axes, radians."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    return replace(camera, camera_to_world=pose)


def image_motion(camera: Camera, local: Array, motion: Array) -> Array:
    """How image points move with what they show.

    Args:
        camera: The camera.
        local: (K, 3) points in the camera's axes.
        motion: (K, 3, B) their motions in these axes.

    Returns:
        (K, 2, B) motions of the image points, pixels, x right and y down.
    """
    depth = -local[:, 2, None]
    across = motion[:, 0] + local[:, 0, None] / depth * motion[:, 2]
    along = motion[:, 1] + local[:, 1, None] / depth * motion[:, 2]
    return np.stack([camera.fx / depth * across, -camera.fy / depth * along], axis=1)


def image_motion_of_turns(camera: Camera, pixels: Array) -> Array:
    """(P, 2, 3) how what pixels (P, 2) show moves in the picture as the camera turns by radians."""
    x = (pixels[:, 0] - camera.cx) / camera.fx
    y = -(pixels[:, 1] - camera.cy) / camera.fy
    return _turning(camera, np.stack([x, y, -np.ones_like(x)], axis=1))


def _turning(camera: Camera, local: Array) -> Array:
    """`image_motion` of points (K, 3) in the axes of a camera that turns about each of these."""
    # points turn the other way
    motion = np.cross(local[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)
    return image_motion(camera, local, motion)


def _sample(photo: Photo, rng: np.random.Generator) -> _Sample:
    """Pixels of a photograph, drawn in proportion to its slope there."""
    layers = np.dstack([photo.premultiplied_display, photo.coverage]).astype(np.float64)
    soft = gaussian_filter(layers, (_BLUR, _BLUR, 0.0))
    down, right = np.gradient(soft, axis=(0, 1))
    steep = np.sqrt((down**2 + right**2).sum(2))
    inner = np.zeros(steep.shape, bool)
    within = slice(_BORDER, -_BORDER)
    inner[within, within] = True
    steep = np.where(inner, steep, 0.0).ravel()
    count = min(_PIXELS, int((steep > 0.0).sum()))
    chosen = rng.choice(len(steep), count, replace=False, p=steep / steep.sum())
    row, column = np.unravel_index(chosen, inner.shape)
    return _Sample(
        camera=photo.camera,
        pixels=np.stack([column, row], axis=1) + 0.5,
        wanted=layers[row, column],
        slope=np.stack([right[row, column], down[row, column]], axis=2),
    )


class _Frame:
    """Tells the turns of cameras from a small motion of the whole world.

    Args:
        cameras: V cameras as given, unit frame.
        rounds: Of reweighting by which a motion of the world is found.
    """

    def __init__(self, cameras: list[Camera], rounds: int) -> None:
        self._rounds = rounds
        # points about the middle of the object stand for it
        points = 0.5 * np.concatenate([np.eye(3), -np.eye(3)])
        spun = [np.cross(axis, points) for axis in np.eye(3)]
        pushed = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
        motion = np.stack([*pushed, *spun, points], axis=2)
        turning, moving = [], []
        for camera in cameras:
            rotation = camera.camera_to_world[:3, :3]
            local = (points - camera.position) @ rotation
            turning.append(_turning(camera, local).reshape(-1, 3))
            own = np.einsum("ji,kjb->kib", rotation, motion)
            moving.append(image_motion(camera, local, own).reshape(-1, motion.shape[2]))
        self._turning, self._moving = np.stack(turning), np.stack(moving)
        self._turned_back = np.linalg.pinv(self._turning)

    def shifts(self, turns: Array) -> Array:
        """(V,) root mean square motion of the object's image by turns (V, 3), pixels."""
        moved = np.einsum("vkw,vw->vk", self._turning, turns)
        return np.sqrt(2.0 * (moved**2).mean(1))

    def kept(self, turns: Array) -> Array:
        """Turns (V, 3) without what they share with a motion of the world.

        The motion, 7 numbers with the scale, is the one that explains the most: it makes the sum
        of the remaining shifts, not of their squares, small. Cameras that are far off do not move
        it, and where only some are off, the others stay.
        """
        moved = np.einsum("vkw,vw->vk", self._turning, turns)
        weight = np.ones(len(turns))
        shared = np.zeros(self._moving.shape[2])
        for _ in range(self._rounds):
            matrix = np.einsum("vka,vkb,v->ab", self._moving, self._moving, weight)
            side = np.einsum("vka,vk,v->a", self._moving, moved, weight)
            shared = np.linalg.solve(matrix, side)
            left = np.sqrt(((moved - self._moving @ shared) ** 2).mean(1))
            weight = 1.0 / np.maximum(left, 0.1 * left.mean() + 1e-9)
        return turns - np.einsum("vwk,vk->vw", self._turned_back, self._moving @ shared)
