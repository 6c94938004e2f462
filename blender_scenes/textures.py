# SPDX-License-Identifier: GPL-3.0-or-later
"""Image textures made with numpy, so that the true base colour is known exactly.

Textures are (H, W, 3) float32 linear Rec.709 reflectance in 0.02..0.9, first row at the bottom
(v = 0).
"""

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import zoom

Rgb = tuple[float, float, float]


def linear_from_hex(code: str) -> Rgb:
    """Linear Rec.709 of an sRGB colour written as six hexadecimal digits."""
    encoded = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    red, green, blue = np.clip(linear, 0.02, 0.9)
    return float(red), float(green), float(blue)


def jittered(colour: Rgb, rng: np.random.Generator, amount: float = 0.12) -> Rgb:
    """The colour with each channel scaled at random by up to `amount`, kept in 0.02..0.9."""
    red, green, blue = np.clip(
        np.array(colour) * (1.0 + rng.uniform(-amount, amount, 3)), 0.02, 0.9
    )
    return float(red), float(green), float(blue)


def noise(size: int, cells: int, rng: np.random.Generator, octaves: int = 4) -> np.ndarray:
    """Periodic fractal noise.

    Args:
        size: width and height in texels.
        cells: cells of the coarsest octave along a side.
        rng: source of randomness.
        octaves: each has twice the cells and half the height of the one before.

    Returns:
        (size, size) in 0..1.
    """
    total = np.zeros((size, size))
    for octave in range(octaves):
        grid = rng.random((cells * 2**octave,) * 2)
        padded = np.pad(grid, 4, mode="wrap")
        scale = size / grid.shape[0]
        fine = zoom(padded, scale, order=3, grid_mode=True, mode="nearest")
        start = round(4 * scale)
        total += fine[start : start + size, start : start + size] * 0.5**octave
    total -= total.min()
    return total / total.max()


def mixed(first: Rgb, second: Rgb, weight: np.ndarray) -> np.ndarray:
    """Linear blend: `first` where `weight` (H, W) is 0, `second` where it is 1."""
    blend = np.asarray(first) * (1.0 - weight[..., None]) + np.asarray(second) * weight[..., None]
    return np.clip(blend, 0.02, 0.9).astype(np.float32)


def checker(size: int, cells: int, first: Rgb, second: Rgb) -> np.ndarray:
    """Checkerboard of `cells` x `cells`, `first` in the corner at u = v = 0."""
    index = (np.arange(size) * cells) // size
    return mixed(first, second, ((index[:, None] + index[None, :]) % 2).astype(float))


def stripes(size: int, count: int, first: Rgb, second: Rgb, along_u: bool = False) -> np.ndarray:
    """`count` pairs of sharp stripes; rings of a lathe, or staves when `along_u`."""
    wave = (((np.arange(size) + 0.5) * 2 * count // size) % 2).astype(float)
    weight = np.broadcast_to(wave[None, :] if along_u else wave[:, None], (size, size))
    return mixed(first, second, weight)


def wood(size: int, dark: Rgb, light: Rgb, rng: np.random.Generator, planks: int = 1) -> np.ndarray:
    """Grain along u, in `planks` boards of differing tone with dark joints."""
    stretched = np.repeat(
        noise(size, 8, rng)[:, :: max(size // 64, 1)], max(size // 64, 1), axis=1
    )[:, :size]
    v = (np.arange(size)[:, None] + 0.5) / size
    grain = 0.5 + 0.5 * np.sin(2.0 * np.pi * (v * 9.0 * planks + 2.2 * stretched))
    board = (v * planks).astype(int)
    tone = rng.uniform(-0.25, 0.25, planks)[board]
    weight = np.clip(0.25 + 0.5 * grain + tone + 0.2 * (noise(size, 16, rng) - 0.5), 0.0, 1.0)
    joint = (np.abs(v * planks - np.round(v * planks)) < 0.035) & (planks > 1)
    return mixed(dark, light, np.where(joint, 0.0, weight))


def speckled(size: int, base: Rgb, spot: Rgb, share: float, rng: np.random.Generator) -> np.ndarray:
    """`base` with soft spots of `spot` covering about `share` of the area."""
    field = noise(size, 12, rng, octaves=3)
    threshold = np.quantile(field, 1.0 - share)
    return mixed(base, spot, np.clip((field - threshold) * 14.0, 0.0, 1.0))


def with_text(
    image: np.ndarray, lines: list[tuple[str, float, float, float]], ink: Rgb
) -> np.ndarray:
    """Prints text on a texture.

    Args:
        image: (H, W, 3).
        lines: for each text its centre u and v and its height, as shares of the picture.
        ink: colour of the letters.

    Returns:
        A new (H, W, 3) texture.
    """
    height, width = image.shape[:2]
    mask = Image.new("L", (width, height), 0)
    pen = ImageDraw.Draw(mask)
    for text, u, v, share in lines:
        font = ImageFont.load_default(size=share * height)
        pen.text((u * width, (1.0 - v) * height), text, fill=255, font=font, anchor="mm")
    weight = np.asarray(mask)[::-1, :, None] / 255.0
    return (image * (1.0 - weight) + np.asarray(ink) * weight).astype(np.float32)


def with_band(image: np.ndarray, low: float, high: float, colour: Rgb) -> np.ndarray:
    """Paints the rows with v in `low`..`high`."""
    painted = image.copy()
    rows = image.shape[0]
    painted[round(low * rows) : round(high * rows)] = colour
    return painted


def ground(kind: str, rng: np.random.Generator) -> Rgb | np.ndarray:
    """Base colour of the ground plate: one colour for "plain", a texture for "checker"."""
    grey = jittered((0.42, 0.40, 0.37), rng)
    if kind == "plain":
        return grey
    return checker(1024, 8, grey, jittered((0.16, 0.20, 0.24), rng))
