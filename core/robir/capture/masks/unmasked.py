# SPDX-License-Identifier: Apache-2.0
"""Masks for a capture that brings none: guessed, written for the user to mend, accounted for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from robir.capture.camera import Camera
from robir.capture.capture import (
    BACKDROP_MASKS,
    GUESSED_MASKS,
    MESH_MASKS,
    Finding,
    Split,
    View,
)
from robir.capture.config import CaptureConfig
from robir.capture.frames import Array, Distortion, Frame, FrameSet, Lens, posed_otherwise
from robir.capture.images.loading import Bytes, Photo
from robir.capture.images.opencv import cv2
from robir.capture.masks import matching
from robir.capture.masks.given import HOW_TO_SUPPLY
from robir.capture.masks.guess import Guess, Layer, guess_masks, sampled, sharpened
from robir.capture.masks.region import find_region, focus, region_of_box
from robir.capture.mesh_file import read_mesh
from robir.capture.refusal import error, note, some
from robir.capture.views import Loaded, Progress, load_views, unheard
from robir.jobs.paths import replacing

RING = 2  # width of the strip along the edges of a photograph that shows the backdrop, pixels
FLAT = 2  # codes by which a backdrop varies at most; no wall varies so little unless clipped
RINGING = 16  # the same about an object in a JPEG file: its blocks of 8 pixels carry edges over
BARE = 0.9  # share of all edges that the backdrop covers at least; the object may run out of some
LEAST, MOST = 0.002, 0.9  # share of the photographs that an object covers, in the median
LEAST_HOLE = 4  # pixels of an enclosed patch that is looked at
RAYS, STEPS = 24, 96  # rays through each enclosed patch, and points looked at along each
CARVED = 2  # other photographs that must see the backdrop through a point for it to be empty
NEAR_RIM = 3.0  # pixels from a rim within which the object's own colour is read


def backdrop_masks(views: Sequence[View], *, is_lossy: bool) -> tuple[Layer, ...] | None:
    """Share (H, W) of pixels that the object covers before one backdrop of all, or None.

    What the object stands on is in front of the backdrop too and belongs to it, as it does where
    alpha says so. A patch of the backdrop's colour that the object encloses is a hole where nothing
    along its rays is of another colour in the other photographs, or else a part of the object.
    """
    edges = np.concatenate([_strip(view.image_display) for view in views]).astype(np.int16)
    colour = np.median(edges, axis=0).astype(np.int16)
    if (np.abs(edges - colour).max(axis=1) <= FLAT).mean() < BARE:
        return None
    limit = RINGING if is_lossy else FLAT
    alike = [np.abs(view.image_display - colour).max(axis=2) <= limit for view in views]
    # number of the connected piece of every pixel of the backdrop's colour, else 0
    parts = [cv2.connectedComponents(a.astype(np.uint8), connectivity=4)[1] for a in alike]
    outside = [near & np.isin(each, _strip(each)) for near, each in zip(alike, parts, strict=True)]
    shares = [1.0 - float(each.mean()) for each in outside]
    if not LEAST < np.median(shares) < MOST:
        return None
    enclosed = [near & ~each for near, each in zip(alike, outside, strict=True)]
    behind = _with_holes(outside, enclosed, parts, [view.camera for view in views])
    return tuple(
        _coverage(view.image_display - colour, each)
        for view, each in zip(views, behind, strict=True)
    )


def _strip(picture: NDArray) -> NDArray:
    """Values (N, ...) of a picture (H, W, ...) along its edges."""
    parts = (picture[:RING], picture[:, :RING], picture[-RING:], picture[:, -RING:])
    return np.concatenate([part.reshape(-1, *picture.shape[2:]) for part in parts])


def _with_holes(
    outside: list[NDArray[np.bool_]],
    enclosed: list[NDArray[np.bool_]],
    parts: list[NDArray[np.int32]],
    cameras: list[Camera],
) -> list[NDArray[np.bool_]]:
    """The backdrop of each photograph with those enclosed patches that are holes."""
    aim = focus(cameras)
    if aim is None:
        return outside
    rng = np.random.default_rng(0)
    behind = []
    for index, (own, patches) in enumerate(zip(outside, enclosed, strict=True)):
        whole = own.copy()
        for piece in np.flatnonzero(np.bincount(parts[index][patches]) >= LEAST_HOLE):
            inside = parts[index] == piece
            rows = np.argwhere(inside)
            rows = rows[rng.choice(len(rows), min(RAYS, len(rows)), replace=False)]
            points = _along(cameras[index], rows, aim[0])
            others = [k for k in range(len(cameras)) if k != index]
            if _is_empty(points, others, (outside, enclosed), cameras).mean() > 0.5:
                whole |= inside
        behind.append(whole)
    return behind


def _along(camera: Camera, rows: NDArray[np.int64], middle: Array) -> Array:
    """Points (N, STEPS, 3) on the rays through pixels (row, column) (N, 2), about the focus."""
    origins, directions = camera.rays(rows[:, ::-1] + 0.5)
    distance = float(np.linalg.norm(camera.position - middle))
    depth = distance * np.linspace(0.3, 1.7, STEPS)
    return origins[:, None] + depth[:, None] * directions[:, None]


def _is_empty(
    points: Array,
    others: list[int],
    behind: tuple[list[NDArray[np.bool_]], list[NDArray[np.bool_]]],
    cameras: list[Camera],
) -> NDArray[np.bool_]:
    """Whether nothing stands on rays (N, STEPS, 3), by what the other photographs show there."""
    flat = points.reshape(-1, 3)
    seen, beyond, through = (np.zeros(len(flat), int) for _ in range(3))
    for index in others:
        pixels, depth = cameras[index].project(flat)
        known = cameras[index].in_picture(pixels, depth)
        seen += known
        beyond += known & sampled(behind[0][index], pixels)
        through += known & sampled(behind[1][index], pixels)
    free = (beyond > 0) | (through >= CARVED) | (seen == 0)
    return free.reshape(points.shape[:2]).all(axis=1)


def _coverage(apart: NDArray[np.int16], behind: NDArray[np.bool_]) -> Layer:
    """Share (H, W) of pixels that the object covers; a rim mixes its colour and the backdrop's."""
    near = cv2.dilate(behind.astype(np.uint8), np.ones((3, 3), np.uint8)) == 1
    rim, within = near & ~behind, ~near
    covered = (~behind).astype(np.float32)
    if not within.any() or not rim.any():
        return covered
    distance, nearest = ndimage.distance_transform_edt(~within, return_indices=True)
    rows, columns = np.nonzero(rim & (distance < NEAR_RIM))
    mixed = apart[rows, columns].astype(np.float32)
    own = apart[nearest[0][rows, columns], nearest[1][rows, columns]].astype(np.float32)
    size = (own**2).sum(axis=1)
    share = (mixed * own).sum(axis=1) / np.maximum(size, 1.0)
    is_known = size > (4 * FLAT) ** 2
    covered[rows, columns] = np.where(is_known, np.clip(share, 0.0, 1.0), 1.0)
    return covered


