# SPDX-License-Identifier: Apache-2.0
"""Masks for a capture that brings none: guessed, written for the user to mend, accounted for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.capture import (
    BACKDROP_MASKS,
    GUESSED_MASKS,
    KEPT_GROUND,
    MESH_MASKS,
    PHOTOGRAPHS_ALONE,
    Finding,
    Split,
    View,
)
from robir.capture.config import CaptureConfig
from robir.capture.frames import Array, Distortion, Frame, FrameSet, Lens, posed_otherwise
from robir.capture.images.loading import Bytes, Photo
from robir.capture.images.opencv import cv2
from robir.capture.masks import matching
from robir.capture.masks.backdrop import backdrop_masks
from robir.capture.masks.finish import sharpened
from robir.capture.masks.given import HOW_TO_SUPPLY
from robir.capture.masks.guess import Guess, guess_masks
from robir.capture.masks.region import find_region, region_of_box
from robir.capture.masks.sight import Layer
from robir.capture.masks.table_disc import disc_about, disc_picture
from robir.capture.mesh_file import read_mesh
from robir.capture.refusal import error, note, warning
from robir.capture.views import Loaded, Progress, load_views, unheard
from robir.jobs.paths import replacing

_LEAST_PIXELS = 200  # pixels of a small photograph that a mesh has to cover to be what it shows
# suffixes of pictures without the ringing of lossy compression
LOSSLESS = (".png", ".tif", ".tiff", ".bmp")
_ENOUGH_POINTS = 200  # sparse points of a format that make a search for more needless


def with_guessed_masks(
    frames: FrameSet,
    chosen: Sequence[tuple[Frame, Split]],
    loaded: Loaded,
    how: tuple[CaptureConfig, Path | None, Path | None],
    progress: Progress = unheard,
) -> tuple[Loaded, list[Finding]]:
    """Guess the masks of photographs that have none, and read the photographs again with them.

    Args:
        frames: What the format says.
        chosen: Frames that were read, with their split.
        loaded: The photographs read from them, none with a mask.
        how: Settings of the stage, the folder where the masks are written, or None to keep no
            files, and the mesh that the user hands in, or None.
        progress: Told the share of this work.

    Returns:
        Photographs with masks, and findings; an error among them where no masks could be made,
        and the photographs are then as they came.
    """
    config, folder, mesh = how
    progress(0.0, "looking for the object")
    is_lossy = any(frame.image.suffix.lower() not in LOSSLESS for frame, _ in chosen)
    if not config.box and (beliefs := backdrop_masks(loaded.views, is_lossy=is_lossy)):
        again = _read_again(chosen, (loaded.views, beliefs, None), (config, folder), progress)
        return again, [_about_backdrop(beliefs, folder)]
    seen, guess, fault = _guess(frames, loaded.views, config, progress)
    if mesh is not None and frames.format == PHOTOGRAPHS_ALONE:
        # it stands in a frame of its own, and masks are what brings the cameras there
        mesh, fault = None, f"{fault}; the mesh cannot say, for masks tell where it stands"
    if guess is None and mesh is not None:
        cuts = about_mesh(read_mesh(mesh).vertices, chosen, loaded.views)
        if 2 * len(cuts) > len(chosen):
            again = load_views(
                [pair for pair in chosen if pair[0].name in cuts],
                cuts,
                config.max_side,
                lambda share, text: progress(0.6 + 0.4 * share, text),
            )
            return again, [
                note(
                    MESH_MASKS,
                    f"The photographs have no masks and none could be guessed ({fault}), so the "
                    "mesh says where the object is; nothing says whether it stands where it should",
                )
            ]
    if guess is None:
        return loaded, [
            error(
                "no-masks",
                "The photographs have no masks: nothing says which pixels are the object, and "
                f"they could not be guessed ({fault})",
                f"{HOW_TO_SUPPLY} Or say where the object is with the setting "
                "capture.box=[x, y, z, width, depth, height].",
            )
        ]
    rim = None
    plane = guess.region.plane
    if config.ground == "keep" and plane is not None:
        rim = disc_about(guess.volume, plane)
    again = _read_again(chosen, (seen, guess.masks, rim), (config, folder), progress)
    account = _account(guess, loaded.views, config, folder)
    return replace(again, table=plane), account


def _read_again(
    chosen: Sequence[tuple[Frame, Split]],
    guessed: tuple[Sequence[View], Sequence[Layer], Array | None],
    how: tuple[CaptureConfig, Path | None],
    progress: Progress,
) -> Loaded:
    """The photographs with the masks guessed for them.

    Args:
        chosen: Frames with their split.
        guessed: The views that masks were guessed from, belief in the object in each, and the rim
            of the ground that is kept, or None.
        how: Settings of the stage, and the folder where masks are written, or None.
        progress: Told the share of the work done.
    """
    views, beliefs, rim = guessed
    config, folder = how
    by_name = {frame.name: frame for frame, _ in chosen}
    cuts: dict[str, GuessedMask] = {}
    for view, belief in zip(views, beliefs, strict=True):
        frame = by_name[view.name]
        small = view.camera.resized(belief.shape[1], belief.shape[0])
        cuts[view.name] = GuessedMask(
            lens=frame.lens,
            camera=small,
            belief=belief,
            disc=None if rim is None else disc_picture(rim, small),
            path=None if folder is None else _mask_path(folder, frame.relative),
        )
    return load_views(
        chosen, cuts, config.max_side, lambda share, text: progress(0.6 + 0.4 * share, text)
    )


def about_mesh(
    vertices: Array, chosen: Sequence[tuple[Frame, Split]], views: Sequence[View]
) -> dict[str, GuessedMask]:
    """Rough masks by name: the convex hull of what shows a mesh, in photographs that show it whole.

    Args:
        vertices: (N, 3) of the mesh, capture frame.
        chosen: Frames with their split.
        views: The photographs, uncut.
    """
    cuts = {}
    for (frame, _), view in zip(chosen, views, strict=True):
        pixels, depth = view.camera.project(vertices)
        if not view.camera.in_picture(pixels, depth).all():
            continue
        hull = cv2.convexHull(pixels.astype(np.float32)[:, None])
        layer = np.zeros(view.mask.shape, np.uint8)
        cv2.fillConvexPoly(layer, np.rint(hull).astype(np.int32), 1)
        if layer.sum() < _LEAST_PIXELS:
            continue
        cuts[view.name] = GuessedMask(
            lens=frame.lens,
            camera=view.camera,
            belief=np.zeros(layer.shape, np.float32),
            disc=layer.astype(np.float32),
            path=None,
        )
    return cuts


@dataclass(frozen=True, slots=True, kw_only=True)
class GuessedMask:
    """A guess that is finished once its photograph is decoded.

    Attributes:
        lens: Lens of the photograph.
        camera: Camera of the layers, undistorted.
        belief: (h, w) in [0, 1].
        disc: (h, w), ground that is kept, or what is taken without a look at colours; or None.
        path: File the mask is written to, or None.
    """

    lens: Lens
    camera: Camera
    belief: Layer
    disc: Layer | None
    path: Path | None

    def outline(self, size: tuple[int, int]) -> Bytes:
        """The guess itself, as photographed."""
        belief, disc = self._bent(size)
        whole = belief if disc is None else np.maximum(belief, disc)
        return np.where(whole > 0.5, np.uint8(255), np.uint8(0))

    def of(self, photo: Photo, size: tuple[int, int]) -> Bytes:
        """The mask at the size the photograph was decoded to; written where it shall be."""
        belief, disc = self._bent(size)
        mask = sharpened(photo.image_display, belief)
        if disc is not None:
            ground = cv2.resize(disc, photo.size, interpolation=cv2.INTER_LINEAR) > 0.5
            mask = np.where(ground, np.uint8(255), mask)
        if self.path is not None:
            _write(self.path, mask)
        return mask

    def _bent(self, size: tuple[int, int]) -> tuple[Layer, Layer | None]:
        """The layers with the distortion of the photograph."""
        if self.lens.distortion.is_null:
            return self.belief, self.disc
        pinhole = self.lens.camera(self.camera.camera_to_world, *size)
        pinhole = pinhole.resized(self.camera.width, self.camera.height)
        x, y = _straight_pixels(pinhole, self.camera, self.lens.distortion)

        def bent(layer: Layer) -> Layer:
            return cv2.remap(
                layer, x, y, interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )

        return bent(self.belief), None if self.disc is None else bent(self.disc)


def _guess(
    frames: FrameSet, views: tuple[View, ...], config: CaptureConfig, progress: Progress
) -> tuple[tuple[View, ...], Guess | None, str]:
    """The views with the poses used, and their masks or why there are none."""
    points = frames.points
    if len(points) < _ENOUGH_POINTS:
        views, points = _triangulated(frames, views)
    cameras = [view.camera for view in views]
    if config.box:
        region = region_of_box(config.box, cameras, points)
    else:
        region = find_region(cameras, points)
    if region is None:
        return views, None, "the cameras do not aim at a common point"
    guess = guess_masks(
        views, region, lambda share: progress(0.1 + 0.5 * share, "telling object from background")
    )
    fault = guess.fault()
    return views, (guess if fault is None else None), fault or ""


def _triangulated(frames: FrameSet, views: tuple[View, ...]) -> tuple[tuple[View, ...], Array]:
    """Surface points; the views get the order of poses that yields more of them."""
    every = np.linspace(0, len(views) - 1, min(len(views), matching.MAX_VIEWS))
    features = matching.features([views[k] for k in np.unique(every.round().astype(int))])
    points = matching.triangulated(features)
    if not frames.other_order:
        return views, points
    others = {frame.name: frame for frame in frames.other_order}

    turned = {view.name: posed_otherwise(view.camera, others[view.name]) for view in views}
    moved = [
        replace(each, camera=turned[each.name].resized(each.camera.width, each.camera.height))
        for each in features
    ]
    other_points = matching.triangulated(moved)
    if len(other_points) <= len(points):
        return views, points
    views = tuple(replace(view, camera=turned[view.name]) for view in views)
    return views, other_points


def _about_backdrop(beliefs: Sequence[Layer], folder: Path | None) -> Finding:
    """What the user is told about masks by the backdrop's colour."""
    share = 100 * float(np.median([(belief > 0.5).mean() for belief in beliefs]))
    return note(
        BACKDROP_MASKS,
        "The photographs have no masks, but one colour all around: whatever else they show, "
        f"{share:.0f} % of them, is the object and what it stands on; {_where_masks(folder)}",
    )


