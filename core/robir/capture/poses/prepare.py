# SPDX-License-Identifier: Apache-2.0
"""Upright grey copies of the photographs, small enough for features, and which lens took which."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from PIL import Image

from robir.capture.capture import Finding
from robir.capture.images.decode import exif_values, header, load, orientation, reduce, upright
from robir.capture.images.loading import size_within
from robir.capture.images.pixels import pixels_of
from robir.capture.poses.photos import Lens, lens_of
from robir.capture.refusal import CaptureRefusedError, error, note, warning
from robir.capture.views import Progress
from robir.jobs.paths import replacing

FEATURE_SIDE = 1000  # longer side of the copies in pixels
LARGE_MEGAPIXELS = 40.0  # from this size on the user is told that a photograph was made smaller
PANORAMA_ASPECT = 2.2  # no lens takes pictures wider than this; stitching does
MIN_PHOTOGRAPHS = 6  # fewer cannot be placed dependably, nor do they show an object
# the cure for too few photographs
MORE_PHOTOGRAPHS = (
    "Walk around the object and take 30 to 100, each with at least two thirds of what the one "
    "before shows."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A copy that features are looked for in.

    Attributes:
        relative: Path of the photograph below the capture's folder.
        copy: File name of its copy.
        width: Of the copy, pixels.
        height: Of the copy, pixels.
        lens: Number of its lens; photographs of one lens share intrinsics.
        focal: Focal length in pixels of the copy as EXIF states it, or None.
    """

    relative: str
    copy: str
    width: int
    height: int
    lens: int
    focal: float | None

    def plain(self) -> dict[str, object]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class _Copy:
    """What was noticed while a photograph was copied."""

    relative: str
    path: Path
    stored_size: tuple[int, int]
    size: tuple[int, int]
    lens: Lens | None
    digest: bytes


def prepare(
    root: Path, photographs: Sequence[Path], folder: Path, progress: Progress
) -> tuple[list[Prepared], list[Finding]]:
    """Copy photographs upright, grey and small.

    Args:
        root: Folder of the capture; photographs are named by their paths below it.
        photographs: Files.
        folder: Where the copies go.
        progress: Told after every photograph.

    Returns:
        One entry for each photograph that can be read and is no repetition; findings.

    Raises:
        CaptureError: If too few are left.
    """
    copies: list[_Copy] = []
    findings: list[Finding] = []
    broken: list[str] = []
    for done, path in enumerate(photographs):
        try:
            copies.append(_copy(root, path, folder / f"{done:05d}.png"))
        except CaptureRefusedError as refusal:
            if refusal.findings[0].code == "missing-reader":
                raise
            broken.append(path.relative_to(root).as_posix())
        progress((done + 1) / len(photographs), f"photograph {done + 1} of {len(photographs)}")
    if broken:
        findings.append(
            warning(
                "unreadable-images",
                f"{len(broken)} of {len(photographs)} photographs are damaged and are left out",
                "Copy them again from the camera.",
                *broken,
            )
        )
    distinct, repeated = _without_repetitions(copies)
    if len(distinct) == 1 < len(copies):
        raise CaptureRefusedError([*findings, _all_the_same(len(copies), distinct[0])])
    if repeated:
        message = f"{len(repeated)} photographs repeat another, pixel by pixel, and are left out"
        findings.append(note("repeated-images", message, *repeated))
    if len(distinct) < MIN_PHOTOGRAPHS:
        raise CaptureRefusedError([*findings, _too_few(root, len(distinct))])
    return _grouped(distinct), findings + _remarks(distinct)


