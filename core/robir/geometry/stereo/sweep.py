# SPDX-License-Identifier: Apache-2.0
"""Depth of a photograph's pixels, by a sweep of planes through the photographs beside it.

Collins 1996, "A space-sweep approach to true multi-image matching": a plane parallel to the
picture is moved through the scene, and other photographs, seen by way of it, are compared with
this one by normalised cross-correlation, which exposure and white balance do not change.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.geometry.rays import ReducedPhoto

Floats = NDArray[np.float32]


def _along(lines: Iterable[Floats], sums: Iterable[Floats], penalties: tuple[float, float]) -> None:
    """Add the costs (N, D) of the best paths that reach each line from the one before, in place."""
    small, large = penalties
    before: Floats | None = None
    for line, total in zip(lines, sums, strict=True):
        path = line.copy()
        if before is not None:
            least = before.min(axis=1, keepdims=True)
            best = np.minimum(before, least + large)
            np.minimum(best[:, 1:], before[:, :-1] + small, out=best[:, 1:])
            np.minimum(best[:, :-1], before[:, 1:] + small, out=best[:, :-1])
            path += best
            path -= least
        total += path
        before = path


def aggregate(cost: Floats, penalties: tuple[float, float]) -> Floats:
    """Mean costs (H, W, D) over four directions of the best paths through a pixel at a label.

    Hirschmueller 2008, "Stereo processing by semiglobal matching and mutual information", eq. 13,
    along the two rows and the two columns through each pixel.
    """
    total = np.zeros_like(cost)
    for costs, sums in ((cost, total), (cost.swapaxes(0, 1), total.swapaxes(0, 1))):
        _along(costs, sums, penalties)
        _along(costs[::-1], sums[::-1], penalties)
    return total / 4


def refined_minimum(cost: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Label (H, W) of the least cost (H, W, D), and the same between labels by a parabola."""
    label = cost.argmin(axis=2)
    middle = np.clip(label, 1, cost.shape[2] - 2)
    low, mid, high = (
        np.take_along_axis(cost, (middle + step)[..., None], axis=2)[..., 0] for step in (-1, 0, 1)
    )
    bend = low + high - 2 * mid
    shift = np.where(bend > 1e-6, (low - high) / (2 * np.maximum(bend, 1e-6)), 0.0).clip(-0.5, 0.5)
    return label, np.where(label == middle, middle + shift, label).astype(np.float32)


def label_spread(cost: Floats, temperature: float) -> Floats:
    """Deviation (H, W), labels, of a label whose likelihood is exp(-cost / temperature)."""
    weight = np.exp((cost.min(axis=2, keepdims=True) - cost) / temperature)
    weight /= weight.sum(axis=2, keepdims=True)
    label = np.arange(cost.shape[2], dtype=np.float32)
    mean = weight @ label
    return np.sqrt(np.maximum(weight @ label**2 - mean**2, 0.0))


_FEWEST_PLANES = 16  # planes of a sweep at least
_MOST_PLANES = 128  # and at most
_EARLY = 1.5  # matching cost of a depth before the visual hull: more than of any that disagrees
_WHOLE = 0.95  # coverage from which a pixel is object, for the refinement too
_WINDOW = 3  # half side of the windows that are compared, pixels
# standard deviation of display values that no texture explains; windows with less contrast than
# that agree with nothing
_NOISE = 0.01
# what a step of one depth, and of more, between neighbouring pixels costs, in correlation
_PENALTIES = (0.06, 0.25)
_TEMPERATURE = 0.05  # difference of that cost that chance makes


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoPicture:
    """A photograph as it is compared."""

    camera: Camera  # camera of this size, unit frame
    grey: Tensor  # (H, W) float32 display brightness of the object, 0 outside the mask
    whole: NDArray[np.bool_]  # (H, W) bool, wholly object

    @classmethod
    def of(cls, photo: ReducedPhoto) -> StereoPicture:
        """A photograph without what lies around the object."""
        grey = photo.premultiplied_display.mean(axis=2) / np.maximum(photo.coverage, 0.05)
        kept = np.where(photo.coverage > 0.05, grey, 0.0).astype(np.float32)
        whole = photo.coverage > _WHOLE
        return cls(camera=photo.camera, grey=torch.from_numpy(kept), whole=whole)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMap:
    """Depths of a photograph's pixels."""

    camera: Camera  # its camera, unit frame
    depth: Floats  # (H, W) along the viewing direction; not a number where none is known
    correlation: Floats  # (H, W) of the photographs at that depth, 0 where there is none
    # (H, W), the same where one depth alone explains the photographs, and the less the more depths
    # do
    trust: Floats


def window_mean(image: Floats, half: int) -> Floats:
    """Means (N, H, W) over square windows of 2 half + 1 pixels; mirrored at the border."""
    size, means = (2 * half + 1, 2 * half + 1), np.empty_like(image)
    for plane, mean in zip(image, means, strict=True):
        cv2.boxFilter(plane, -1, size, dst=mean, borderType=cv2.BORDER_REFLECT_101)
    return means


