# SPDX-License-Identifier: Apache-2.0
"""A result in pictures, for the pages of bench and stability sweep.

Beside the truth from one test view where there is a truth, else beside one held-out photograph.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.camera import Camera
from robir.capture.capture import Capture, View
from robir.capture.store import load_settled
from robir.evaluation.layers import load_textures, stored_mesh, view_layers
from robir.evaluation.metrics import srgb_from_linear
from robir.evaluation.photos import (
    MAX_SIDE,
    cut,
    display_codes,
    layer_pictures,
    over_grey,
    read_picture,
    window,
)
from robir.evaluation.surfaces import MeshCaster
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, replacing
from robir_bench.truth.aligned import truth_of

# what `draw_result` puts side by side, left to right
TILES = ("photograph", "true albedo", "albedo")

# the same of `draw_photographed`
PHOTOGRAPHED_TILES = ("photograph", "re-render", "albedo", "clay", "relit")

Picture = NDArray[np.uint8]

# towards the lamp that clay is shown under: right, up and back, in the camera's axes
_CLAY_LIGHT = np.array([-0.35, 0.45, 0.82])


def draw_result(paths: JobPaths, truth: Path, scale: list[float], picture: Path) -> None:
    """Write the tiles of one test view as one picture.

    Args:
        paths: Result folder.
        truth: Rendered capture it was made from.
        scale: Three factors that bring its albedo to the truth's.
        picture: PNG to write: square tiles, as wide as the truth's views.
    """
    known, _ = truth_of(truth, paths)
    view = known.views[0]
    ours = view_layers(stored_mesh(paths), load_textures(paths), [view.camera])[0]
    tiles = [
        display_codes(view.photo_display, view.hit),
        display_codes(srgb_from_linear(view.albedo), view.hit),
        layer_pictures(ours, np.array(scale))["albedo"],
    ]
    _save(tiles, picture)


def draw_photographed(paths: JobPaths, picture: Path) -> None:
    """Write the tiles of one held-out view as one picture; grey where nothing was made.

    Args:
        paths: Result folder.
        picture: PNG to write: square tiles, cut to the object.
    """
    capture = load_settled(paths)
    view = _shown_view(paths, capture)
    camera = view.camera.resized(2 * view.camera.width, 2 * view.camera.height)
    layers = view_layers(stored_mesh(paths), load_textures(paths), [camera], sub_pixels=1)[0]
    albedo = layer_pictures(layers)["albedo"]
    rerender, relit = paths.rerender(view.name), _relit(paths, view)
    nothing = np.zeros((*view.mask.shape, 4), np.uint8)
    pictures = (
        np.dstack([view.image_display, view.mask]),
        read_picture(rerender) if rerender.is_file() else _own_rerender(paths, view, nothing),
        np.dstack([albedo, np.where(layers.hit, 255, 0).astype(np.uint8)]),
        clay(Mesh.load(paths.stage("geometry") / "mesh.npz"), _in_unit_frame(camera, capture)),
        nothing if relit is None else read_picture(relit),
    )
    frame = window(view.mask)
    side = (MAX_SIDE, MAX_SIDE)
    tiles = [over_grey(cut(tile, frame)) for tile in pictures]
    resized = [Image.fromarray(tile).resize(side, Image.Resampling.LANCZOS) for tile in tiles]
    _save([np.asarray(tile) for tile in resized], picture)


def clay(mesh: Mesh, camera: Camera) -> Picture:
    """A surface as matt grey clay under one lamp beside the camera, without shadows.

    Args:
        mesh: In the camera's frame.
        camera: Who looks.

    Returns:
        (H, W, 4) codes; alpha where the surface is met.
    """
    seen = MeshCaster(mesh).cast(camera)
    lamp = camera.camera_to_world[:3, :3] @ (_CLAY_LIGHT / np.linalg.norm(_CLAY_LIGHT))
    lit = np.clip(seen.normal @ lamp, 0.0, 1.0)[..., None]
    grey = srgb_from_linear(np.repeat(0.03 + 0.6 * lit, 3, axis=-1))
    return np.dstack([display_codes(grey), np.where(seen.hit, 255, 0).astype(np.uint8)])


def _in_unit_frame(camera: Camera, capture: Capture) -> Camera:
    return camera.normalised(capture.bounds.centre, capture.bounds.radius)


def _shown_view(paths: JobPaths, capture: Capture) -> View:
    """A held-out view that was relit, else one that was rendered, else any."""
    views = capture.held_out or capture.train
    relit = [view for view in views if _relit(paths, view) is not None]
    rendered = [view for view in views if paths.rerender(view.name).is_file()]
    return (relit or rendered or list(views))[0]


def _relit(paths: JobPaths, view: View) -> Path | None:
    """A picture of a view under another light, if there is one."""
    found = sorted(paths.renders.glob(f"relit_*_{view.name}.png"))
    return found[0] if found else None


def _own_rerender(paths: JobPaths, view: View, nothing: Picture) -> Picture:
    """Our own renderer's picture of a view, where the method left one."""
    again = stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)
    return again.get(view.name, nothing)


def _save(tiles: Sequence[Picture], picture: Path) -> None:
    with replacing(picture) as temporary:
        Image.fromarray(np.concatenate(tiles, axis=1)).save(temporary, format="PNG")


def tile(picture: Path, name: str, names: Sequence[str] = TILES) -> NDArray[np.uint8]:
    """One of the tiles of a picture by its name, (H, W, 3) codes; `names` are those of all."""
    with Image.open(picture, formats=["PNG"]) as image:
        codes: NDArray[Any] = np.asarray(image)
    width = codes.shape[1] // len(names)
    return codes[:, names.index(name) * width :][:, :width]
