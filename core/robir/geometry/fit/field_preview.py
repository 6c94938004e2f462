# SPDX-License-Identifier: Apache-2.0
"""Shows a view that is kept aside while the field is fitted; never changes the fit."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from robir.capture.capture import Capture
from robir.capture.images.preview import save_preview
from robir.geometry.lattice import Sampled
from robir.geometry.rays import reduce_view
from robir.jobs.context import Reporter

Renderer = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Display RGB (R, 3) and coverage (R,) of rays given by origins and unit directions (R, 3)."""


class Present(NamedTuple):
    """The field as it is now, to look at and not to keep: the next step changes it in place.

    Attributes:
        render: Draws rays of it; takes nothing from any random generator.
        surface: Its signed distances.
    """

    render: Renderer
    surface: Sampled


RAYS = 1 << 13
"""Rays that are drawn at a time where there are many; memory limits them."""

SIDE = 96
"""Longer side of the rendering, pixels."""

PERIOD = 4.0
"""Least seconds between two pictures; one costs about 0.07 CPU-s."""


class Preview:
    """Renders one view every few seconds.

    The view is the first that is kept aside; the metric `held_out_psnr` is its PSNR over the
    object's pixels, dB. Without such a view the first training view is shown, without a metric.

    Args:
        capture: In the unit frame.
        path: Picture to replace.
        device: Torch device of the rays.
        reporter: Told the metric.
    """

    def __init__(self, capture: Capture, path: Path, device: str, reporter: Reporter) -> None:
        self._is_held_out = bool(capture.held_out)
        self._photo = reduce_view((capture.held_out or capture.train)[0], SIDE)
        camera = self._photo.camera
        origins, directions = camera.rays(camera.pixel_centres())
        self._rays = tuple(
            torch.tensor(array).float().to(device) for array in (origins, directions)
        )
        self._path = path
        self._reporter = reporter
        self._due = 0.0

    def show(self, render: Renderer) -> bool:
        """Render, write and score the view if it is time to; whether it was."""
        if time.monotonic() < self._due:
            return False
        with torch.no_grad():
            rgb, coverage = render(*self._rays)
        shape = self._photo.coverage.shape
        rgb = rgb.cpu().numpy().reshape(*shape, 3)
        alpha = coverage.clamp(0.0, 1.0).cpu().numpy().reshape(shape)
        wanted, inside = self._photo.premultiplied_display, self._photo.coverage
        straight = wanted / np.maximum(inside, 1e-3)[..., None]
        save_preview(self._path, _rgba(straight, inside), _rgba(rgb, alpha))
        whole = inside > 0.98
        if self._is_held_out and whole.any():
            squared = (rgb * alpha[..., None] - wanted)[whole] ** 2
            psnr = -10.0 * np.log10(max(float(squared.mean()), 1e-10))
            self._reporter.metric("held_out_psnr", round(float(psnr), 2))
        self._due = time.monotonic() + PERIOD
        return True


def _rgba(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(np.dstack([rgb, alpha]), 0.0, 1.0)).astype(np.uint8)
