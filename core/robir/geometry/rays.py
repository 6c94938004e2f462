# SPDX-License-Identifier: Apache-2.0
"""Photographs as rays: reduced images, and random pixels in and around the masks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, zoom
from skimage.transform import downscale_local_mean
from torch import Tensor

from robir.capture.camera import Camera
from robir.capture.capture import View

_RING = 4  # width of the band around the mask whose pixels teach the field what is empty


@dataclass(frozen=True, slots=True, kw_only=True)
class ReducedPhoto:
    """A view reduced to the size the fit works at."""

    camera: Camera  # camera of exactly this size, unit frame
    # (H, W, 4) float32 in [0, 1], display values times coverage, and coverage
    layers: NDArray[np.float32]

    @property
    def premultiplied_display(self) -> NDArray[np.float32]:
        """(H, W, 3), display values times coverage."""
        return self.layers[..., :3]

    @property
    def coverage(self) -> NDArray[np.float32]:
        """(H, W)."""
        return self.layers[..., 3]


def reduce_view(view: View, side: int) -> ReducedPhoto:
    """Area-average a view so that its longer side is about `side` pixels; never enlarges."""
    coverage = view.mask.astype(np.float32) / 255.0
    image = view.image_display.astype(np.float32) / 255.0 * coverage[..., None]
    stack = np.concatenate([image, coverage[..., None]], axis=2)
    longest = max(coverage.shape)
    if longest > side:
        factor = max(1, longest // side)
        height, width = (n - n % factor for n in coverage.shape)
        if factor > 1:
            stack = downscale_local_mean(stack[:height, :width], (factor, factor, 1))
        rest = side / max(stack.shape[:2])
        if rest < 1.0:
            stack = zoom(stack, (rest, rest, 1), order=1, grid_mode=True, mode="nearest")
        kept = (width / coverage.shape[1], height / coverage.shape[0])
    else:
        kept = (1.0, 1.0)
    camera = cropped(view.camera, kept).resized(stack.shape[1], stack.shape[0])
    return ReducedPhoto(camera=camera, layers=np.ascontiguousarray(stack, dtype=np.float32))


def cropped(camera: Camera, kept: tuple[float, float]) -> Camera:
    """The camera of the upper left part of its image, `kept` = shares of width and height."""
    return replace(
        camera,
        width=round(camera.width * kept[0]),
        height=round(camera.height * kept[1]),
    )


class RaySampler:
    """Random pixels of all photographs, drawn in shuffled order without repeats."""

    def __init__(self, photos: list[ReducedPhoto], device: str, generator: torch.Generator) -> None:
        views, pixels, targets = [], [], []
        ring = np.ones((3, 3), bool)
        for number, photo in enumerate(photos):
            wanted = binary_dilation(photo.coverage > 0.02, ring, iterations=_RING)
            rows, columns = np.nonzero(wanted)
            views.append(np.full(len(rows), number, np.int16))
            pixels.append(np.stack([columns, rows], axis=1).astype(np.int16))
            targets.append(np.round(photo.layers[wanted] * 255.0).astype(np.uint8))
        self._views, self._pixels, self._targets = (
            torch.from_numpy(np.concatenate(parts)).to(device) for parts in (views, pixels, targets)
        )
        self._device = device
        cameras = [photo.camera for photo in photos]
        poses = torch.tensor(np.stack([c.camera_to_world for c in cameras])).float()
        self._poses = poses.to(device)
        lenses = torch.tensor([[c.fx, c.fy, c.cx, c.cy] for c in cameras]).float()
        self._lenses = lenses.to(device)
        self._generator = generator
        self._shuffle()

    def _shuffle(self) -> None:
        order = torch.randperm(len(self._views), generator=self._generator)
        self._order, self._next = order.to(self._device), 0

    def draw(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Draw rays: origins and unit directions (R, 3), unit frame, and targets (R, 4).

        Targets are display RGB times coverage, and coverage, in [0, 1]. Fewer rays than `count`
        come back only if the capture has fewer pixels.
        """
        if self._next + count > len(self._order):
            self._shuffle()
        chosen = self._order[self._next : self._next + count]
        self._next += count
        view = self._views[chosen].int()
        lens = self._lenses.index_select(0, view)
        image = self._pixels[chosen].float() + 0.5
        x = (image[:, 0] - lens[:, 2]) / lens[:, 0]
        y = -(image[:, 1] - lens[:, 3]) / lens[:, 1]
        local = torch.stack([x, y, -torch.ones_like(x)], dim=1)
        pose = self._poses.index_select(0, view)
        directions = torch.einsum("rij,rj->ri", pose[:, :3, :3], local)
        directions = torch.nn.functional.normalize(directions, dim=1)
        target = self._targets[chosen].float() / 255.0
        return pose[:, :3, 3].contiguous(), directions, target
