# SPDX-License-Identifier: Apache-2.0
"""The finished field as the cameras of held-out photographs see it, for whoever judges the fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from robir.capture.capture import View
from robir.capture.images.loading import size_within
from robir.geometry.fit.field_preview import RAYS, Renderer
from robir.jobs.paths import replacing

_IMAGE_SIDE = 400  # longer side of the pictures, where photographs are larger (pixels)


def field_view(view: View, render: Renderer, device: str) -> NDArray[np.uint8]:
    """What a field shows within a view's mask.

    Args:
        view: In the unit frame.
        render: Draws rays of the field.
        device: Torch device of the rays.

    Returns:
        (H, W, 4) codes: display RGB and coverage, 0 outside the mask.
    """
    size = size_within((view.camera.width, view.camera.height), _IMAGE_SIDE)
    camera = view.camera.resized(*size)
    pixels = camera.pixel_centres()
    scale = np.array([view.camera.width, view.camera.height]) / (camera.width, camera.height)
    column, row = (pixels * scale).astype(int).T
    wanted = np.flatnonzero(view.mask[row, column])
    codes = np.zeros((camera.height * camera.width, 4), np.uint8)
    origins, directions = camera.rays(pixels[wanted])
    with torch.no_grad():
        for start in range(0, len(wanted), RAYS):
            part = slice(start, start + RAYS)
            rays = (torch.tensor(a[part]).float().to(device) for a in (origins, directions))
            rgb, coverage = render(*rays)
            shown = torch.cat([rgb, coverage[:, None]], dim=1).clamp(0.0, 1.0)
            codes[wanted[part]] = torch.round(255.0 * shown).byte().cpu().numpy()
    return codes.reshape(camera.height, camera.width, 4)


def save_field_views(file: Path, views: Sequence[View], render: Renderer, device: str) -> None:
    """Store what a field shows of some views as .npz, by the view's name.

    Args:
        file: File to replace.
        views: In the unit frame.
        render: Draws rays of the field.
        device: Torch device of the rays.
    """
    pictures = {view.name: field_view(view, render, device) for view in views}
    with replacing(file) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **pictures)
