# SPDX-License-Identifier: Apache-2.0
"""Light that moves with the camera: turntables and flashes.

Two signs are looked for. On a turntable the poses say that the camera went round the object, yet
what lies behind the object is the same in all photographs. And where light moves with the camera, a
point of the object changes its brightness with the direction its surface faces in the picture,
however fixed its reflectance is: the points are those of the visual hull, their brightness is taken
relative to their own mean over the views, and a smooth function of the normal in the camera's frame
(eight spherical harmonics, fitted to other points) is asked how much of the rest it explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robir.capture.capture import Bounds, Finding, View
from robir.capture.checks.coverage import directions_to
from robir.capture.checks.sightings import Sightings, sight
from robir.capture.checks.uneven_exposure import check_brightness, harmonics
from robir.capture.frames import Array
from robir.capture.refusal import warning

STATIC = 0.8  # correlation of backgrounds above which they are the same picture
# share of a point's changes explained by its normal in the picture that gives the light away.
# Captures under fixed light reach 0.07 (median over points); renders with a lamp fixed to the
# camera reach 0.24 to 0.8 on convex objects.
MOVING = 0.2
_SIDE = 96  # longer side of the pictures in which backgrounds are compared, at most twice this
_DETAIL = 2.5  # pixels of those pictures up to which something is detail; vignetting is no detail
_APART = 20.0  # degrees between two cameras from which their backgrounds have to differ
_PAIRS = 60
_SIGHTINGS = 6
_STEPS = 0.08  # steps of exposure that the moving light has to account for
_BREAKS = (
    "shadows and highlights turn with the camera, so that they end up in the base colour and "
    "no single environment explains the photographs"
)
_CURE = "Leave object and lamps where they are and walk round the object, without flash."


def check_turntable(
    views: Sequence[View], overviews: Sequence[View], bounds: Bounds
) -> list[Finding]:
    """Find an object that was turned before a camera at rest, by its background.

    Args:
        views: Photographs, poses as they are used.
        overviews: The same photographs with all that surrounds the object.
        bounds: The object's sphere.

    Returns:
        At most one finding.
    """
    likeness = background_likeness(views, overviews, bounds)
    if likeness is None or likeness <= STATIC:
        return []
    message = (
        "The poses go round the object, but the background stays the same in the picture "
        f"(correlation {likeness:.2f}): it was turned before a camera at rest; {_BREAKS}"
    )
    return [warning("turntable", message, _CURE, likeness=round(likeness, 3))]


def check_light(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """Find light that moves with the camera, or else changes between photographs.

    Args:
        views: Photographs with masks.
        bounds: The object's sphere.

    Returns:
        At most one finding.
    """
    sightings = sight(views, bounds)
    light = light_of_camera(sightings)
    if light is None or light.share < MOVING or light.steps < _STEPS:
        return check_brightness(views, bounds, sightings)
    kind = "as a flash does" if light.off_axis < 25 else "as on a turntable or with a carried lamp"
    return [
        warning(
            "moving-light",
            f"The light moves with the camera, {kind} (where a surface faces in the picture "
            f"explains {100 * light.share:.0f} % of a point's changes): {_BREAKS}",
            _CURE,
            share=round(light.share, 3),
            off_axis_degrees=round(light.off_axis, 1),
        )
    ]


def background_likeness(
    views: Sequence[View], overviews: Sequence[View], bounds: Bounds
) -> float | None:
    """Median correlation of the backgrounds of views from different directions.

    Args:
        views: Photographs, poses as they are used.
        overviews: The same photographs with all that surrounds the object.
        bounds: The object's sphere.

    Returns:
        Correlation in [-1, 1] of fine detail, so that vignetting and plain walls do not count;
        None if no background has detail, or no views are apart.
    """
    if len({view.mask.shape for view in overviews}) > 1:
        return None
    directions = directions_to(views, bounds)
    first, second = np.nonzero(np.triu(directions @ directions.T < np.cos(np.radians(_APART)), 1))
    if len(first) == 0:
        return None
    chosen = np.linspace(0, len(first) - 1, min(_PAIRS, len(first))).astype(int)
    details, behind = zip(*(_background(view) for view in overviews), strict=True)
    found = []
    for one, other in zip(first[chosen], second[chosen], strict=True):
        common = behind[one] & behind[other]
        a, b = details[one][common], details[other][common]
        if common.mean() < 0.15 or min(a.std(), b.std()) < 3.0:
            continue
        found.append(float(np.corrcoef(a, b)[0, 1]))
    return float(np.median(found)) if len(found) >= 0.5 * len(chosen) else None


def _background(view: View) -> tuple[Array, NDArray[np.bool_]]:
    """Fine detail of a small grey picture, and where it is certainly no object."""
    step = max(1, max(view.mask.shape) // _SIDE)
    height, width = (size // step * step for size in view.mask.shape)

    def blocks(layer: Array) -> Array:
        return (
            layer[:height, :width].reshape(height // step, step, width // step, step).mean((1, 3))
        )

    grey = blocks(view.image_display.mean(axis=2, dtype=np.float64))
    behind = ndimage.binary_erosion(blocks(view.mask.astype(np.float64)) < 1, iterations=2)
    # The object must not bleed into the detail around it.
    weight = ndimage.gaussian_filter(behind.astype(np.float64), _DETAIL)
    smooth = ndimage.gaussian_filter(np.where(behind, grey, 0.0), _DETAIL)
    return grey - smooth / np.maximum(weight, 1e-6), behind


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLight:
    """What light fixed to the camera explains.

    Attributes:
        share: Median over points of the share of their changes it explains, at most 1.
        steps: Standard deviation of the brightness it accounts for, in steps.
        off_axis: Degrees between the brightest normal and the viewing axis.
    """

    share: float
    steps: float
    off_axis: float


def light_of_camera(sightings: Sightings) -> CameraLight | None:
    """Explain changes of brightness by the normal in the camera's frame.

    Args:
        sightings: Points of the object in all photographs.

    Returns:
        What it explains, or None if too few points are seen often enough.
    """
    seen = sightings.of(np.isfinite(sightings.brightness).sum(axis=1) >= _SIGHTINGS)
    brightness, normals = seen.brightness, seen.normals
    count = len(brightness)
    if count < 50:
        return None
    point, view = np.nonzero(np.isfinite(brightness))
    times = np.bincount(point, minlength=count)

    def centred(values: Array) -> Array:
        return values - (np.bincount(point, values, minlength=count) / times)[point]

    change = brightness - np.nanmedian(brightness, axis=1, keepdims=True)
    changes = centred(np.clip(change[point, view], -1.5, 1.5))
    terms = harmonics(normals[point, view])[:, 1:]
    features = np.stack([centred(term) for term in terms.T], axis=1)
    rest = np.empty_like(changes)
    for fold in range(5):
        mine = point % 5 == fold
        weights = np.linalg.lstsq(features[~mine], changes[~mine], rcond=None)[0]
        rest[mine] = changes[mine] - features[mine] @ weights
    before = np.bincount(point, changes**2, minlength=count)
    after = np.bincount(point, rest**2, minlength=count)
    weights = np.linalg.lstsq(features, changes, rcond=None)[0]
    return CameraLight(
        share=float(np.median(1 - after / np.maximum(before, 1e-9))),
        steps=float((features @ weights).std()),
        off_axis=_brightest(weights),
    )


def _brightest(weights: Array) -> float:
    """Degrees from the viewing axis to the normal that the fit makes brightest."""
    tilt, turn = np.meshgrid(np.linspace(0.0, 1.2, 13), np.linspace(0.0, 2 * np.pi, 24))
    faces = (
        np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=-1)
        .reshape(-1, 3)
        .astype(np.float64)
    )
    return float(np.degrees(tilt.ravel()[np.argmax(harmonics(faces)[:, 1:] @ weights)]))