def correlation(one: Floats, other: Floats, half: int, noise: float) -> Floats:
    """Normalised cross-correlation (N, H, W) of windows about every pixel of two pictures.

    Noise counts to the variance, so that windows without texture correlate with nothing.
    """
    mean, means = window_mean(one, half), window_mean(other, half)
    variance = (window_mean(one * one, half) - mean * mean).clip(min=0) + noise**2
    variances = (window_mean(other * other, half) - means * means).clip(min=0) + noise**2
    covariance = window_mean(one * other, half) - mean * means
    return covariance / np.sqrt(variance * variances)


def mean_of_best(maps: list[Floats], count: int) -> Floats:
    """Mean of the `count` largest of some arrays of one shape, at each place."""
    best = [np.full_like(maps[0], -np.inf) for _ in range(count)]
    for rest in maps:
        for rank, above in enumerate(best):
            best[rank], rest = np.maximum(above, rest), np.minimum(above, rest)
    return sum(best[1:], start=best[0]) / np.float32(count)


def seen_through_planes(
    own: Camera, other: Camera, depths: NDArray[np.float64]
) -> tuple[Tensor, Tensor]:
    """Where another camera sees the points of planes parallel to a camera's picture.

    Of depths (D,): places (D, H W, 2) in the other picture from -1 to 1 across it, as grid_sample
    has them, and whether they lie in it (D, H W).
    """
    pixels = own.pixel_centres()
    x, y = (pixels[:, 0] - own.cx) / own.fx, -(pixels[:, 1] - own.cy) / own.fy
    rotation = other.camera_to_world[:3, :3]
    rays = np.stack([x, y, -np.ones_like(x)]).T @ own.camera_to_world[:3, :3].T @ rotation
    start = (own.position - other.position) @ rotation
    slope, begin = (torch.from_numpy(part).float() for part in (rays.T.copy(), start))
    depth = torch.from_numpy(depths).float()[:, None]
    right, up, back = (slope[axis] * depth + begin[axis] for axis in range(3))
    away = (-back).clamp(min=1e-6)
    column = (other.fx * right / away + other.cx) * (2 / other.width) - 1
    row = (-other.fy * up / away + other.cy) * (2 / other.height) - 1
    inside = (column.abs() <= 1) & (row.abs() <= 1) & (back < 0)
    return torch.stack([column, row], dim=-1), inside


def plane_depths(near: float, far: float, baseline: float, focal: float) -> NDArray[np.float64]:
    """Depths of a sweep's planes, even in inverse depth, about a pixel of parallax apart."""
    parallax = np.ceil((1 / near - 1 / far) * baseline * focal)
    count = int(np.clip(parallax, _FEWEST_PLANES, _MOST_PLANES))
    return 1 / np.linspace(1 / near, 1 / far, count)


def sweep(own: StereoPicture, others: list[StereoPicture], entry: Floats, far: float) -> DepthMap:
    """Depths at which a photograph agrees with at least two others beside it.

    Of the pixels that are wholly object and meet the visual hull, which their rays enter at depth
    `entry` (H, W), infinite where they miss it; nothing lies behind `far`.
    """
    camera = own.camera
    inside = own.whole & np.isfinite(entry)
    apart = np.linalg.norm([o.camera.position - camera.position for o in others], axis=1)
    start = float(entry[inside].min())
    baseline, far = float(np.median(apart)), max(far, 1.01 * start)
    depths = plane_depths(start, far, baseline, camera.fx)
    agreed, grey = [], own.grey.numpy()[None]
    for other in others:
        places, is_seen = seen_through_planes(camera, other.camera, depths)
        shape = (len(depths), camera.height, camera.width)
        warped = grid_sample(
            other.grey[None, None],
            places.view(1, len(depths), -1, 2),
            padding_mode="border",
            align_corners=False,
        ).view(shape)
        alike = correlation(grey, warped.numpy(), _WINDOW, _NOISE)
        agreed.append(alike * is_seen.view(shape).numpy())
    # the better half: what lies in front of the others hides the point from some
    best = mean_of_best(agreed, (len(others) + 1) // 2)
    cost = np.ascontiguousarray(1 - best.transpose(1, 2, 0))
    step = (depths[1:] - depths[:-1]).max()
    cost[depths < entry[..., None] - step] = _EARLY
    paths = aggregate(cost, _PENALTIES)
    label, exact = refined_minimum(paths)
    spread = label_spread(paths, _TEMPERATURE)
    inverse = np.interp(exact, np.arange(len(depths)), 1 / depths)
    alike = 1 - np.take_along_axis(cost, label[..., None], axis=2)[..., 0]
    alike = np.where(inside, alike.clip(0, 1), 0).astype(np.float32)
    return DepthMap(
        camera=camera,
        depth=np.where(inside, 1 / inverse, np.nan).astype(np.float32),
        correlation=alike,
        trust=alike / (1 + spread**2),
    )
