# SPDX-License-Identifier: Apache-2.0
"""`robir check`: findings about a capture before an hour is spent on it.

Of a capture that is refused for want of masks the cameras can be shown all the same: the user may
place a box about the object, and for that must see them.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from robir.capture.camera import Camera
from robir.capture.capture import Capture, Finding
from robir.capture.config import CaptureConfig
from robir.capture.frames import Frame, FrameSet, PosedRefusedError, rigid
from robir.capture.images.decode import opened, orientation, upright
from robir.capture.masks.region import focus
from robir.capture.recognise import Workshop, read_capture
from robir.capture.refusal import CaptureRefusedError
from robir.capture.store import plain_camera
from robir.capture.views import Progress, unheard

_MAX_POINTS = 4000  # sparse points that are shown at most
# radius about the cameras' common focus, against their distance, within which an object is likely
_REACH = 0.25


def check_capture(
    source: Path, masks: Path | None, config: CaptureConfig, progress: Progress = unheard
) -> tuple[Capture | None, tuple[Finding, ...], FrameSet | None]:
    """The capture, or None if errors are among its findings; these, errors first.

    Of a refused capture the posed photographs come last, if there are any.
    """
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
    """Where the photographs of a refused capture were taken, as plain values for JSON.

    "cameras" are like those of an accepted capture, each with its "image"; "centre" and "radius"
    say where they look; "points" are sparse, (N, 3). None where no photograph can be read.
    """
    posed = [(frame, camera) for frame in frames.frames if (camera := _camera(frame)) is not None]
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


def _camera(frame: Frame) -> Camera | None:
    """The camera of a photograph, or None where that cannot be read."""
    try:
        with opened(frame.image) as picture:
            shown = upright(picture, orientation(picture)) if frame.is_upright else picture
            return frame.lens.camera(rigid(frame.camera_to_world), *shown.size)
    except CaptureRefusedError:
        return None
