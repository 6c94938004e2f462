# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a capture before a pixel is read: its counts, files, poses and lenses."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from robir.capture.capture import PHOTOGRAPHS_ALONE, Finding
from robir.capture.frames import Frame, FrameSet, pose_fault
from robir.capture.masks.given import IGNORE
from robir.capture.readers.files import children, without_others
from robir.capture.refusal import error, note, some, warning

MIN_VIEWS = 3  # fewer views cannot fix a surface
# more than this are refused: ten times as many as any object needs, and each takes time
MAX_VIEWS = 2000
FEW_VIEWS = 12  # below this many views, hidden sides stay guesses
_SIDES_CURE = "Leave out the wrong ones, or set the intrinsics right."


def check_frames(frames: FrameSet) -> list[Finding]:
    """Counts, missing files, poses and focal lengths; with an error, reading on is useless."""
    everything = frames.frames
    tests = sum(frame.split == "test" for frame in everything)
    trains = len(everything) - tests
    message = f"{frames.format} capture with {len(everything)} posed photographs"
    found = [note("counts", message + (f", {tests} of them test views" if tests else ""))]
    if trains < MIN_VIEWS:
        message = f"{frames.root} has {trains} posed photographs to learn from; "
        message += f"at least {MIN_VIEWS} are needed, 30 or more are good"
        found.append(error("too-few-views", message, "Add photographs from other directions."))
    elif trains < FEW_VIEWS:
        cure = "Expect guesses on sides that few views see; 30 or more views are good."
        found.append(warning("few-views", f"Only {trains} views to learn from", cure))
    found += check_count(len(everything))
    missing = [frame.relative for frame in everything if not frame.image.is_file()]
    message = f"{len(missing)} of {len(everything)} posed photographs are missing below "
    cure = "Put the photographs there under the names the poses use, or do without them with "
    cure += "--skip-missing."
    found += some("error", "missing-images", missing, f"{message}{frames.root}", cure)
    unposed = [] if missing else _check_unposed(frames)
    return found + unposed + _check_poses(everything) + _check_lenses(everything)


def check_count(photographs: int) -> list[Finding]:
    """Whether there are more photographs than can be read in a sane time."""
    if photographs <= MAX_VIEWS:
        return []
    message = f"There are {photographs} photographs; at most {MAX_VIEWS} are read"
    return [error("too-many-views", message, "Keep every n-th of them: 200 show an object well.")]


def _check_unposed(frames: FrameSet) -> list[Finding]:
    """Photographs beside posed ones that have no pose themselves."""
    # NeRF-synthetic keeps depth and normal pictures beside the photographs; where the poses were
    # estimated here, what has none was named then.
    if frames.format in ("nerf-synthetic", "nerfactor", PHOTOGRAPHS_ALONE):
        return []
    images = [frame.image for frame in frames.frames]
    masks = [frame.mask for frame in frames.frames if frame.mask is not None]
    used = {os.path.normpath(path) for path in (*images, *masks)}
    suffixes = {path.suffix.lower() for path in images}
    beside = [
        path.name
        for folder in sorted({path.parent for path in images})
        for path in without_others(children(folder))
        if path.suffix.lower() in suffixes
        and os.path.normpath(path) not in used
        and not path.name.startswith(IGNORE)
    ]
    message = f"{len(beside)} photographs have no pose and are left out"
    cure = "If they show sides that no other does, estimate poses that include them."
    return some("warning", "unposed-images", beside, message, cure)


def _check_poses(frames: Sequence[Frame]) -> list[Finding]:
    faults: dict[str, list[str]] = defaultdict(list)
    places: dict[bytes, list[str]] = defaultdict(list)
    for frame in frames:
        fault = pose_fault(frame.camera_to_world)
        if fault is not None:
            faults[fault].append(frame.relative)
        else:
            places[np.round(frame.camera_to_world, 9).tobytes()].append(frame.relative)
    found = []
    for fault, names in faults.items():
        message = f"The pose of {len(names)} of {len(frames)} photographs {fault}"
        cure = "Estimate the poses again, or remove these photographs."
        found.append(error("bad-pose", message, cure, *names))
    twins = [name for names in places.values() if len(names) > 1 for name in names]
    message = f"{len(twins)} of {len(frames)} photographs share their pose with another"
    cure = "Remove repeated photographs; if they differ, their poses are wrong."
    return found + some("warning", "duplicate-poses", twins, message, cure)


def _check_lenses(frames: Sequence[Frame]) -> list[Finding]:
    absurd = [frame.relative for frame in frames if not frame.lens.is_sane]
    if absurd:
        message = f"{len(absurd)} of {len(frames)} photographs have a focal length or field of view"
        return [error("bad-intrinsics", message + " that no camera has", _SIDES_CURE, *absurd)]
    stated = [(f.lens.fx, f.relative) for f in frames if f.lens.fx is not None]
    angles = [(f.lens.angle_x, f.relative) for f in frames if f.lens.fx is None]
    stated += [(1 / angle, name) for angle, name in angles if angle is not None]
    middle = float(np.median([value for value, _ in stated])) if stated else 1.0
    odd = [name for value, name in stated if not 0.5 <= value / middle <= 2]
    message = f"{len(odd)} of {len(frames)} photographs have a focal length less than half "
    message += "or more than twice that of the others"
    return some("warning", "focal-lengths", odd, message, _SIDES_CURE)
