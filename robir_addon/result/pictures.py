# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures as display codes 0..1, row 0 at the bottom, RGBA, straight alpha; captions over them.

The engine puts photograph, re-render, albedo and roughness of a view beside each other.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import blf
import bpy
import numpy as np

from ..blocks import MARK, load_image
from ..engine.errors import ResultError
from ..gateway import JobPaths

_PICTURES = 4  # of a comparison


def compared_views(paths: JobPaths) -> list[str]:
    """Names of the views whose pictures the engine has put beside each other."""
    before, after = paths.comparison("*").name.split("*")
    found = sorted(file.name for file in paths.renders.glob(f"{before}*{after}"))
    return [name.removeprefix(before).removesuffix(after) for name in found]


def compare(paths: JobPaths, view: str = "") -> tuple[str, np.ndarray]:
    """Name and pictures, (H, 4 H, 4) beside each other, of a view ("": the first there is)."""
    known = compared_views(paths)
    chosen = view or next(iter(known), "")
    if chosen not in known:
        names = ", ".join(known) or "none; export the result again"
        text = "view {view!r} has no pictures to compare; choose one of: {known}"
        raise ResultError(text, view=chosen, known=names)
    file = paths.comparison(chosen)
    return chosen, _read_once(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=1)
def _read_once(file: Path, _changed: int) -> np.ndarray:
    """The comparison shown last: a wipe that is dragged asks for it again and again."""
    codes = read_codes(file)
    codes.setflags(write=False)
    return codes


def one_of(codes: np.ndarray, number: int) -> np.ndarray:
    """The photograph (0), re-render, albedo or roughness (3) of a comparison, (H, W, 4)."""
    return np.split(codes, _PICTURES, axis=1)[number]


def wiped(codes: np.ndarray, number: int, share: float) -> np.ndarray:
    """(H, W, 4) the photograph up to a share of the width, there another of the pictures."""
    photograph, over = one_of(codes, 0), one_of(codes, number).copy()
    edge = round(share * over.shape[1])
    over[:, :edge] = photograph[:, :edge]
    over[:, max(0, edge - 1) : edge] = 1.0
    return over


def read_codes(file: Path) -> np.ndarray:
    """An 8-bit picture file as it is stored, (H, W, 4)."""
    image = load_image(file, "Non-Color", "")  # the numbers as they are
    try:
        width, height = image.size
        codes = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(codes)
    finally:
        bpy.data.images.remove(image)
    return codes.reshape(height, width, 4)


def put_image(name: str, codes: np.ndarray, mark: str) -> bpy.types.Image:
    """Make codes (H, W, 4) an image of a result; editors that show it show the new picture."""
    height, width = codes.shape[:2]
    image = bpy.data.images.get(name)
    if image is None or image.source != "GENERATED" or MARK not in image:
        image = bpy.data.images.new(name, width, height, alpha=True)
    elif tuple(image.size) != (width, height):
        image.scale(width, height)
    image[MARK] = mark
    image.pixels.foreach_set(np.ascontiguousarray(codes, np.float32).ravel())
    image.update()
    return image


def show_image(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """Show an image in an Image Editor that is open, else in a window of its own."""
    if bpy.app.background:
        return
    manager = context.window_manager
    window, area = _image_editor(manager)
    if area is None:
        known = set(manager.windows)
        bpy.ops.wm.window_new()
        window = next(w for w in manager.windows if w not in known)
        area = window.screen.areas[0]
        area.type = "IMAGE_EDITOR"
    area.spaces.active.image = image
    region = next(r for r in area.regions if r.type == "WINDOW")
    with context.temp_override(window=window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)


def _image_editor(
    manager: bpy.types.WindowManager,
) -> tuple[bpy.types.Window | None, bpy.types.Area | None]:
    for window in manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and area.ui_type == "IMAGE_EDITOR":
                return window, area
    return None, None


# custom property of an image: its title and the names of its pictures from left to right, one a
# line
CAPTIONS = "robir_captions"
_SIZE = 13.0
_GAP = 8.0
_handles: list[Any] = []


def _draw() -> None:
    context = bpy.context
    image = context.space_data.image
    if image is None or CAPTIONS not in image:
        return
    title, *names = image[CAPTIONS].splitlines()
    scale = context.preferences.system.ui_scale
    to_region = context.region.view2d.view_to_region
    blf.size(0, _SIZE * scale)
    blf.color(0, *context.preferences.themes[0].image_editor.space.text_hi, 1.0)
    for place, name in enumerate(names):
        x, y = to_region((place + 0.5) / len(names), 0.0, clip=False)
        _write(name, x, y - (_GAP + _SIZE) * scale)
    x, y = to_region(0.5, 1.0, clip=False)
    _write(title, x, y + _GAP * scale)


def _write(text: str, middle: float, bottom: float) -> None:
    blf.position(0, middle - 0.5 * blf.dimensions(0, text)[0], bottom, 0.0)
    blf.draw(0, text)


def register() -> None:
    """Draw over Image Editors; without a window there is nothing to draw on."""
    if not bpy.app.background:
        space = bpy.types.SpaceImageEditor
        _handles.append(space.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Draw no more."""
    while _handles:
        bpy.types.SpaceImageEditor.draw_handler_remove(_handles.pop(), "WINDOW")