def _where_masks(folder: Path | None) -> str:
    """Where guessed masks can be looked at."""
    if folder is None:
        return "robir reconstruct writes them into the folder masks of the result, to be looked at"
    return f"they lie in {folder}: look at them, mend a copy, and give that with --masks DIR"


def _account(
    guess: Guess, views: Sequence[View], config: CaptureConfig, folder: Path | None
) -> list[Finding]:
    """What the user is told about guessed masks."""
    agreement = 100 * float(np.median(guess.agreement))
    contrast = 100 * float(np.median(guess.contrast))
    found = [
        note(
            GUESSED_MASKS,
            "The photographs have no masks, so masks were guessed from "
            f"{guess.region.origin}: they agree with each other to {agreement:.0f} %, colour "
            f"alone decides {contrast:.0f} % of the pixels along the outlines; "
            f"{_where_masks(folder)}",
        )
    ]
    odd = [view.name for view, is_odd in zip(views, guess.odd, strict=True) if is_odd]
    if odd:
        found.append(
            warning(
                "odd-guesses",
                f"{len(odd)} of {len(views)} guessed masks disagree with the others",
                "Look at these masks first, and mend them or leave these photographs out.",
                *odd,
            )
        )
    code = "ground"
    if guess.region.plane is None:
        ground = "No table was found under the object"
    elif config.ground == "keep":
        code = KEPT_GROUND
        ground = "A disc of the table is kept with the object (capture.ground)"
    else:
        ground = "The table under the object is cut away (capture.ground)"
    return [*found, note(code, ground)]