def _copy(root: Path, path: Path, target: Path) -> _Copy:
    """Copy one photograph."""
    with header(path) as picture:
        exif = exif_values(picture)
        turn = orientation(picture)
        lens = None if exif is None else lens_of(exif, picture.size)
        stored_size = picture.size
        spare = max(stored_size) // (2 * FEATURE_SIDE)
        reduce(picture, max(factor for factor in (1, 2, 4, 8) if factor <= max(1, spare)))
        load(picture, path)
        pixels = pixels_of(upright(picture, turn))
    grey = Image.fromarray(pixels.image_display).convert("L")
    size = size_within(grey.size, FEATURE_SIDE)
    if size != grey.size:
        grey = grey.resize(size, Image.Resampling.LANCZOS, reducing_gap=3.0)
    with replacing(target) as temporary:
        grey.save(temporary, format="PNG", compress_level=1)
    digest = hashlib.sha256(grey.tobytes()).digest()
    return _Copy(path.relative_to(root).as_posix(), target, stored_size, size, lens, digest)


def _without_repetitions(copies: Sequence[_Copy]) -> tuple[list[_Copy], list[str]]:
    """The first of each set of equal pictures, and the names of the others."""
    seen: dict[bytes, _Copy] = {}
    repeated = []
    for copy in copies:
        if seen.setdefault(copy.digest, copy) is not copy:
            repeated.append(copy.relative)
    return list(seen.values()), repeated


def _grouped(copies: Sequence[_Copy]) -> list[Prepared]:
    """Number the lenses: same body, same focal length, same shape of picture."""
    numbers: dict[object, int] = {}
    result = []
    for copy in copies:
        lens = copy.lens or Lens()
        number = numbers.setdefault((lens.body, lens.setting, copy.size), len(numbers))
        result.append(
            Prepared(
                relative=copy.relative,
                copy=copy.path.name,
                width=copy.size[0],
                height=copy.size[1],
                lens=number,
                focal=None if lens.focal is None else lens.focal * max(copy.size),
            )
        )
    return result


def _remarks(copies: Sequence[_Copy]) -> list[Finding]:
    """Notes on sizes, lenses and EXIF data."""
    found = []
    large = [c for c in copies if c.stored_size[0] * c.stored_size[1] > 1e6 * LARGE_MEGAPIXELS]
    if large:
        biggest = max(c.stored_size[0] * c.stored_size[1] for c in large) / 1e6
        found.append(
            note(
                "downscaled",
                f"{len(large)} photographs have up to {biggest:.0f} megapixels; cameras are found "
                f"on copies of {FEATURE_SIDE} pixels",
                *(c.relative for c in large),
            )
        )
    wide = [c.relative for c in copies if max(c.size) > PANORAMA_ASPECT * min(c.size)]
    if wide:
        found.append(
            warning(
                "panorama",
                f"{len(wide)} photographs are much longer than high, as stitched panoramas are",
                "Leave them out: a stitched picture has no single camera.",
                *wide,
            )
        )
    damaged = [c.relative for c in copies if c.lens is None]
    if damaged:
        message = f"{len(damaged)} photographs have damaged EXIF data, which is ignored"
        found.append(note("bad-exif", message, *damaged))
    by_lens: dict[str, int] = defaultdict(int)
    for copy in _grouped(copies):
        by_lens[f"{copy.width}x{copy.height}, camera {copy.lens + 1}"] += 1
    if len(by_lens) > 1:
        groups = "; ".join(f"{count} of {name}" for name, count in by_lens.items())
        message = f"The photographs come from {len(by_lens)} cameras, lenses or formats ({groups})"
        found.append(note("several-cameras", f"{message}; each has its own intrinsics"))
    known = sum(c.lens is not None and c.lens.focal is not None for c in copies)
    start = f"of {known} of {len(copies)}" if known else "of none"
    found.append(note("focal-length", f"EXIF data give a start for the focal length {start}"))
    return found


def _all_the_same(count: int, copy: _Copy) -> Finding:
    return error(
        "same-photograph",
        f"All {count} photographs are the same one, so nothing tells how far away anything is",
        MORE_PHOTOGRAPHS,
        copy.relative,
    )


def _too_few(root: Path, count: int) -> Finding:
    return error(
        "too-few-photographs",
        f"{root} holds {count} different photographs without camera poses; at least "
        f"{MIN_PHOTOGRAPHS} are needed to find where they were taken",
        MORE_PHOTOGRAPHS,
    )
