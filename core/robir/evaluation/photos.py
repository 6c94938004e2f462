# SPDX-License-Identifier: Apache-2.0
"""How well a re-render repeats a photograph, as displayed, and pictures side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from robir.capture.capture import View
from robir.evaluation import metrics
from robir.evaluation.layers import Layers
from robir.evaluation.surfaces import MeshCaster
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import replacing
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import MASK_INSIDE

Picture = NDArray[np.uint8]


def photo_scores(rerender: Picture, view: View) -> dict[str, float] | None:
    """PSNR and SSIM of a re-render's display values against the photograph, over its mask.

    The re-render (h, w, 3) or (h, w, 4), codes, may have any size; the photograph is reduced to it;
    what is transparent counts as black. Pixels that are wholly object count: those at the outline
    hold what lies behind it too, or have colours that were divided by their alpha. None where no
    pixel is.
    """
    height, width = rerender.shape[:2]
    ours = rerender[..., :3] / 255.0
    if rerender.shape[2] == 4:
        ours = ours * (rerender[..., 3:] / 255.0)
    photo = Image.fromarray(view.image_display)
    mask = Image.fromarray(view.mask)
    if photo.size != (width, height):
        photo = photo.resize((width, height), Image.Resampling.BOX)
        mask = mask.resize((width, height), Image.Resampling.BOX)
    inside = np.asarray(mask) > MASK_INSIDE
    if not inside.any():
        return None
    theirs = np.asarray(photo) / 255.0
    return {
        "psnr": metrics.psnr(ours[inside], theirs[inside]),
        "ssim": metrics.masked_ssim(ours, theirs, inside),
    }


def exposed(
    picture: Picture, steps: Sequence[float] | NDArray[np.float64], curve: AbstractToneCurve
) -> Picture:
    """Codes (H, W, 3 or 4) as a camera with stops (3,) or (H, W, 3) more shows them, by a curve."""
    display = torch.from_numpy(picture[..., :3].astype(np.float32) / 255)
    linear = curve.linear_from_display(display) * torch.from_numpy(
        2.0 ** np.asarray(steps, np.float32)
    )
    shown = curve.display_from_linear(linear).clamp(0, 1).numpy()
    return np.dstack([np.rint(255 * shown).astype(np.uint8), picture[..., 3:]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposures:
    """How the photographs of a capture were exposed and lit."""

    steps: Mapping[str, Sequence[float]]  # by view and channel, log2, brighter than the common one
    corner_steps: float  # by which the corners of all photographs are darker than their middle
    slope_steps: Mapping[str, Sequence[float]]  # brighter per unit of the normal, log2; or empty
    curve: AbstractToneCurve  # the tone curve under which this holds
    surface: MeshCaster | None  # of the object, where there are slopes; in the frame of the views

    @classmethod
    def of(
        cls, exposure: Mapping[str, Any], tone_curve: Mapping[str, Any], mesh: Mesh
    ) -> Exposures:
        """Of the contents of exposure.json and tone_curve.json; the mesh in the views' frame."""
        return cls(
            steps=exposure["steps"],
            corner_steps=exposure["corner_steps"],
            slope_steps=exposure["slope_steps"],
            surface=MeshCaster(mesh) if exposure["slope_steps"] else None,
            curve=curve_from_name(tone_curve["family"], tone_curve["parameters"]),
        )

    def as_photographed(self, picture: Picture, view: View) -> Picture:
        """A picture of a view, at the common exposure and any size, as its photograph was taken."""
        steps = self._steps(view, picture.shape[:2])
        return picture if steps is None else exposed(picture, steps, self.curve)

    def evened(self, view: View) -> View:
        """A photograph brought to the common exposure and light."""
        steps = self._steps(view, view.mask.shape)
        if steps is None:
            return view
        return replace(view, image_display=exposed(view.image_display, -steps, self.curve))

    def _steps(self, view: View, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
        """Steps (H, W, 3) of a view's pixels, None where there are none."""
        if view.name not in self.steps and not self.corner_steps:
            return None
        camera = view.camera.resized(shape[1], shape[0])
        off_axis = camera.off_axis(camera.pixel_centres()).reshape(shape)
        own = np.array(self.steps.get(view.name, [0.0, 0.0, 0.0]))
        steps = own - self.corner_steps * off_axis[..., None]
        if self.surface is not None and view.name in self.slope_steps:
            normal = self.surface.cast(camera).normal
            steps = steps + (normal @ np.array(self.slope_steps[view.name]))[..., None]
        return steps


def mean_scores(scores: list[dict[str, float] | None]) -> dict[str, Any]:
    """Means over views, with their number; None where nothing was scored."""
    known = [score for score in scores if score is not None]
    if not known:
        return {"psnr": None, "ssim": None, "views": 0}
    means = {name: float(np.mean([score[name] for score in known])) for name in ("psnr", "ssim")}
    return means | {"views": len(known)}


def read_picture(path: Path) -> Picture:
    """An image file as (H, W, 3) or (H, W, 4) codes."""
    with Image.open(path, formats=["PNG"]) as image:
        return np.array(image.convert("RGBA" if image.mode == "RGBA" else "RGB"))


Array = NDArray[np.floating[Any]]

MAX_SIDE = 320  # longer side of a picture that is cut to the object, pixels
_MARGIN = 1.08
_GAP = 4
_LABEL_HEIGHT = 26
BACKGROUND = 36  # code of the dark grey behind pictures


def display_codes(image_display: Array, hit: NDArray[np.bool_] | None = None) -> Picture:
    """Display values in [0, 1] as 8-bit codes, on dark grey where `hit` is false."""
    codes = np.round(np.clip(image_display, 0.0, 1.0) * 255.0).astype(np.uint8)
    if codes.ndim == 2:
        codes = np.repeat(codes[..., None], 3, axis=-1)
    if hit is not None:
        codes = np.where(hit[..., None], codes, np.uint8(BACKGROUND))
    return codes


def layer_pictures(layers: Layers, albedo_scale: Array | float = 1.0) -> dict[str, Picture]:
    """One view's albedo (sRGB-encoded), roughness (as is) and normals (half plus a half)."""
    return {
        "albedo": display_codes(
            metrics.srgb_from_linear(layers.albedo_linear * albedo_scale), layers.hit
        ),
        "roughness": display_codes(layers.roughness, layers.hit),
        "normals": display_codes(0.5 + 0.5 * layers.normal, layers.hit),
    }


def over_grey(picture: Picture) -> Picture:
    """RGBA codes (H, W, 4) on the sheet's dark grey, as (H, W, 3) codes."""
    rgba = picture.astype(np.float64)
    alpha = rgba[..., 3:] / 255.0
    return np.round(rgba[..., :3] * alpha + BACKGROUND * (1 - alpha)).astype(np.uint8)


def window(mask: Picture) -> Array:
    """Square about a mask with a margin: left, top, right, bottom in widths of the picture."""
    height, width = mask.shape
    rows, columns = np.nonzero(mask > 127)
    if len(rows) == 0:
        rows, columns = np.array([0, height - 1]), np.array([0, width - 1])
    low = np.array([columns.min(), rows.min()], float)
    high = np.array([columns.max(), rows.max()], float) + 1.0
    half = 0.5 * _MARGIN * (high - low).max()
    middle = 0.5 * (low + high)
    return np.concatenate([middle - half, middle + half]) / width


def cut(picture: Picture, frame: Array, side: int = MAX_SIDE) -> Picture:
    """The window of a picture of any size, RGBA; transparent where it reaches beyond it."""
    box = np.round(frame * picture.shape[1]).astype(int).tolist()
    return thumbnail(np.asarray(Image.fromarray(picture).convert("RGBA").crop(box)), side)


def thumbnail(picture: Picture, side: int = MAX_SIDE) -> Picture:
    """The picture at no more than the page can show."""
    image = Image.fromarray(picture)
    image.thumbnail((side, side))
    return np.asarray(image)


def save_sheet(path: Path, rows: Sequence[dict[str, Picture]]) -> None:
    """Write rows of labelled pictures (H, W, 3), codes, as one PNG, all as high as the tallest."""
    height = max(picture.shape[0] for row in rows for picture in row.values())
    height = max(height, 160)
    labels = list(rows[0])
    tiles = [[_to_height(row[label], height) for label in labels] for row in rows]
    widths = [max(line[i].width for line in tiles) for i in range(len(labels))]
    size = (sum(widths) + _GAP * (len(widths) + 1), _LABEL_HEIGHT + len(rows) * (height + _GAP))
    sheet = Image.new("RGB", size, (BACKGROUND,) * 3)
    draw = ImageDraw.Draw(sheet)
    x = _GAP
    for column, label in enumerate(labels):
        draw.text((x + 2, 5), label, fill=(225, 225, 225), font=ImageFont.load_default(14))
        for row, line in enumerate(tiles):
            sheet.paste(line[column], (x, _LABEL_HEIGHT + row * (height + _GAP)))
        x += widths[column] + _GAP
    with replacing(path) as temporary:
        sheet.save(temporary, format="PNG")


def _to_height(picture: Picture, height: int) -> Image.Image:
    image = Image.fromarray(picture)
    if image.height == height:
        return image
    width = round(image.width * height / image.height)
    return image.resize((width, height), Image.Resampling.LANCZOS)
