# SPDX-License-Identifier: Apache-2.0
"""What a reader hands over: photographs that are named and posed but not yet read.

Lens distortion is the polynomial and rational model of Brown and Conrady as OpenCV, COLMAP and
nerfstudio write it. With (x, y) the undistorted image point at focal length one, y down, and
r2 = x^2 + y^2:

    q  = (1 + k1 r2 + k2 r2^2 + k3 r2^3 + k4 r2^4) / (1 + d1 r2 + d2 r2^2 + d3 r2^3)
    x' = q x + 2 p1 x y + p2 (r2 + 2 x^2) + s y'
    y' = q y + p1 (r2 + 2 y^2) + 2 p2 x y

A fisheye lens first replaces the radius by the angle, (x, y) by (x, y) atan(r) / r; with the
polynomial that is the model of Kannala and Brandt, which OpenCV and COLMAP call OPENCV_FISHEYE.

Other models of COLMAP (FOV, thin prism, division, EUCM) are evaluated by pycolmap.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.capture import PHOTOGRAPHS_ALONE, Bounds, Finding
from robir.capture.refusal import CaptureRefusedError, refuse
from robir.jobs.names import UnsafeNameError, checked_name, file_in

Array = NDArray[np.float64]

HEIF_SUFFIXES = (".heic", ".heif")  # photographs of phones, decoded by pillow-heif
# sensor data of cameras, developed by rawpy
RAW_SUFFIXES = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2")
LINEAR_SUFFIXES = (".exr",)  # pictures whose values are light itself
# kinds of photographs that are read
IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"),
    *HEIF_SUFFIXES,
    *RAW_SUFFIXES,
    *LINEAR_SUFFIXES,
)
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # from y down, along +z; its own inverse
MAX_NUMBER = 1e12  # matrix entries beyond this come from damaged files, not from cameras
MIN_FOCAL = 1e-3  # focal lengths below this, in pixels, come from damaged files too
MAX_ANGLE = 3.14  # widest field of view of a pinhole camera, radians


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """Brown-Conrady lens distortion; all zero means none."""

    # k1, k2, k3, k4 of the numerator
    radial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    rational: tuple[float, float, float] = (0.0, 0.0, 0.0)  # denominator (OpenCV's k4, k5, k6)
    tangential: tuple[float, float] = (0.0, 0.0)  # p1, p2
    skew: float = 0.0  # s, how far a step down moves along the row
    is_fisheye: bool = False  # whether the radius is the angle to the axis, not its tangent
    model: str = ""  # name of another model of COLMAP instead of all this, or nothing
    others: tuple[float, ...] = ()  # its parameters after focal length and principal point

    @property
    def parameters(self) -> tuple[float, ...]:
        """All numbers."""
        return (*self.radial, *self.rational, *self.tangential, self.skew, *self.others)

    @property
    def is_null(self) -> bool:
        """Whether the lens distorts nothing."""
        return not self.is_fisheye and not self.model and not any(self.parameters)

    def apply(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distorted image points of undistorted ones, both at focal length one, y down."""
        if self.model:
            return self._by_pycolmap(x, y)
        k1, k2, k3, k4 = self.radial
        d1, d2, d3 = self.rational
        p1, p2 = self.tangential
        if self.is_fisheye:
            radius = np.maximum(np.hypot(x, y), 1e-12)
            x, y = x * np.arctan(radius) / radius, y * np.arctan(radius) / radius
        r2 = x * x + y * y
        q = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        q = q / (1 + r2 * (d1 + r2 * (d2 + r2 * d3)))
        down = q * y + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return q * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + self.skew * down, down

    def _by_pycolmap(self, x: Array, y: Array) -> tuple[Array, Array]:
        import pycolmap

        params = [1.0, 1.0, 0.0, 0.0, *self.others]
        camera = pycolmap.Camera(model=self.model, width=1, height=1, params=params)
        points = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        found = np.asarray(camera.img_from_cam(points)).reshape(*x.shape, 2)
        return found[..., 0], found[..., 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Intrinsics as a format states them; what it leaves open follows from the image size."""

    width: int | None = None  # declared image width in pixels, or None
    height: int | None = None  # declared image height in pixels, or None
    fx: float | None = None  # along the row, pixels, or None if only `angle_x` is known
    fy: float | None = None  # focal length along the column in pixels, or None for square pixels
    cx: float | None = None  # principal point from the left edge in pixels, or None for the middle
    cy: float | None = None  # principal point from the top edge in pixels, or None for the middle
    angle_x: float | None = None  # horizontal field of view in radians, used where fx is None
    angle_y: float | None = None  # vertical field of view in radians, used where fx and fy are None
    distortion: Distortion = field(default_factory=Distortion)  # lens distortion
    is_scalable: bool = False  # whether photographs may be smaller or larger than declared

    @property
    def is_sane(self) -> bool:
        """Whether a camera may have these focal lengths and fields of view."""
        focals = [focal for focal in (self.fx, self.fy) if focal is not None]
        angles = [angle for angle in (self.angle_x, self.angle_y) if angle is not None]
        is_focal = all(MIN_FOCAL <= focal < MAX_NUMBER for focal in focals)
        return is_focal and all(1.0 / MAX_NUMBER < angle <= MAX_ANGLE for angle in angles)

    @property
    def size(self) -> tuple[int, int] | None:
        """Declared (width, height), or None if the format does not state it."""
        if self.width is None or self.height is None:
            return None
        return self.width, self.height

    def camera(self, pose: Array, width: int, height: int) -> Camera:
        """The pinhole camera of an image of this size, distortion aside."""
        if self.size is not None and self.size != (width, height):
            return self.camera(pose, *self.size).resized(width, height)
        fx, fy = self.fx, self.fy
        if fx is None:
            if self.angle_x is None:
                raise refuse("bad-intrinsics", "A camera has no focal length", "State it.")
            fx = 0.5 * width / np.tan(0.5 * self.angle_x)
            if fy is None and self.angle_y is not None:
                fy = 0.5 * height / np.tan(0.5 * self.angle_y)
        fx, fy = float(fx), float(fx if fy is None else fy)
        cx = 0.5 * width if self.cx is None else self.cx
        cy = 0.5 * height if self.cy is None else self.cy
        return Camera(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, camera_to_world=pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One photograph on disk with its pose."""

    name: str  # unique within the capture, fit for a file name
    image: Path  # the photograph
    relative: str  # the photograph's path as the format names it; masks are found by it
    mask: Path | None = None  # mask the format names itself, or None
    lens: Lens  # intrinsics as stated
    camera_to_world: Array  # 4x4, OpenGL axes, as stated; not yet checked
    split: Literal["train", "test"] = "train"  # "test" if the format holds it out
    is_upright: bool | None = None  # pose is for what EXIF turns; None where only sizes tell
    is_mask_upright: bool | None = None  # the same of the mask


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSet:
    """Everything a format says, before a pixel is read."""

    root: Path  # folder that holds the capture
    format: str  # name of the format, for example "colmap"
    frames: tuple[Frame, ...]  # posed photographs
    other_order: tuple[Frame, ...] = ()  # with their poses in the other plausible order
    sphere: Bounds | None = None  # where the format says the object is, or None
    # (N, 3) sparse surface points, capture frame; empty if the format has none
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    findings: tuple[Finding, ...] = ()  # what the reader noticed

    @property
    def has_frame_of_ours(self) -> bool:
        """Whether poses were found from the photographs, so that its frame means nothing."""
        return self.format == PHOTOGRAPHS_ALONE


def checked_lens(lens: Lens, path: Path, whose: str) -> Lens:
    """The lens, if its numbers are finite and sizes and focal lengths positive; or a refusal."""
    sizes = [value for value in (lens.width, lens.height) if value is not None]
    focals = [value for value in (lens.fx, lens.fy, lens.angle_x) if value is not None]
    middle = [value for value in (lens.cx, lens.cy) if value is not None]
    others, positive = (*middle, *lens.distortion.parameters), (*sizes, *focals)
    if not all(abs(v) < MAX_NUMBER for v in (*positive, *others)) or min(positive, default=1) <= 0:
        size = "x".join(f"{value:g}" for value in sizes) or "unknown size"
        message = f"{path}: {whose} has {size} pixels, a focal length of "
        message += f"{' and '.join(f'{value:g}' for value in focals)} and parameters {others}"
        cure = "Estimate the cameras again, or export them again."
        raise refuse("bad-intrinsics", message, cure, path.name)
    return lens


def pose_fault(pose: Array) -> str | None:
    """What is wrong with a camera-to-world matrix, in words, or None; a common scale is allowed."""
    if not np.isfinite(pose).all() or np.abs(pose).max() > MAX_NUMBER:
        return "holds NaN, infinite or absurdly large numbers"
    axes = pose[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    if lengths.min() < 1e-9 or abs(np.linalg.det(axes / lengths)) < 1e-3:
        return "is singular (its axes do not span space)"
    skew = (axes / lengths).T @ (axes / lengths) - np.eye(3)
    if lengths.max() > 1.01 * lengths.min() or np.abs(skew).max() > 1e-2:
        return "is no rotation (its axes are sheared or of unequal length)"
    if np.linalg.det(axes) < 0:
        return "mirrors space (its determinant is negative)"
    return None


def rigid(pose: Array) -> Array:
    """The nearest rigid transform of a pose without fault, shape (4, 4)."""
    u, _, vt = np.linalg.svd(pose[:3, :3])
    result = np.eye(4)
    result[:3, :3] = u @ vt
    result[:3, 3] = pose[:3, 3]
    return result


class PosedRefusedError(CaptureRefusedError):
    """The capture cannot be reconstructed, though its photographs are posed: its `frames`."""

    def __init__(self, findings: Iterable[Finding], frames: FrameSet) -> None:
        """Make the message from the errors among the findings."""
        super().__init__(findings)
        self.frames = frames


def posed_otherwise(camera: Camera, frame: Frame) -> Camera:
    """The camera of a photograph, cut and reduced as it is, with the pose another frame states."""
    size = (max(1, round(side)) for side in camera.whole_size)
    return frame.lens.camera(rigid(frame.camera_to_world), *size).cut_like(camera)


def unique_names(relatives: list[str]) -> list[str]:
    """Short names for photographs, fit for file names: paths without suffix and shared folders."""
    parts = [
        [p for p in r.replace("\\", "/").split("/") if p not in ("", ".", "..")] for r in relatives
    ]
    while parts and all(len(p) > 1 and p[0] == parts[0][0] for p in parts):
        parts = [p[1:] for p in parts]
    full = ["_".join(p) for p in parts]
    stems = [n.rsplit(".", 1)[0] if n.lower().endswith(IMAGE_SUFFIXES) else n for n in full]
    names = stems if len(set(stems)) == len(stems) else full
    for name, relative in zip(names, relatives, strict=True):
        _check_name(name, relative)
    if len(set(names)) < len(names):
        twice = sorted(relative for relative, n in Counter(relatives).items() if n > 1)
        message = f"{len(twice)} photographs are named more than once, with one pose each"
        raise refuse("duplicate-images", message, "Keep one entry a photograph.", *twice)
    return names


def _check_name(name: str, relative: str) -> None:
    """Refuse what no file can be called; views are stored under their names."""
    try:
        checked_name(relative)
        file_in(Path(), name)
    except UnsafeNameError as fault:
        message = f"A photograph cannot be named: {fault}"
        cure = "Give the photographs short names of letters and digits, in the file of poses too."
        raise refuse("bad-name", message, cure) from None