_LEAST_PIXELS = 200  # of a small photograph that a mesh has to cover to be what it shows
LOSSLESS = (".png", ".tif", ".tiff", ".bmp")  # pictures without the ringing of lossy compression
_ENOUGH_POINTS = 200  # sparse points of a format that make a search for more needless

Chosen = Sequence[tuple[Frame, Split]]


def with_guessed_masks(
    frames: FrameSet,
    chosen: Chosen,
    loaded: Loaded,
    how: tuple[CaptureConfig, Path | None, Path | None],
    progress: Progress = unheard,
) -> tuple[Loaded, list[Finding]]:
    """Guess masks, by settings, into a folder and by a mesh, if any, and read photographs again."""
    config, folder, mesh = how
    progress(0.0, "looking for the object")

    def read_again(cuts: dict[str, GuessedMask]) -> Loaded:
        those = [pair for pair in chosen if pair[0].name in cuts]
        return load_views(
            those, cuts, config.max_side, lambda share, text: progress(0.6 + 0.4 * share, text)
        )

    is_lossy = any(frame.image.suffix.lower() not in LOSSLESS for frame, _ in chosen)
    if not config.box and (beliefs := backdrop_masks(loaded.views, is_lossy=is_lossy)):
        share = 100 * float(np.median([(belief > 0.5).mean() for belief in beliefs]))
        message = "The photographs have no masks, but one colour all around: whatever else they "
        message += f"show, {share:.0f} % of them, is the object and what it stands on; "
        about = note(BACKDROP_MASKS, message + _where_masks(folder))
        return read_again(_cuts(chosen, loaded.views, beliefs, folder)), [about]
    seen, guess, fault = _guess(frames, loaded.views, config, progress)
    if mesh is not None and frames.has_frame_of_ours:
        # it stands in a frame of its own, and masks are what brings the cameras there
        mesh, fault = None, f"{fault}; the mesh cannot say, for masks tell where it stands"
    if guess is None and mesh is not None:
        cuts = about_mesh(read_mesh(mesh).vertices, chosen, loaded.views)
        if 2 * len(cuts) > len(chosen):
            message = f"The photographs have no masks and none could be guessed ({fault}), so the "
            message += "mesh says where the object is; nothing says whether it stands where it "
            return read_again(cuts), [note(MESH_MASKS, message + "should")]
    if guess is None:
        message = "The photographs have no masks: nothing says which pixels are the object, and "
        cure = f"{HOW_TO_SUPPLY} Or say where the object is with the setting "
        cure += "capture.box=[x, y, z, width, depth, height]."
        return loaded, [error("no-masks", f"{message}they could not be guessed ({fault})", cure)]
    again = read_again(_cuts(chosen, seen, guess.masks, folder))
    return replace(again, table=guess.region.plane), _account(guess, loaded.views, folder)


