# SPDX-License-Identifier: GPL-3.0-or-later
"""Print: labels of made-up words, bars, stripes, badges and bar codes, as linear textures."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from blender_scenes.recipe import Rgb

SIZE = 1024

_SYLLABLES = (
    "ba", "lo", "ri", "ten", "mo", "sa", "ku", "vel", "na", "dor", "fi", "pra", "zu", "el", "gim",
)  # fmt: skip
SUPERSAMPLED = 2


def label(colours: Sequence[Rgb], cells: int, rng: np.random.Generator) -> np.ndarray:
    """A printed texture (SIZE, SIZE, 3), first row at the bottom, in two or three inks.

    Args:
        colours: paper, ink and, if any, a third one.
        cells: how many fields it has beside each other.
        rng: decides words and places.
    """
    side = SUPERSAMPLED * SIZE
    sheet = Image.new("L", (side, side), 0)
    pen = ImageDraw.Draw(sheet)
    fields = int(np.clip(cells // 2, 1, 4))
    for column in range(fields):
        _field(pen, side * column // fields, side // fields, side, rng)
    index = np.asarray(sheet)[::-1]
    inks = np.array([colours[0], colours[1], colours[-1]])
    shares = np.stack([(index == number).astype(np.float64) for number in range(3)], axis=-1)
    half = (SIZE, SUPERSAMPLED, SIZE, SUPERSAMPLED, 3)
    return (shares.reshape(half).mean(axis=(1, 3)) @ inks).astype(np.float32)


def _word(rng: np.random.Generator) -> str:
    return "".join(str(s) for s in rng.choice(_SYLLABLES, int(rng.integers(2, 4))))


def _field(
    pen: ImageDraw.ImageDraw, left: int, width: int, height: int, rng: np.random.Generator
) -> None:
    """One upright field of a label; 0 is paper, 1 ink, 2 the third colour."""
    right = left + width
    low, high = sorted(rng.uniform(0.05, 0.95, 2))
    pen.rectangle((left, height * low, right, height * min(high, low + 0.3)), fill=2)
    for _ in range(int(rng.integers(1, 4))):
        y = float(rng.uniform(0.02, 0.96)) * height
        pen.rectangle((left, y, right, y + height * float(rng.uniform(0.005, 0.03))), fill=1)
    for _ in range(int(rng.integers(1, 4))):
        x, y = left + width * rng.uniform(0.1, 0.9), height * rng.uniform(0.1, 0.9)
        r = 0.5 * width * rng.uniform(0.08, 0.3)
        box = (x - r, y - r, x + r, y + r)
        if rng.random() < 0.5:
            pen.ellipse(box, fill=int(rng.integers(1, 3)))
        else:
            pen.polygon([(x, y - r), (x + r, y + r), (x - r, y + r)], fill=int(rng.integers(1, 3)))
    for line, share in ((_word(rng).upper(), 0.09), (_word(rng), 0.06), (_word(rng), 0.045)):
        font = ImageFont.load_default(size=share * height)
        place = (left + 0.5 * width, height * float(rng.uniform(0.1, 0.9)))
        pen.text(place, line, fill=1, font=font, anchor="mm")
    font = ImageFont.load_default(size=0.022 * height)
    top = float(rng.uniform(0.45, 0.8))
    for row in range(int(rng.integers(3, 8))):
        words = " ".join(_word(rng) for _ in range(4))
        pen.text((left + 0.08 * width, height * (top + 0.028 * row)), words, fill=1, font=font)
    _bars(pen, left + 0.62 * width, height * float(rng.uniform(0.05, 0.3)), 0.3 * width, rng)


def _bars(
    pen: ImageDraw.ImageDraw, x: float, y: float, width: float, rng: np.random.Generator
) -> None:
    """A bar code."""
    pen.rectangle((x, y, x + width, y + 0.6 * width), fill=0)
    at = x + 0.05 * width
    while at < x + 0.93 * width:
        bar = width * float(rng.choice((0.012, 0.024, 0.036)))
        pen.rectangle((at, y + 0.05 * width, at + bar, y + 0.5 * width), fill=1)
        at += bar + width * float(rng.choice((0.012, 0.024, 0.036)))
