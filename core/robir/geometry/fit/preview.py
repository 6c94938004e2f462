# SPDX-License-Identifier: Apache-2.0
"""Pictures and a coarse mesh of the field, while it is fitted and at the end; never change the fit.

The growing mesh is what the add-on shows in the viewport while a run works.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, View
from robir.capture.images.loading import save_preview, size_within
from robir.errors import QualityError
from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.simplify import thinned
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import reduce_view
from robir.jobs.context import Reporter
from robir.jobs.paths import replacing

# display RGB (R, 3) and coverage (R,) of rays given by origins and unit directions (R, 3)
Renderer = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]

RAYS = 1 << 13  # rays that are drawn at a time where there are many; memory limits them

PERIOD = 4.0  # least seconds between two previews; one costs about 0.07 CPU-s

# most triangles of the growing mesh; more would show no more while the surface still moves
MAX_FACES = 5000

_SIDE = 96  # longer side of the preview (pixels)
_CELLS = 40  # along the growing mesh; of a ball that makes twice `MAX_FACES`
_MARGIN = 3  # cells of the fit's lattices beyond the object's box on every side
_HELD_OUT_SIDE = 400  # longer side of the held-out pictures, where photographs are larger (pixels)


class Present(NamedTuple):
    """The field as it is now, to look at and not to keep: the next step changes it in place."""

    render: Renderer  # draws rays of it; takes nothing from any random generator
    surface: Sampled  # its signed distances


class Preview:
    """Renders one view every few seconds.

    The view is the first held-out one; the metric `held_out_psnr` is its PSNR over the object's
    pixels, dB. Without such a view the first training view is shown, without a metric.
    """

    def __init__(self, capture: Capture, path: Path, device: str, reporter: Reporter) -> None:
        self._is_held_out = bool(capture.held_out)
        self._photo = reduce_view((capture.held_out or capture.train)[0], _SIDE)
        self._path, self._device, self._reporter = path, device, reporter
        self._due = 0.0

    def show(self, render: Renderer) -> bool:
        """Render, write and score the view if it is time to; whether it was."""
        if time.monotonic() < self._due:
            return False
        camera, inside = self._photo.camera, self._photo.coverage
        shown = _drawn(camera, camera.pixel_centres(), render, self._device)
        shown = shown.reshape(*inside.shape, 4)
        wanted = self._photo.premultiplied_display
        straight = np.dstack([wanted / np.maximum(inside, 1e-3)[..., None], inside])
        save_preview(self._path, _codes(straight), _codes(shown))
        whole = inside > 0.98
        if self._is_held_out and whole.any():
            squared = (shown[..., :3] * shown[..., 3:] - wanted)[whole] ** 2
            psnr = -10.0 * np.log10(max(float(squared.mean()), 1e-10))
            self._reporter.metric("held_out_psnr", round(float(psnr), 2))
        self._due = time.monotonic() + PERIOD
        return True


def save_growing(path: Path, surface: Sampled, bounds: Bounds) -> None:
    """Write the zero level as .npz, atomically; a field without one leaves the file as it is.

    The arrays are stored as they are: `vertices` (V, 3) float32 in the capture's frame and unit,
    whose unit sphere is `bounds`, and `faces` (F, 3) int32, at most `MAX_FACES` of them.
    """
    mesh = coarse(surface)
    if mesh is None:
        return
    vertices = bounds.radius * mesh.vertices.astype(np.float64) + bounds.centre
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, vertices=vertices.astype(np.float32), faces=mesh.faces)


def coarse(surface: Sampled) -> Mesh | None:
    """The zero level of a field by few triangles, unit frame; None where there is none yet."""
    lattice, values = surface
    inset = _MARGIN * lattice.cell
    few = Lattice.around(np.asarray(lattice.lower) + inset, lattice.upper - inset, _CELLS)
    sampled = resample(values.detach(), lattice, few)
    if not bool(sampled.isfinite().all()):  # the fit itself will say so
        return None
    try:
        mesh = thinned(extract(few, sampled), MAX_FACES)
    except QualityError:
        return None
    return mesh if 0 < len(mesh.faces) <= MAX_FACES else None


def field_view(view: View, render: Renderer, device: str) -> NDArray[np.uint8]:
    """Codes (H, W, 4) of what a field shows within a view's mask: display RGB and coverage."""
    size = size_within((view.camera.width, view.camera.height), _HELD_OUT_SIDE)
    camera = view.camera.resized(*size)
    pixels = camera.pixel_centres()
    scale = np.array([view.camera.width, view.camera.height]) / (camera.width, camera.height)
    column, row = (pixels * scale).astype(int).T
    wanted = np.flatnonzero(view.mask[row, column])
    codes = np.zeros((camera.height * camera.width, 4), np.uint8)
    codes[wanted] = _codes(_drawn(camera, pixels[wanted], render, device))
    return codes.reshape(camera.height, camera.width, 4)


def save_field_views(file: Path, views: Sequence[View], render: Renderer, device: str) -> None:
    """Store what a field shows of some views as .npz, by the view's name."""
    pictures = {view.name: field_view(view, render, device) for view in views}
    with replacing(file) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **pictures)


def _drawn(
    camera: Camera, pixels: NDArray[np.float64], render: Renderer, device: str
) -> NDArray[np.float32]:
    """Display RGB and coverage (P, 4) of a field at a camera's pixels (P, 2), in [0, 1]."""
    rays = (torch.tensor(part).float().to(device).split(RAYS) for part in camera.rays(pixels))
    shown = [np.zeros((0, 4), np.float32)]
    with torch.no_grad():
        for origins, directions in zip(*rays, strict=True):
            rgb, coverage = render(origins, directions)
            both = torch.cat([rgb, coverage[:, None]], dim=1)
            shown.append(both.clamp(0.0, 1.0).cpu().numpy())
    return np.concatenate(shown)


def _codes(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """8-bit codes of values in [0, 1]."""
    return np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
