# SPDX-License-Identifier: Apache-2.0
"""Which format a capture has, recognised by its files' content; the one door to every reader.

Of a capture that is refused for want of masks the cameras can be shown all the same: the user may
place a box about the object, and for that must see them.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robir.capture.camera import Camera
from robir.capture.capture import Capture, Finding, Split
from robir.capture.checks.coverage import check_coverage, check_sharpness
from robir.capture.checks.findings import (
    check_count,
    check_frames,
    check_masks,
    check_photographs,
    check_place,
    place_object,
)
from robir.capture.checks.photographs import check_brightness, check_settings, prepared
from robir.capture.config import CaptureConfig
from robir.capture.formats import KNOWN, reader_of, unread_poses
from robir.capture.frames import Frame, FrameSet, PosedRefusedError, rigid
from robir.capture.images.decode import may_hold_alpha, opened, orientation, upright
from robir.capture.masks import given as mask_files
from robir.capture.masks.region import focus
from robir.capture.poses import sfm
from robir.capture.poses.register import register
from robir.capture.poses.sources import find_photographs, is_video, take_frames
from robir.capture.readers import phones
from robir.capture.readers.files import children
from robir.capture.readers.transforms import SYNTHETIC
from robir.capture.refusal import CaptureRefusedError, note, refuse, some
from robir.capture.store import plain_camera
from robir.capture.views import Loaded, Progress, load_views, splits, unheard, without_left_out
from robir.jobs.names import UnsafeNameError, checked_name, leads_out

_READING = 0.8  # share of the progress that reading the photographs takes
_FIRST_READING = 0.3  # the same where masks have to be guessed as well
SURVEY_SIDE = 800  # longer side of the photographs by which masks are guessed, pixels
# what is looked at once the object's place is known
_CHECKS = (check_place, check_coverage, check_sharpness, check_brightness)
_MOST = 200  # folders of one folder that are looked into for captures
_REGISTERING = 0.9  # share of the progress that finding poses takes where there are none


@dataclass(frozen=True, slots=True, kw_only=True)
class Workshop:
    """Where the poses of photographs without any are worked out."""

    folder: Path  # its own; what a stopped call left in it is taken up again
    seed: int  # seed of the estimators


def read_frames(source: Path, outside: Literal["refuse", "take"] = "refuse") -> FrameSet:
    """Recognise a folder or file of poses, and read all but the photographs."""
    if is_video(source):
        raise _no_poses(f"{source} is a video")
    if not source.is_dir() and not source.is_file():
        what = "is neither a folder nor a file" if os.path.lexists(source) else "does not exist"
        raise refuse("no-capture", f"{source} {what}", "Give the folder of a capture.")
    reader = reader_of(source)
    if reader is None and source.is_file():
        source = source.parent
        reader = reader_of(source)
    if reader is None:
        raise _not_recognised(source)
    frames = reader()
    for frame in frames.frames:
        _check_path(frame.image)
        _check_path(frame.mask)
    if outside == "refuse":
        paths = [path for f in frames.frames for path in (f.image, f.mask) if path is not None]
        home = source.parent if source.is_file() else source
        _refuse_outside(paths, (home, frames.root))
    return frames


def _check_path(path: Path | None) -> None:
    """Refuse a path that the operating system cannot be asked for."""
    try:
        checked_name("" if path is None else str(path))
    except UnsafeNameError as fault:
        message = f"A photograph or mask cannot be opened: {fault}"
        raise refuse("bad-name", message, "Rename it.") from None


def _refuse_outside(paths: Sequence[Path], homes: Sequence[Path]) -> None:
    """Refuse files that lie outside the capture's folder once links are followed."""
    folders = {path.parent for path in paths if not path.is_symlink()}
    strange = {folder for folder in folders if leads_out(folder, homes)}
    elsewhere = [
        str(path)
        for path in paths
        if path.parent in strange or (path.is_symlink() and leads_out(path, homes))
    ]
    if elsewhere:
        message = f"{len(elsewhere)} photographs or masks lie outside the folder {homes[0]}"
        cure = "Bring them into it; or, if you trust the capture, take them from where they are "
        cure += "with --set capture.outside=take."
        raise refuse("outside", message, cure, *elsewhere)


def _folders(source: Path) -> list[Path]:
    return [child for child in children(source) if child.is_dir()][:_MOST]


def _not_recognised(source: Path) -> CaptureRefusedError:
    """Why a folder is no capture, and where the capture may be."""
    captures = [child.name for child in _folders(source) if reader_of(child) is not None]
    if captures:
        message = f"{source} is no capture itself but holds {len(captures)}"
        return refuse("no-capture", message, "Give one of them.", *captures)
    photographs = [path.relative_to(source).as_posix() for path in find_photographs(source)]
    if not photographs:
        message = f"{source} holds no capture: there are neither photographs nor camera poses"
        return refuse("no-capture", message, f"Give the folder that holds photographs, or {KNOWN}.")
    refusal = _no_poses(f"{source} holds {len(photographs)} photographs", *photographs)
    return CaptureRefusedError([*unread_poses(source), *refusal.findings])


