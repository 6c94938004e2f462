# SPDX-License-Identifier: Apache-2.0
"""Texture images of the asset, their islands grown so that filters never reach an empty texel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

from robir.errors import StorageError
from robir.evaluation.metrics import srgb_from_linear
from robir.jobs.paths import of_tile, replacing

Array = NDArray[np.floating[Any]]
Codes = NDArray[np.uint8]

_MARGIN_AT_2K = 8
_METAL = 0.02

# all files that export/textures may hold where there are no tiles
TEXTURES = (
    "albedo.png", "albedo.exr", "roughness.png", "metallic.png", "normal.png", "coverage.png",
    "uncertainty.png",
)  # fmt: skip
# standard error of log albedo that the brightest code of uncertainty.png stands for
UNCERTAINTY_AT_255 = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Textures:
    """The asset's textures, row 0 at v = 1, islands grown."""

    albedo_linear: Array  # (T, T, 3), linear Rec.709 in [0, 1]
    roughness: Array  # (T, T), perceptual, in [0, 1]
    metallic: Array | None  # (T, T) in [0, 1], or None if nothing is metal
    coverage: Array  # (T, T), share of the training views that saw the texel, in [0, 1]
    # (T, T), one standard error of the natural log of albedo, up to one factor a channel for the
    # whole object
    uncertainty: Array
    # 1 where what is no metal reflects as any paint, F0 = 0.04; 0 where it does not
    specular: float
    # (H, W, 3) codes of the tangent-space normal map that a handed-in mesh brought, green towards
    # larger v, or None
    normal_map: Codes | None = None


def grown(image: Array, inside: NDArray[np.bool_], margin: int) -> Array:
    """Continue islands of an image (T, T) or (T, T, C) into the empty texels about them.

    Each texel up to the margin takes the value of the nearest one `inside` (T, T). What lies
    further off takes the mean, so that small mip levels keep their tint.
    """
    if not inside.any():
        return image.copy()
    distance, nearest = distance_transform_edt(~inside, return_indices=True)
    filled = image[tuple(nearest)]
    filled[distance > margin] = image[inside].mean(axis=0)
    return filled


def finished_textures(arrays: dict[str, Array], num_views: int) -> Textures:
    """Grow the appearance stage's textures to what is shipped; without "specular" it is 1.

    Islands grow by 8 texels, more above 2048 texels a side. `num_views` is the unit of "coverage".
    """
    inside = arrays["inside"].astype(bool)
    margin = max(_MARGIN_AT_2K, round(_MARGIN_AT_2K * inside.shape[0] / 2048))

    def fill(name: str) -> Array:
        return grown(np.asarray(arrays[name], np.float32), inside, margin)

    has_metal = bool((arrays["metallic"][inside] > _METAL).any())
    return Textures(
        albedo_linear=np.clip(fill("albedo_linear"), 0.0, 1.0),
        roughness=np.clip(fill("roughness"), 0.0, 1.0),
        metallic=np.clip(fill("metallic"), 0.0, 1.0) if has_metal else None,
        coverage=np.clip(np.where(inside, arrays["coverage"] / max(num_views, 1), 0.0), 0.0, 1.0),
        uncertainty=np.maximum(np.where(inside, arrays["uncertainty"], 0.0), 0.0),
        specular=float(arrays.get("specular", 1.0)),
    )


def stored_normal_map(path: Path) -> Codes | None:
    """The normal map (H, W, 3) of the geometry stage, or None; a `StorageError` if damaged."""
    if not path.is_file():
        return None
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            return np.array(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as fault:
        raise StorageError(
            f"{path} cannot be read ({fault}). Run the geometry stage again."
        ) from fault


def write_textures(textures: Textures, folder: Path, tile: int | None = None) -> None:
    """Write the images of export/textures, of one tile where there are such.

    albedo.png is sRGB, albedo.exr linear half; roughness.png, metallic.png and normal.png are plain
    numbers ("Non-Color"); coverage.png is the share of views and uncertainty.png the standard error
    of log albedo, UNCERTAINTY_AT_255 at code 255.
    """
    metallic = None if textures.metallic is None else codes(textures.metallic)
    images = {
        "albedo.png": codes(srgb_from_linear(textures.albedo_linear)),
        "roughness.png": codes(textures.roughness),
        "metallic.png": metallic,
        "normal.png": textures.normal_map,
        "coverage.png": codes(textures.coverage),
        "uncertainty.png": codes(textures.uncertainty / UNCERTAINTY_AT_255),
    }
    for name, image in images.items():
        path = of_tile(folder / name, tile)
        if image is None:
            path.unlink(missing_ok=True)
        else:
            write_png(path, image)
    exr = of_tile(folder / "albedo.exr", tile)
    write_exr(exr, textures.albedo_linear.astype(np.float16))


def codes(values: Array) -> Codes:
    """Values in [0, 1] as 8-bit codes, rounded; others are clipped."""
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


def write_png(path: Path, image: Codes) -> None:
    """Write (H, W), (H, W, 3) or (H, W, 4) codes as PNG, atomically."""
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def write_exr(path: Path, image_linear: NDArray[Any]) -> None:
    """Write (H, W, 3) linear Rec.709 as a scan-line EXR of the array's own type, atomically."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {axis: np.ascontiguousarray(image_linear[..., i]) for i, axis in enumerate("RGB")}
    with replacing(path) as temporary:
        OpenEXR.File(header, planes).write(str(temporary))
