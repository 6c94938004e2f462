# SPDX-License-Identifier: GPL-3.0-or-later
"""The recovered tone curve as view transform or as a table; Cycles settings, stills and films."""

import errno
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import ResultError, Sentence
from ..words import told

# a light that goes round in 48 frames then takes four seconds: shadows can be followed
FRAMES_PER_SECOND = 12
_SIGNATURE_BYTES = 8
# chunks of a PNG that hold words, dates and the like
_NOTES = (b"tEXt", b"zTXt", b"iTXt", b"tIME", b"eXIf")
_END = b"\0\0\0\0IEND\xaeB`\x82"


def match_view_transform(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> tuple[str, ...]:
    """Show the scene as the photographs do; a sentence where this Blender has no such curve."""
    wanted, settings = tone_curve["blender_view_transform"], scene.view_settings
    settings.look = "None"
    settings.exposure = tone_curve["exposure"]
    try:
        settings.view_transform = wanted or "Standard"
    except TypeError:  # not in this Blender's list
        settings.view_transform, wanted = "Standard", None
    settings.gamma = tone_curve["blender_gamma"] if wanted else 1.0
    if wanted:
        return ()
    return (
        Sentence(
            "the recovered tone curve ({family}) is none of Blender's view transforms: the "
            "viewport shows Standard; rendered files go through export/tone_curve.cube",
            family=tone_curve["family"],
        ),
    )


def view_transform_differs(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> bool:
    """Whether the scene is shown through another curve than the photographs."""
    settings, named = scene.view_settings, tone_curve["blender_view_transform"]
    if (settings.view_transform, settings.look) != (named or "Standard", "None"):
        return True
    gamma = tone_curve["blender_gamma"] if named else 1.0
    distance = max(abs(settings.exposure - tone_curve["exposure"]), abs(settings.gamma - gamma))
    return distance > 1e-4


def view_name(tone_curve: dict[str, Any]) -> str:
    """The recovered curve in the terms of Blender's colour management."""
    named, gamma = tone_curve["blender_view_transform"], tone_curve["blender_gamma"]
    if not named:
        return told("another curve")
    return named if gamma == 1.0 else told("{name} with gamma {gamma:g}", name=named, gamma=gamma)


@dataclass(frozen=True)
class ToneTable:
    """A two-part .cube file: a curve a channel, then a lattice over its output."""

    reach: float  # largest linear value of the shaper; more is cut off
    shaper: np.ndarray  # (N, 3) curves over 0..reach
    lattice: np.ndarray  # (M, M, M, 3) codes, indexed [blue, green, red] over the shaper's 0..1

    def display(self, linear: np.ndarray) -> np.ndarray:
        """Display codes 0..1 of linear Rec.709 values (..., 3)."""
        grid = np.linspace(0.0, self.reach, len(self.shaper))
        shaped = [np.interp(linear[..., c], grid, self.shaper[:, c]) for c in range(3)]
        last = len(self.lattice) - 1
        place = np.clip(np.stack(shaped, axis=-1), 0.0, 1.0) * last
        low = np.minimum(place.astype(np.int64), last - 1)
        part = place - low
        total = np.zeros(linear.shape)
        for corner in range(8):
            step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
            red, green, blue = np.moveaxis(low + step, -1, 0)
            weight = np.prod(np.where(step == 1, part, 1.0 - part), axis=-1)
            total += weight[..., None] * self.lattice[blue, green, red]
        return np.clip(total, 0.0, 1.0)


def read_tone_table(path: Path) -> ToneTable:
    """Read a tone_curve.cube of RobIR's."""
    header: dict[str, list[str]] = {}
    rows = []
    try:
        for line in path.read_text(encoding="ascii").splitlines():
            words = line.split()
            if not words or words[0] == "#":
                continue
            if words[0].startswith("LUT_"):
                header[words[0]] = words[1:]
            else:
                rows.append([float(word) for word in words])
        count, size = int(header["LUT_1D_SIZE"][0]), int(header["LUT_3D_SIZE"][0])
        values = np.array(rows)
        return ToneTable(
            reach=float(header["LUT_1D_INPUT_RANGE"][1]),
            shaper=values[:count],
            lattice=values[count:].reshape(size, size, size, 3),
        )
    except (OSError, ValueError, KeyError, IndexError) as fault:
        text = "{file} cannot be read as a tone curve ({fault}); export the result again"
        raise ResultError(text, file=path, fault=fault) from fault


def prepare_scene(scene: bpy.types.Scene) -> None:
    """Settings under which an imported result renders like its photographs, repeatably."""
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples = 64
    cycles.use_adaptive_sampling = False
    cycles.seed = 0
    cycles.use_animated_seed = False
    # a pixel is the mean over its own square, as on a sensor
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    try:
        cycles.denoiser = "OPENIMAGEDENOISE"
    except TypeError:  # some distributions build Blender without it
        cycles.use_denoising = False
    else:
        cycles.use_denoising = True
        cycles.denoising_prefilter = "NONE"
        cycles.denoising_quality = "FAST"
    render = scene.render
    render.film_transparent = True
    render.dither_intensity = 0.0
    render.use_persistent_data = True


def set_threads(scene: bpy.types.Scene) -> None:
    """Keep to the thread count that the environment gives, if it does."""
    threads = os.environ.get("OMP_NUM_THREADS", "")
    if threads.isdigit() and int(threads) > 0:
        scene.render.threads_mode = "FIXED"
        scene.render.threads = int(threads)


def render_still(scene: bpy.types.Scene, path: Path, table: ToneTable | None = None) -> None:
    """Render the camera to a PNG by a tone curve, or the view transform; the file appears whole."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5: must come before the file format
        settings.media_type = "IMAGE"
    settings.file_format = "PNG" if table is None else "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "8" if table is None else "32"
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}-{os.getpid()}.png")
    raw = temporary.with_suffix(".exr")
    scene.render.filepath = str(temporary if table is None else raw)
    try:
        bpy.ops.render.render(write_still=True, scene=scene.name)
        if table is not None:
            _develop(raw, temporary, table)
        _strip(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
        raw.unlink(missing_ok=True)


def cut_short(path: Path) -> OSError:
    """What is wrong with a file that Blender wrote without a complaint, and only in part."""
    return OSError(errno.EIO, "only a part of it could be written", str(path))


def _strip(path: Path) -> None:
    """Take Blender's notes out of a PNG: whose folder it was rendered in, when, and how long."""
    content = path.read_bytes()
    if not content.endswith(_END):
        raise cut_short(path)
    kept, at = [content[:_SIGNATURE_BYTES]], _SIGNATURE_BYTES
    while at < len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        end = at + 12 + size
        if kind not in _NOTES:
            kept.append(content[at:end])
        at = end
    path.write_bytes(b"".join(kept))


def _develop(raw: Path, path: Path, table: ToneTable) -> None:
    """Turn a linear render into a PNG of straight display codes."""
    linear = bpy.data.images.load(str(raw))
    linear.colorspace_settings.name = "Non-Color"  # the numbers as they are
    width, height = linear.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    linear.pixels.foreach_get(pixels)
    bpy.data.images.remove(linear)
    pixels = pixels.reshape(-1, 4)
    alpha = pixels[:, 3:]
    # the renderer multiplies by coverage; the curve is for the surface alone
    straight = pixels[:, :3] / np.maximum(alpha, 1e-6)
    codes = np.concatenate([table.display(np.where(alpha > 0, straight, 0.0)), alpha], axis=1)
    shown = bpy.data.images.new("shown", width, height, alpha=True)  # bytes: codes as they are
    shown.pixels.foreach_set(codes.ravel().astype(np.float32))
    shown.file_format = "PNG"
    shown.filepath_raw = str(path)
    shown.save()
    bpy.data.images.remove(shown)


def write_film(frames: list[Path], path: Path) -> None:
    """Join PNG frames to an H.264 film with Blender's own ffmpeg; the file appears whole."""
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    scene = bpy.data.scenes.new("film")
    try:
        scene.view_settings.view_transform = "Standard"  # the frames are display-referred already
        picture = bpy.data.images.load(str(frames[0]))
        # H.264 wants even sides
        scene.render.resolution_x, scene.render.resolution_y = (s + s % 2 for s in picture.size)
        bpy.data.images.remove(picture)
        scene.frame_start, scene.frame_end = 1, len(frames)
        scene.render.fps = FRAMES_PER_SECOND
        editor = scene.sequence_editor_create()
        strips = editor.strips if hasattr(editor, "strips") else editor.sequences
        strip = strips.new_image("frames", str(frames[0]), 1, 1)
        for frame in frames[1:]:
            strip.elements.append(frame.name)
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "VIDEO"
        settings.file_format = "FFMPEG"
        scene.render.ffmpeg.format = "MPEG4"
        scene.render.ffmpeg.codec = "H264"
        scene.render.ffmpeg.constant_rate_factor = "HIGH"
        scene.render.filepath = str(temporary)
        scene.render.use_file_extension = False
        bpy.ops.render.render(animation=True, scene=scene.name)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
        bpy.data.scenes.remove(scene)