def _straight_pixels(
    camera: Camera, straight: Camera, distortion: Distortion
) -> tuple[Layer, Layer]:
    """Array indices in the undistorted picture of each pixel of the photograph, (H, W) each."""
    centres = camera.pixel_centres()
    bent_x = (centres[:, 0] - camera.cx) / camera.fx
    bent_y = (centres[:, 1] - camera.cy) / camera.fy
    x, y = bent_x, bent_y
    for _ in range(30):  # x = x' - (distortion of x), which contracts for every usable lens
        there_x, there_y = distortion.apply(x, y)
        step_x, step_y = bent_x - there_x, bent_y - there_y
        x, y = x + step_x, y + step_y
        if max(np.abs(step_x).max(), np.abs(step_y).max()) < 1e-6:
            break
    shape = (camera.height, camera.width)
    columns = (x * straight.fx + straight.cx - 0.5).reshape(shape)
    rows = (y * straight.fy + straight.cy - 0.5).reshape(shape)
    return columns.astype(np.float32), rows.astype(np.float32)


def _mask_path(folder: Path, relative: str) -> Path:
    """File of a mask, so named that `--masks` finds its photograph."""
    parts = PurePosixPath(relative.replace("\\", "/")).parts
    kept = [part for part in parts if part not in ("..", ".", "/") and ":" not in part]
    return folder.joinpath(*kept).with_suffix(".png")


def _write(path: Path, mask: Bytes) -> None:
    with replacing(path) as temporary:
        Image.fromarray(mask).save(temporary, format="PNG", compress_level=3)
