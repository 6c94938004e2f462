# SPDX-License-Identifier: Apache-2.0
"""Photographs that were not exposed alike: by what the camera wrote, and by how they look."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robir.capture.capture import Bounds, Finding, View
from robir.capture.checks.coverage import directions_to
from robir.capture.checks.sightings import POWER, Sightings
from robir.capture.frames import Array
from robir.capture.images.decode import exif_values, header
from robir.capture.refusal import CaptureRefusedError, warning

SETTINGS_SPREAD = 0.15  # steps of exposure between the camera's settings that are let pass
# steps (standard deviation) by which neighbouring photographs may differ over the whole object.
# Captures under one light and exposure reach 0.07; exposures off by up to half a step reach 0.28.
BRIGHTNESS_SPREAD = 0.15
# steps (standard deviation) by which photographs may differ at the same points. Captures under one
# light and exposure reach 0.1, and 0.15 where the visual hull is far from the object; exposures off
# by up to half a step reach 0.24.
POINT_SPREAD = 0.2
_TIME, _APERTURE, _SPEED, _FLASH = 33434, 33437, 34855, 37385
_FIRED = 1
_FEWEST_VIEWS = 18  # views from which nine coefficients can be told from jitter
_FLOOR = 1e-3
_CURE = "Photograph with exposure and white balance locked (manual mode) and all lamps left alone."


def check_settings(photographs: Sequence[Path]) -> list[Finding]:
    """Compare the exposures and the flash that cameras wrote into the photographs (EXIF).

    Args:
        photographs: Files, of which those that say nothing are passed over.

    Returns:
        Findings; none where fewer than two photographs state their exposure.
    """
    stated = {path.name: _settings(path) for path in photographs}
    fired = [name for name, (_, flash) in stated.items() if flash]
    found = []
    if fired:
        found.append(
            warning(
                "flash-fired",
                f"The flash fired in {len(fired)} of {len(photographs)} photographs: its light "
                "and reflections move with the camera",
                "Photograph without flash, under light that stays where it is.",
                *fired,
            )
        )
    steps = {name: value for name, (value, _) in stated.items() if value is not None}
    if len(steps) < 2:
        return found
    middle = float(np.median(list(steps.values())))
    spread = max(steps.values()) - min(steps.values())
    if spread > SETTINGS_SPREAD:
        apart = sorted(steps, key=lambda name: -abs(steps[name] - middle))
        far = [name for name in apart if abs(steps[name] - middle) > 0.5 * SETTINGS_SPREAD]
        found.append(
            warning(
                "exposure-settings",
                f"The camera's exposure (time, aperture and sensitivity) differs by {spread:.1f} "
                f"steps between photographs; {len(far)} of {len(photographs)} are off",
                _CURE,
                *far,
                spread_steps=round(spread, 3),
            )
        )
    return found


def _settings(path: Path) -> tuple[float | None, bool]:
    """Exposure in steps (log2 of time times sensitivity over squared aperture), and the flash."""
    try:
        with header(path) as picture:
            tags: dict[int, Any] = exif_values(picture) or {}
        flash = bool(int(tags.get(_FLASH, 0)) & _FIRED)
        speed = tags.get(_SPEED)
        speed = speed[0] if isinstance(speed, tuple) else speed
        gain = float(tags[_TIME]) * float(speed or 0) / float(tags[_APERTURE]) ** 2
    except (CaptureRefusedError, ValueError, TypeError, LookupError, ArithmeticError):
        return None, False
    return (float(np.log2(gain)) if 0 < gain < np.inf else None), flash


def check_brightness(views: Sequence[View], bounds: Bounds, sightings: Sightings) -> list[Finding]:
    """Compare the object's brightness between photographs.

    Args:
        views: Photographs with masks.
        bounds: The object's sphere.
        sightings: Points of the object in these photographs.

    Returns:
        At most one finding.
    """
    offsets = uneven_exposures(views, bounds, sightings)
    if offsets is None:
        return []
    spread = float(offsets.std())
    order = np.argsort(-np.abs(offsets))
    far = [views[i].name for i in order if abs(offsets[i]) > POINT_SPREAD]
    outliers = f" ({len(far)} of {len(views)} stand out)" if far else ""
    return [
        warning(
            "brightness-changes",
            f"The object's brightness changes by {spread:.2f} steps between photographs of the "
            f"same places{outliers}: exposure, white balance or the light changed",
            _CURE,
            *far,
            spread_steps=round(spread, 3),
        )
    ]


def uneven_exposures(views: Sequence[View], bounds: Bounds, sightings: Sightings) -> Array | None:
    """How much brighter than the others each photograph is, where they were not exposed alike.

    Two measures have to agree, as each has objects that deceive it. Points of the object, compared
    between the photographs that show them, are off by the exposure in the median; that fails where
    the visual hull is no surface. And under one light the mean brightness of the object is a smooth
    function of the direction it is seen from: what nine spherical harmonics leave, for each view
    fitted to the others, is the exposure's doing; that fails for hard light on plain objects.

    Args:
        views: V photographs with masks.
        bounds: The object's sphere.
        sightings: Points of the object in these photographs.

    Returns:
        Steps (V,) as of `exposure_offsets`; None where the photographs count as exposed alike.
    """
    if len(views) < _FEWEST_VIEWS:
        return None
    basis = harmonics(directions_to(views, bounds))
    levels = np.array([_level(view) for view in views])
    hat = basis @ np.linalg.pinv(basis)
    left = np.maximum(1 - np.diag(hat), 0.1)
    smooth = float(((levels - hat @ levels) / np.sqrt(left)).std())
    offsets = exposure_offsets(sightings)
    apart = smooth > BRIGHTNESS_SPREAD and float(offsets.std()) > POINT_SPREAD
    return offsets if apart else None


def exposure_offsets(sightings: Sightings) -> Array:
    """Median brightness of each photograph relative to the others at the same points, steps, (V,).

    Photographs that show fewer than ten comparable points have 0.
    """
    brightness = sightings.brightness
    brightness = brightness[np.isfinite(brightness).sum(axis=1) >= 4]
    offsets = np.zeros(brightness.shape[1])
    comparable = np.isfinite(brightness).sum(axis=0) >= 10
    if not comparable.any():
        return offsets
    for _ in range(5):
        points = np.nanmedian(brightness - offsets, axis=1, keepdims=True)
        offsets[comparable] = np.nanmedian((brightness - points)[:, comparable], axis=0)
    offsets[comparable] -= np.median(offsets[comparable])
    return offsets


def _level(view: View) -> float:
    """Brightness of the object in steps."""
    inside = view.mask >= 250
    pixels = view.image_display[inside if inside.any() else slice(None)]
    means = ((pixels.reshape(-1, 3) / 255.0) ** POWER).mean(axis=0)
    return float(np.log2(means + _FLOOR).mean())


def harmonics(directions: Array) -> Array:
    """Real spherical harmonics to the second order, not normalised, (N, 9)."""
    x, y, z = directions.T
    return np.stack(
        [np.ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], axis=1
    )
