# SPDX-License-Identifier: GPL-3.0-or-later
"""From radiance to a photograph: exposure, vignetting, sensor noise, white balance, response.

    raw     = radiance * 2**exposure * vignetting
    noisy   = raw + sqrt(raw / e + (read / e)**2) * normal,   e = full well * 100 / ISO
    display = response(noisy * white balance)

e is the number of electrons that make white. The picture is then rounded and written as JPEG.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from blender_scenes.environment import LUMINANCE
from blender_scenes.photographs.recipe import Developing, Frame
from blender_scenes.photographs.response import response

METERED = 0.16
"""Where the mean of the logarithms of luminance is put, linear: half of it the whole photographs',
half the thing's, at which the camera was pointed."""

CLIPPED = 0.04
"""Share of the thing's pixels that may be clipped; the exposure is lowered until no more are."""

DARK = 0.06
"""Half of the thing's pixels are kept at least this bright, linear."""

MOST_CLIPPED = 0.15
"""Share of clipped pixels at which brightening ends."""

STEP = 0.125


@dataclass(frozen=True)
class Shot:
    """How one photograph was taken.

    Attributes:
        exposure: stops by which radiance is multiplied.
        white_balance: (3,) factors on what the sensor saw, the camera's own white included.
    """

    exposure: float
    white_balance: tuple[float, float, float]


def vignetting(frame: Frame, strength: float) -> np.ndarray:
    """Factor (H, W) on radiance: 1 in the middle, cos^4 of the field angle at full strength."""
    x = np.arange(frame.width) + 0.5 - 0.5 * frame.width
    y = np.arange(frame.height) + 0.5 - 0.5 * frame.height
    squared = (x[None, :] ** 2 + y[:, None] ** 2) / frame.focal**2
    return 1.0 - strength * (1.0 - 1.0 / (1.0 + squared) ** 2)


def noise_deviation(raw: np.ndarray, developing: Developing) -> np.ndarray:
    """Standard deviation of the sensor's noise where it sees `raw`, 1 being white."""
    electrons = developing.full_well * 100.0 / developing.iso
    return np.sqrt(np.maximum(raw, 0.0) / electrons + (developing.read_noise / electrons) ** 2)


def display(
    radiance: np.ndarray, shot: Shot, developing: Developing, frame: Frame, seed: int | None
) -> np.ndarray:
    """Display values (H, W, 3) of a photograph.

    Args:
        radiance: (H, W, 3) linear Rec.709.
        shot: how it was taken.
        developing: the camera.
        frame: its size.
        seed: of the noise; None leaves it out.
    """
    raw = radiance.astype(np.float64) * 2.0**shot.exposure
    raw *= vignetting(frame, developing.vignetting)[..., None]
    if seed is not None:
        normal = np.random.default_rng(seed).normal(size=raw.shape)
        raw += noise_deviation(raw, developing) * normal
    return response(raw * np.array(shot.white_balance), developing.response)


def shots(
    radiances: Sequence[np.ndarray],
    masks: Sequence[np.ndarray],
    light_rgb: np.ndarray,
    developing: Developing,
) -> list[Shot]:
    """How each photograph of a capture is taken: metered once, then off as was drawn.

    Args:
        radiances: (H, W, 3) of some photographs, all of them or evenly chosen ones.
        masks: (H, W) of the thing in them.
        light_rgb: (3,) irradiance at the thing: what the camera takes for white.
        developing: the camera.

    Returns:
        One for each of `radiances`.
    """
    white = float(light_rgb @ LUMINANCE) / np.maximum(light_rgb, 1e-9)
    balance = white * np.array(developing.white_balance)
    luminance = np.concatenate([(r[::3, ::3] @ LUMINANCE).ravel() for r in radiances])
    thing = np.concatenate([r[m > 0.5] for r, m in zip(radiances, masks, strict=True)]) * balance
    means = [np.log2(np.maximum(grey, 1e-5)).mean() for grey in (luminance, thing @ LUMINANCE)]
    exposure = float(np.log2(METERED) - np.mean(means)) + developing.brightness
    margin = 2.0**developing.exposure_jitter
    typical = float(np.median(thing.max(axis=1)))
    # what mirrors a lamp may be clipped before the rest is dark
    while (
        clipped(thing * 2.0**exposure * margin) > CLIPPED
        and typical * 2.0 ** (exposure - STEP) >= DARK
    ):
        exposure -= STEP
    while (
        typical * 2.0**exposure < DARK
        and clipped(thing * 2.0 ** (exposure + STEP) * margin) <= MOST_CLIPPED
    ):
        exposure += STEP
    rng = np.random.default_rng(developing.seed)
    most = developing.exposure_jitter
    taken = []
    for _ in radiances:
        own = balance * (1.0 + np.clip(rng.normal(size=3), -2, 2) * developing.balance_jitter)
        red, green, blue = (float(c) for c in own)
        taken.append(Shot(exposure + float(rng.uniform(-most, most)), (red, green, blue)))
    return taken


def clipped(linear: np.ndarray) -> float:
    """Share of pixels (N, 3) with a channel at or above white."""
    return float((linear >= 1.0).any(axis=1).mean())
