# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera responses: a family about the mean of 201 measured ones.

Grossberg and Nayar ("Modeling the Space of Camera Response Functions", IEEE PAMI 26(10), 2004)
measured 201 responses of films and cameras. What they publish of the spread: the first principal
component has one sign and is largest in the darker tones, as a change of gamma is; the second
changes sign once (toe against shoulder), the third twice; three of them explain over 99 % of the
energy. The components themselves are not copied here. Instead the mean curve f0 of `view_transform`
is raised to a power that varies along the tones,

    f(x) = f0(x) ** exp(s1 + s2 p1(t) + s3 p2(t)),    t = 2 x ** (1 / 2.2) - 1

with p1, p2 the Legendre polynomials: s1 moves the gamma, s2 toe against shoulder, s3 the middle.
All curves go through 0 and 1. How wide the numbers are drawn is ours, and narrower than the
database, half of which are films: cameras that people hold today.
"""

import numpy as np

from blender_scenes.view_transform import measured_response

_KNOTS = np.linspace(0.0, 1.0, 4097)


def response(linear: np.ndarray, numbers: tuple[float, float, float]) -> np.ndarray:
    """Display values 0..1 of linear ones, any shape; clips below 0 and from 1 up."""
    x = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    t = 2.0 * x ** (1.0 / 2.2) - 1.0
    gamma, toe, middle = numbers
    power = np.exp(gamma + toe * t + middle * 0.5 * (3.0 * t * t - 1.0))
    return np.clip(measured_response(x), 0.0, 1.0) ** power


def is_monotone(numbers: tuple[float, float, float]) -> bool:
    """Whether the curve rises everywhere but by rounding."""
    return bool((np.diff(response(_KNOTS, numbers)) > 0.0).all())


def drawn_response(
    rng: np.random.Generator, spread: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Numbers of a rising curve, normal with a spread each, no further than twice that."""
    while True:
        gamma, toe, middle = np.clip(rng.normal(size=3), -2.0, 2.0) * np.array(spread)
        numbers = float(gamma), float(toe), float(middle)
        if is_monotone(numbers):
            return numbers
