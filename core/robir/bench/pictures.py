# SPDX-License-Identifier: Apache-2.0
"""A result beside the truth from one test view, for the pages of bench and stability sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.evaluation.layers import load_textures, stored_mesh, view_layers
from robir.evaluation.metrics import srgb_from_linear
from robir.evaluation.sheet import display_codes, layer_pictures
from robir.evaluation.truth import load_truth
from robir.jobs.paths import JobPaths, replacing

TILES = ("photograph", "true albedo", "albedo")
"""What `draw_result` puts side by side, left to right."""


def draw_result(paths: JobPaths, truth: Path, scale: list[float], picture: Path) -> None:
    """Write the tiles of one test view as one picture.

    Args:
        paths: Result folder.
        truth: Rendered capture it was made from.
        scale: Three factors that bring its albedo to the truth's.
        picture: PNG to write: square tiles, as wide as the truth's views.
    """
    known = load_truth(truth)
    view = known.views[0]
    ours = view_layers(stored_mesh(paths), load_textures(paths), [view.camera])[0]
    tiles = [
        display_codes(view.photo_display, view.hit),
        display_codes(srgb_from_linear(view.albedo), view.hit),
        layer_pictures(ours, np.array(scale))["albedo"],
    ]
    with replacing(picture) as temporary:
        Image.fromarray(np.concatenate(tiles, axis=1)).save(temporary, format="PNG")


def tile(picture: Path, name: str) -> NDArray[np.uint8]:
    """One of the tiles of a picture that `draw_result` wrote, (H, W, 3) codes."""
    with Image.open(picture, formats=["PNG"]) as image:
        codes: NDArray[Any] = np.asarray(image)
    width = codes.shape[1] // len(TILES)
    return codes[:, TILES.index(name) * width :][:, :width]
