# SPDX-License-Identifier: Apache-2.0
"""Where the photographs of a refused capture were taken, for those who have to say where to look.

A capture without masks may be refused because nothing tells the object from its surroundings. The
user then places a box about it, and for that must see the cameras.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.frames import Frame, FrameSet, rigid
from robir.capture.images.decode import opened, orientation, upright
from robir.capture.masks.region import focus
from robir.capture.refusal import CaptureRefusedError
from robir.capture.store import plain_camera

MAX_POINTS = 4000  # sparse points that are shown at most
# radius about the cameras' common focus, against their distance, within which an object is likely
# to be
REACH = 0.25


def stands_of(frames: FrameSet) -> dict[str, Any] | None:
    """What there is to see of posed photographs, as plain values for JSON.

    Args:
        frames: Posed photographs, poses without fault.

    Returns:
        "cameras" like those of an accepted capture, each with its "image"; "centre" and "radius"
        of where they look; "points", (N, 3) sparse points. None where no photograph can be read.
    """
    posed = [(frame, camera) for frame in frames.frames if (camera := _camera(frame)) is not None]
    if not posed:
        return None
    centre, radius = _aim(frames, [camera for _, camera in posed])
    step = -(-len(frames.points) // MAX_POINTS) or 1
    return {
        "cameras": [
            {"name": frame.name, "split": "train"}
            | plain_camera(camera)
            | {"image": str(frame.image.resolve())}
            for frame, camera in posed
        ],
        "centre": centre.tolist(),
        "radius": radius,
        "points": frames.points[::step].tolist(),
    }


def _camera(frame: Frame) -> Camera | None:
    """The camera of a photograph, or None where that cannot be read."""
    try:
        with opened(frame.image) as picture:
            shown = upright(picture, orientation(picture)) if frame.is_upright else picture
            size = shown.size
        return frame.lens.camera(rigid(frame.camera_to_world), *size)
    except CaptureRefusedError:
        return None


def _aim(frames: FrameSet, cameras: list[Camera]) -> tuple[NDArray[np.float64], float]:
    """Where the cameras look, and how large what they look at may be."""
    if frames.sphere is not None:
        return np.asarray(frames.sphere.centre, float), float(frames.sphere.radius)
    aim = focus(cameras)
    if aim is not None:
        return aim[0], REACH * aim[1]
    place = np.stack([camera.position for camera in cameras])
    return place.mean(0), max(float(np.linalg.norm(place - place.mean(0), axis=1).max()), 1e-6)
