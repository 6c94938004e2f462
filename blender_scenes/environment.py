# SPDX-License-Identifier: GPL-3.0-or-later
"""Lat-long environment maps: directions, irradiance, and where the sun is (pure numpy).

A map is (H, 2H, 3) linear Rec.709 radiance, first row at the top, in Blender's world frame:
u = 0.5 - atan2(y, x) / 2 pi from the left, v = 0.5 - asin(z) / pi from the top.
"""

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear Rec.709 in relative luminance."""

UP = np.array([0.0, 0.0, 1.0])

SUN_SPOT_RADIUS = float(np.radians(4.0))
"""Angle about the sun's centre whose light counts as the sun's: disc and glare of a filmed sky."""

SOFTENED = 12.0
"""The most that a softened map shines, over its mean radiance: windows stay, suns go."""


def map_directions(height: int) -> np.ndarray:
    """Unit world directions (H, 2H, 3) of the texel centres of a lat-long map."""
    v = (np.arange(height) + 0.5) / height
    u = (np.arange(2 * height) + 0.5) / (2 * height)
    azimuth = 2.0 * np.pi * (0.5 - u)[None, :]
    elevation = np.pi * (0.5 - v)[:, None]
    flat = np.cos(elevation)
    return np.stack(
        [
            flat * np.cos(azimuth),
            flat * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation), (height, 2 * height)),
        ],
        axis=-1,
    )


def texel_solid_angles(height: int) -> np.ndarray:
    """Solid angle (H, 1) in steradians of a texel in each row."""
    edges = np.sin(np.pi * (0.5 - np.arange(height + 1) / height))
    return ((edges[:-1] - edges[1:]) * np.pi / height)[:, None]


def irradiance(environment: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Irradiance (3,) that a lat-long map gives an unoccluded surface of unit normal (3,)."""
    height = environment.shape[0]
    cosine = np.maximum(map_directions(height) @ normal, 0.0) * texel_solid_angles(height)
    return np.einsum("hw,hwc->c", cosine, environment)


def sun_spot(environment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sun inside a map.

    Args:
        environment: (H, 2H, 3) radiance.

    Returns:
        Its direction (3,), unit, and the irradiance (3,) it gives a surface that faces it: all
        light from within SUN_SPOT_RADIUS.
    """
    height = environment.shape[0]
    directions = map_directions(height)
    luminance = environment @ LUMINANCE
    # squared, so that the disc decides and an uneven glare about it does not pull the centre
    weight = luminance**2 * texel_solid_angles(height)
    centre = directions[np.unravel_index(np.argmax(luminance), luminance.shape)]
    for _ in range(4):
        inside = directions @ centre > np.cos(SUN_SPOT_RADIUS)
        centre = np.einsum("hw,hwc->c", weight * inside, directions)
        centre /= np.linalg.norm(centre)
    inside = directions @ centre > np.cos(SUN_SPOT_RADIUS)
    return centre, np.einsum("hw,hwc->c", inside * texel_solid_angles(height), environment)


def with_sun_share(environment: np.ndarray, share: float) -> np.ndarray:
    """Brightens the sun of a map whose file clips it.

    Args:
        environment: (H, 2H, 3) radiance with a sun above the horizon.
        share: wanted share, below 1, of the sun in the irradiance of a horizontal surface.

    Returns:
        The map with its sun's disc scaled; unchanged where the sun gives that much already.
    """
    height = environment.shape[0]
    directions = map_directions(height)
    direction, _ = sun_spot(environment)
    luminance = environment @ LUMINANCE
    disc = (directions @ direction > np.cos(SUN_SPOT_RADIUS)) & (luminance > 0.05 * luminance.max())
    sun = irradiance(environment * disc[..., None], UP) @ LUMINANCE
    sky = irradiance(environment, UP) @ LUMINANCE - sun
    factor = max(share / (1.0 - share) * sky / sun, 1.0)
    return np.where(disc[..., None], factor * environment, environment)


def softened(environment: np.ndarray) -> np.ndarray:
    """A map (H, 2H, 3) whose luminance is held to SOFTENED times its mean over the sphere."""
    luminance = environment @ LUMINANCE
    mean = float((luminance * texel_solid_angles(environment.shape[0])).sum()) / (4.0 * np.pi)
    limit = SOFTENED * mean
    return environment * (limit / np.maximum(luminance, limit))[..., None]