def _no_poses(what: str, *photographs: str) -> CaptureRefusedError:
    message = f"{what} but no camera poses"
    cure = "Install what finds them: pip install 'robir[photos]'; or estimate them, for example "
    cure += f"with COLMAP, and give the folder that holds {KNOWN}. Masks will be needed as well "
    cure += "(--masks DIR)."
    return refuse("no-poses", message, cure, *photographs)


def _lacks_poses(source: Path) -> bool:
    """Whether this is a video or a folder of photographs and nothing else."""
    if is_video(source):
        return True
    if not source.is_dir() or reader_of(source) is not None:
        return False
    has_photographs = bool(find_photographs(source))
    return has_photographs and not any(reader_of(child) for child in _folders(source))


def read_capture(
    source: Path,
    masks: Path | None,
    config: CaptureConfig,
    progress: Progress = unheard,
    workshop: Workshop | None = None,
    guesses: Path | None = None,
    mesh: Path | None = None,
) -> Capture:
    """Views in the capture's own frame, the object's bounds, and findings without errors.

    `source` is never written to. `masks` is a folder that wins over the capture's own. In
    `workshop` missing poses are worked out; None refuses captures without. `guesses` is where
    guessed masks are kept, or None. `mesh` is the user's: it cuts the object out where nothing else
    can. A `CaptureRefusedError` holds everything that was noticed until then; it is a
    `PosedRefusedError` if poses are sound.
    """
    if workshop is not None and sfm.is_available() and _lacks_poses(source):
        photographs = find_photographs(source) if source.is_dir() else []
        _stop_on_errors(check_count(len(photographs)))
        if config.outside == "refuse":
            _refuse_outside(photographs, (source,))
        first = _part_of(progress, 0.0, _REGISTERING)
        frames = register(source, workshop.folder, workshop.seed, first)
        frames = replace(frames, findings=(*frames.findings, *unread_poses(source)))
        progress = _part_of(progress, _REGISTERING, 1.0)
    else:
        frames = read_or_filmed(source, config, workshop, progress)
    frames = without_left_out(frames, config)
    findings = [*frames.findings, *check_frames(frames)]
    _stop_on_errors(findings)
    try:
        return _read_posed(source, (frames, findings), masks, (config, guesses, mesh), progress)
    except CaptureRefusedError as refusal:
        raise PosedRefusedError(refusal.findings, frames) from None


def read_or_filmed(
    source: Path, config: CaptureConfig, workshop: Workshop | None, progress: Progress
) -> FrameSet:
    """Posed frames; those of a recording of Stray Scanner are taken from its video if need be."""
    try:
        return read_frames(source, config.outside)
    except CaptureRefusedError as refusal:
        poses, video = (source / name for name in phones.STRAY_FILES)
        is_film = refusal.findings[0].code == phones.FRAMES_IN_VIDEO and video.is_file()
        if workshop is None or not is_film or leads_out(video, [source]):
            raise
    shutil.rmtree(workshop.folder, ignore_errors=True)
    notes = take_frames(video, workshop.folder, progress)
    frames = phones.read_stray_scanner(poses, workshop.folder)
    return replace(frames, findings=(*notes, *frames.findings))


def _read_posed(
    source: Path,
    posed: tuple[FrameSet, list[Finding]],
    masks: Path | None,
    how: tuple[CaptureConfig, Path | None, Path | None],
    progress: Progress,
) -> Capture:
    """The rest of `read_capture`, once poses are known to be sound."""
    (frames, findings), (config, *_) = posed, how
    findings += check_settings([frame.image for frame in frames.frames])
    chosen = splits(frames.frames, config)
    given = () if masks is None else (masks,)
    if masks is None:
        masks = _folder_of_masks(frames)
        findings += [note("mask-folder", f"Masks are taken from {masks}")] if masks else []
    try:
        drawn = {} if masks is None else mask_files.from_folder(masks, [f for f, _ in chosen])
        if config.outside == "refuse":
            _refuse_outside(tuple(drawn.values()), (frames.root, *given))
        chosen, drawn, about = prepared(frames, chosen, drawn)
        findings += about
    except CaptureRefusedError as refusal:
        raise CaptureRefusedError([*findings, *refusal.findings]) from None
    loaded, about = _load_masked(frames, chosen, drawn, how, progress)
    findings += about
    if loaded.views:
        findings += check_photographs(loaded.views)
    findings += _check_mask_supply(loaded)
    _stop_on_errors(findings)
    findings += check_masks(loaded.views)
    _stop_on_errors(findings)
    progress(_READING, "looking for the object")
    views, bounds, about = place_object(frames, loaded.views)
    findings += about
    if bounds is None:
        raise CaptureRefusedError(findings)
    for check in _CHECKS:
        findings += check(views, bounds)
    progress(1.0, "capture read")
    facts: dict[str, Any] = {"source": source, "format": frames.format}
    facts["findings"] = tuple(findings)
    facts |= {"table": loaded.table, "is_linear": loaded.is_linear}
    facts["photographs"] = {frame.name: frame.image for frame in frames.frames}
    return Capture(views=views, bounds=bounds, **facts)