def _cuts(
    chosen: Chosen, views: Sequence[View], beliefs: Sequence[Layer], folder: Path | None
) -> dict[str, GuessedMask]:
    """Masks by name, from the views that they were guessed from and the belief in each."""
    by_name = {frame.name: frame for frame, _ in chosen}
    cuts = {}
    for view, belief in zip(views, beliefs, strict=True):
        frame = by_name[view.name]
        cuts[view.name] = GuessedMask(
            lens=frame.lens,
            camera=view.camera.resized(belief.shape[1], belief.shape[0]),
            belief=belief,
            path=None if folder is None else _mask_path(folder, frame.relative),
        )
    return cuts


def about_mesh(vertices: Array, chosen: Chosen, views: Sequence[View]) -> dict[str, GuessedMask]:
    """Rough masks by name: the convex hull of what shows a mesh (N, 3) whole, in uncut views."""
    cuts = {}
    for (frame, _), view in zip(chosen, views, strict=True):
        pixels, depth = view.camera.project(vertices)
        if not view.camera.in_picture(pixels, depth).all():
            continue
        hull = cv2.convexHull(pixels.astype(np.float32)[:, None])
        layer = np.zeros(view.mask.shape, np.uint8)
        cv2.fillConvexPoly(layer, np.rint(hull).astype(np.int32), 1)
        if layer.sum() >= _LEAST_PIXELS:
            belief = layer.astype(np.float32)
            cuts[view.name] = GuessedMask(
                lens=frame.lens, camera=view.camera, belief=belief, is_rough=True
            )
    return cuts


@dataclass(frozen=True, slots=True, kw_only=True)
class GuessedMask:
    """A guess that is finished once its photograph is decoded."""

    lens: Lens  # lens of the photograph
    camera: Camera  # camera of the belief, undistorted
    belief: Layer  # (h, w) in [0, 1]
    is_rough: bool = False  # whether it is taken without a look at colours
    path: Path | None = None  # file the mask is written to, or None

    def __call__(self, photo: Photo | None, size: tuple[int, int]) -> Bytes:
        """The guess itself, or the mask of its photograph; written where it shall be."""
        belief = self._bent(size)
        if photo is None:
            return np.where(belief > 0.5, np.uint8(255), np.uint8(0))
        if self.is_rough:
            large = cv2.resize(belief, photo.size, interpolation=cv2.INTER_LINEAR)
            mask = np.where(large > 0.5, np.uint8(255), np.uint8(0))
        else:
            mask = sharpened(photo.image_display, belief)
        if self.path is not None:
            with replacing(self.path) as temporary:
                Image.fromarray(mask).save(temporary, format="PNG", compress_level=3)
        return mask

    def _bent(self, size: tuple[int, int]) -> Layer:
        if self.lens.distortion.is_null:
            return self.belief
        bent = self.lens.camera(self.camera.camera_to_world, *size)
        bent = bent.resized(self.camera.width, self.camera.height)
        where = _straight_pixels(bent, self.camera, self.lens.distortion)
        return cv2.remap(
            self.belief, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )


def _guess(
    frames: FrameSet, views: tuple[View, ...], config: CaptureConfig, progress: Progress
) -> tuple[tuple[View, ...], Guess | None, str]:
    """The views with the poses used, and their masks or why there are none."""
    points = frames.points
    if len(points) < _ENOUGH_POINTS:
        views, points = _with_points(frames, views)
    cameras = [view.camera for view in views]
    telling = "telling object from background"
    for share, stands in ((0.1, True), (0.35, False)):
        if config.box:
            region = region_of_box(config.box, cameras, points, stands=stands)
        else:
            region = find_region(cameras, points, stands=stands)
        if region is None:
            return views, None, "the cameras do not aim at a common point"
        guess = guess_masks(
            views, region, lambda done, at=share: progress(at + 0.25 * done, telling)
        )
        if not guess.is_own_table:  # on a plain table no points but the object's make a plane
            break
    fault = guess.fault()
    return views, (guess if fault is None else None), fault or ""


def _with_points(frames: FrameSet, views: tuple[View, ...]) -> tuple[tuple[View, ...], Array]:
    """Surface points; the views get the order of poses that yields more of them."""
    every = np.linspace(0, len(views) - 1, min(len(views), matching.MAX_VIEWS))
    features = matching.features([views[k] for k in np.unique(every.round().astype(int))])
    points = matching.surface_points(features)
    if not frames.other_order:
        return views, points
    others = {frame.name: frame for frame in frames.other_order}
    turned = {view.name: posed_otherwise(view.camera, others[view.name]) for view in views}
    moved = [
        replace(each, camera=turned[each.name].resized(each.camera.width, each.camera.height))
        for each in features
    ]
    other_points = matching.surface_points(moved)
    if len(other_points) <= len(points):
        return views, points
    return tuple(replace(view, camera=turned[view.name]) for view in views), other_points


def _where_masks(folder: Path | None) -> str:
    if folder is None:
        return "robir reconstruct writes them into the folder masks of the result, to be looked at"
    return f"they lie in {folder}: look at them, mend a copy, and give that with --masks DIR"


def _account(guess: Guess, views: Sequence[View], folder: Path | None) -> list[Finding]:
    agreement, contrast = (100 * float(np.median(x)) for x in (guess.agreement, guess.contrast))
    message = f"The photographs have no masks, so masks were guessed from {guess.region.origin}: "
    message += f"they agree with each other to {agreement:.0f} %, colour alone decides "
    message += f"{contrast:.0f} % of the pixels along the outlines; {_where_masks(folder)}"
    found = [note(GUESSED_MASKS, message)]
    odd = [view.name for view, is_odd in zip(views, guess.odd, strict=True) if is_odd]
    message = f"{len(odd)} of {len(views)} guessed masks disagree with the others"
    cure = "Look at these masks first, and mend them or leave these photographs out."
    found += some("warning", "odd-guesses", odd, message, cure)
    has_table, none = guess.region.plane is not None, "No table was found under the object"
    return [*found, note("ground", "The table under the object is cut away" if has_table else none)]


def _straight_pixels(camera: Camera, straight: Camera, distortion: Distortion) -> Layer:
    """Array indices (H, W, 2) in the undistorted picture of each pixel of the photograph."""
    bent = (camera.pixel_centres() - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    at = bent
    for _ in range(30):  # x = x' - (distortion of x), which contracts for every usable lens
        step = bent - np.stack(distortion.apply(*at.T), axis=1)
        at = at + step
        if np.abs(step).max() < 1e-6:
            break
    where = at * [straight.fx, straight.fy] + [straight.cx - 0.5, straight.cy - 0.5]
    return where.reshape(camera.height, camera.width, 2).astype(np.float32)


def _mask_path(folder: Path, relative: str) -> Path:
    """File of a mask, so named that `--masks` finds its photograph."""
    parts = PurePosixPath(relative.replace("\\", "/")).parts
    own = [part for part in parts if part not in ("..", ".", "/") and ":" not in part]
    return folder.joinpath(*own).with_suffix(".png")
