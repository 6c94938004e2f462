# SPDX-License-Identifier: Apache-2.0
"""Visual hull as a signed distance: what the masks alone allow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor
from torch.nn.functional import grid_sample

from robir.capture.camera import Camera
from robir.capture.capture import Capture
from robir.errors import CaptureError
from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.rays import ReducedPhoto
from robir.maths.vectors import farthest_points

BEHIND = -1e3  # signed distance a view gives to points behind its camera: no evidence


HULL_VIEWS = 48  # most views the visual hull is carved with, and the ground is told by
# height above the table, unit frame, from which something belongs to the object, where masks were
# guessed
_CLEARANCE = 0.015


def mask_distance(coverage: NDArray[np.float32]) -> NDArray[np.float32]:
    """Signed distance (H, W) to a mask's outline, in pixels, negative inside.

    The outline runs where the coverage (H, W) in [0, 1] is one half; the coverage of the pixels
    next to it places it within the pixel.
    """
    inside = coverage >= 0.5
    if inside.all() or not inside.any():
        far = float(max(coverage.shape))
        return np.full(coverage.shape, -far if inside.all() else far, np.float32)
    distance = distance_transform_edt(~inside) - distance_transform_edt(inside)
    edge = np.abs(distance) <= 1.0
    distance = np.where(edge, 0.5 - coverage, distance - 0.5 * np.sign(distance))
    return distance.astype(np.float32)


class HullCarver:
    """Evaluates the visual hull's signed distance, of masks (H, W) float32 in [0, 1], unit frame.

    A point's value is the largest, over the views, of the signed distance of its image point to the
    mask's outline times depth over focal length: a lower bound of the distance outside, exact where
    one silhouette decides. With `outvoted` views that may be wrong, it is the largest but so many.
    """

    def __init__(
        self, cameras: list[Camera], coverages: list[NDArray[np.float32]], outvoted: int = 0
    ) -> None:
        self._cameras, self._outvoted = cameras, outvoted
        self._distances = [torch.from_numpy(mask_distance(c)) for c in coverages]

    def __call__(self, points: Tensor) -> Tensor:
        """Signed distance of the hull at points (P, 3), unit frame; shape (P,)."""
        largest = [torch.full((len(points),), BEHIND)] * (self._outvoted + 1)
        for own in self.by_view(points):
            for rank, value in enumerate(largest):  # in order, the largest first
                largest[rank], own = torch.maximum(value, own), torch.minimum(value, own)
        return largest[-1]

    def by_view(self, points: Tensor) -> Iterator[Tensor]:
        """What each view alone says of points (P, 3), shape (P,); very low behind a camera."""
        rows = points.T.contiguous()  # a product of three rows takes a fraction of one of columns
        for camera, distance in zip(self._cameras, self._distances, strict=True):
            rotation = torch.from_numpy(camera.camera_to_world[:3, :3]).float()
            local = rotation.T @ (rows - torch.from_numpy(camera.position).float()[:, None])
            depth = (-local[2]).clamp(min=1e-6)
            x = (camera.fx * local[0] / depth + camera.cx) * (2.0 / camera.width) - 1.0
            y = (-camera.fy * local[1] / depth + camera.cy) * (2.0 / camera.height) - 1.0
            # beyond the picture the value of its border goes on: free where nothing is cut off
            pixels = grid_sample(
                distance[None, None],
                torch.stack([x, y], dim=-1)[None, None],
                padding_mode="border",
                align_corners=False,
            )[0, 0, 0]
            scale = depth / (0.5 * (camera.fx + camera.fy))
            yield torch.where(local[2] < 0, pixels * scale, BEHIND)


def hull_of(photos: list[ReducedPhoto], dissent: float = 0.0) -> HullCarver:
    """The visual hull of photographs that lie far from each other.

    Where masks were guessed some may be wrong at any point: a share, one of them at least, may
    then call it background.
    """
    positions = np.stack([photo.camera.position for photo in photos])
    kept = [photos[k] for k in farthest_points(positions, HULL_VIEWS)]
    return HullCarver(
        [photo.camera for photo in kept],
        [photo.coverage for photo in kept],
        outvoted=max(1, round(dissent * len(kept))) if dissent else 0,
    )


def carve(carver: HullCarver, cells: int) -> Sampled:
    """Signed distance of the visual hull on a lattice of so many cells that fits it closely.

    `CaptureError` if the masks leave nothing inside the bounding sphere.
    """
    coarse = Lattice.around(np.full(3, -1.05), np.full(3, 1.05), 48, margin=0)
    nodes = coarse.nodes()
    # the bounding sphere ends what no photograph shows
    values = torch.maximum(carver(nodes), nodes.norm(dim=1) - 1.05)
    inside = nodes[values < coarse.cell]
    if len(inside) == 0:
        raise CaptureError(
            "The masks have no common volume: nothing inside the bounding sphere lies within every "
            "view's mask. Check that masks and camera poses belong together."
        )
    lattice = Lattice.around(inside.amin(0).numpy(), inside.amax(0).numpy(), cells)
    fine = resample(values, coarse, lattice)
    near = fine.abs() < 1.8 * coarse.cell
    points = lattice.nodes()[near]
    fine[near] = torch.maximum(carver(points), points.norm(dim=1) - 1.05)
    grid = fine.view(lattice.shape)
    for axis in range(3):  # the surface must not touch the border
        grid.select(axis, 0).clamp_(min=lattice.cell)
        grid.select(axis, -1).clamp_(min=lattice.cell)
    return Sampled(lattice, fine)


def object_hull(
    capture: Capture, photos: list[ReducedPhoto], cells: int, dissent: float = 0.0
) -> Sampled:
    """The visual hull that a surface begins with: above the table where masks were guessed.

    What a shadow falls on has other colours than the rest of the table, and depth maps see a
    surface there as well: nothing but its height tells it from the object. `dissent` is as for
    `hull_of`: a hull that some masks may not bound has notches.
    """
    carver = hull_of(photos, dissent)
    lattice, values = carve(carver, cells)
    if capture.has_guessed_masks and capture.table is not None:
        height = capture.table.height(lattice.nodes().double().numpy())
        values = torch.maximum(values, torch.from_numpy(_CLEARANCE - height).float())
    return Sampled(lattice, values)