def _load_masked(
    frames: FrameSet,
    chosen: list[tuple[Frame, Split]],
    drawn: dict[str, Path],
    how: tuple[CaptureConfig, Path | None, Path | None],
    progress: Progress,
) -> tuple[Loaded, list[Finding]]:
    """The photographs with their masks, guessed if none has any, and findings."""
    config = how[0]
    has_masks = bool(drawn) or frames.format == SYNTHETIC
    has_masks = has_masks or any(frame.mask for frame, _ in chosen)
    first = _READING if has_masks else _FIRST_READING
    # where nothing can be a mask, a small copy of each photograph is enough for a guess
    is_survey = not (has_masks or any(may_hold_alpha(frame.image) for frame, _ in chosen))
    side = SURVEY_SIDE if is_survey else config.max_side
    loaded = load_views(chosen, drawn, side, _part_of(progress, 0.0, first))
    findings = [*loaded.findings]
    unusable = any(finding.level == "error" for finding in findings)
    if unusable or not loaded.views or len(loaded.maskless) < len(loaded.views):
        return loaded, findings
    # OpenCV, which most captures need not
    from robir.capture.masks.unmasked import with_guessed_masks

    rest = _part_of(progress, first, _READING)
    loaded, about = with_guessed_masks(frames, chosen, loaded, how, rest)
    return loaded, findings + about


def _part_of(progress: Progress, begin: float, end: float) -> Progress:
    """What listens to a part of a task, between two shares of it."""
    return lambda share, text: progress(begin + (end - begin) * share, text)


def _folder_of_masks(frames: FrameSet) -> Path | None:
    """A folder of masks beside the photographs, for formats that only have it by custom."""
    if frames.format == SYNTHETIC or any(frame.mask for frame in frames.frames):
        return None
    folders = (frames.root / name for name in ("masks", "mask"))
    return next((folder for folder in folders if folder.is_dir()), None)


def _check_mask_supply(loaded: Loaded) -> list[Finding]:
    if len(loaded.maskless) == len(loaded.views):
        return []  # they were guessed, or it was said why they cannot be
    message = f"{len(loaded.maskless)} of {len(loaded.views)} photographs have no mask"
    return some("error", "missing-masks", loaded.maskless, message, mask_files.HOW_TO_SUPPLY)


def _stop_on_errors(findings: list[Finding]) -> None:
    if any(finding.level == "error" for finding in findings):
        raise CaptureRefusedError(findings)


_MAX_POINTS = 4000  # sparse points that are shown at most
_REACH = 0.25  # radius about the cameras' focus, against their distance, where an object is likely


def check_capture(
    source: Path, masks: Path | None, config: CaptureConfig, progress: Progress = unheard
) -> tuple[Capture | None, tuple[Finding, ...], FrameSet | None]:
    """The capture, or None if there are errors; findings, errors first; refused, posed frames."""
    try:
        with tempfile.TemporaryDirectory(prefix="robir-") as folder:
            workshop = Workshop(folder=Path(folder), seed=0)
            capture = read_capture(source, masks, config, progress, workshop)
    except CaptureRefusedError as refusal:
        posed = refusal.frames if isinstance(refusal, PosedRefusedError) else None
        return None, _sorted(refusal.findings), posed
    return capture, _sorted(capture.findings), None


def _sorted(findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    order = ("error", "warning", "note")
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))


def stands_of(frames: FrameSet) -> dict[str, Any] | None:
    """Cameras of a refused capture, where they look and sparse points (N, 3), for JSON; or None."""
    posed = [
        (frame, camera) for frame in frames.frames if (camera := _camera_of(frame)) is not None
    ]
    if not posed:
        return None
    cameras = [camera for _, camera in posed]
    places = np.stack([camera.position for camera in cameras])
    away = float(np.linalg.norm(places - places.mean(0), axis=1).max())
    centre, radius = places.mean(0), max(away, 1e-6)
    if frames.sphere is not None:
        centre, radius = frames.sphere.centre, float(frames.sphere.radius)
    elif (aim := focus(cameras)) is not None:
        centre, radius = aim[0], _REACH * aim[1]
    step = -(-len(frames.points) // _MAX_POINTS) or 1
    return {
        "cameras": [
            {"name": frame.name, "split": "train", "image": str(frame.image.resolve())}
            | plain_camera(camera)
            for frame, camera in posed
        ],
        "centre": np.asarray(centre, float).tolist(),
        "radius": radius,
        "points": frames.points[::step].tolist(),
    }


def _camera_of(frame: Frame) -> Camera | None:
    """The camera of a photograph, or None where that cannot be read."""
    try:
        with opened(frame.image) as picture:
            shown = upright(picture, orientation(picture)) if frame.is_upright else picture
            return frame.lens.camera(rigid(frame.camera_to_world), *shown.size)
    except CaptureRefusedError:
        return None
