# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender work without a window: `python -m robir_addon.headless COMMAND OUT`.

`mesh FILE GLB` makes a mesh that `robir reconstruct --mesh` takes of one that only Blender reads.

Standard output carries JSON lines: {"progress": 0..1, "message": ...} while it works, and at the
end {"files": [...], "notes": [...]}. An error is one sentence on standard error. Exit codes:
0 done, 1 bug, 2 usage, 6 a file cannot be read, written or trusted, 130 interrupted.
"""

import argparse
import errno
import json
import math
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .blocks import MARK
from .capture.cameras import VIEW, capture_cameras, use_camera, use_close_up
from .capture.foreign_mesh import SUFFIXES, bound, convert, convert_apart
from .engine.errors import AddonError, RequestError, ResultError
from .gateway import JobPaths, file_in
from .relighting.lights import SHOWN_LIGHTS, found_environment, show_environment, turn_light
from .relighting.rendering import (
    ToneTable,
    cut_short,
    match_view_transform,
    prepare_scene,
    read_tone_table,
    render_still,
    set_threads,
    write_film,
)
from .result.asset import fill_simple_name, leave_machine, make_asset
from .result.importer import import_result, read_tone_curve
from .result.placing import points_of, stand

# set by who starts a command and keeps its standard input open for as long as it waits
_FOLLOWED = "ROBIR_FOLLOWED"
# last bytes of a whole compressed .blend: the mark of the table of its parts
_COMPRESSED_END = b"\xb1\xea\x92\x8f"
_Made = tuple[list[Path], tuple[str, ...]]  # files that a command wrote, and sentences for the user
_INTERRUPTED = 130
_DISK = 6
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = _parser().parse_args(arguments)
    with _own_standard_output() as reports, _ending_with_the_caller(reports):
        try:
            files, notes = options.command(options, reports)
        except (AddonError, OSError, RuntimeError) as error:
            if _is_of_the_disk(error):
                then = "try again" if options.command is convert_mesh else "continue with --resume"
                cure = f"make room or mend the folder, then {then}"
                sys.stderr.write(f"error: {' '.join(str(error).split())}; {cure}\n")
                return _DISK
            if not isinstance(error, AddonError):
                raise
            sys.stderr.write(f"error: {error}\n")
            return error.exit_code
        except KeyboardInterrupt:
            sys.stderr.write("interrupted\n")
            return _INTERRUPTED
        _say(reports, {"files": [str(file) for file in files], "notes": list(notes)})
    return 0


def _is_of_the_disk(error: BaseException) -> bool:
    """Whether a disk that is full or broken is behind an error; Blender tells it only in words."""
    link: BaseException | None = error
    while link is not None:
        words = str(link)
        if getattr(link, "errno", None) in _DISK_ERRORS:
            return True
        if any(os.strerror(number) in words for number in _DISK_ERRORS):
            return True
        link = link.__cause__ or link.__context__
    return False


@contextmanager
def _ending_with_the_caller(reports: TextIO) -> Iterator[None]:
    """Die with a caller that was killed: a run that goes on in its folder must not meet this one.

    At the end the reports are closed, upon which the caller closes standard input: Blender would
    wait for ever at its exit for a thread that still reads there.
    """
    if not os.environ.get(_FOLLOWED):
        yield
        return
    is_done = threading.Event()

    def wait() -> None:
        while os.read(0, 1):
            pass
        if not is_done.is_set():
            os._exit(_INTERRUPTED)

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_done.set()
        reports.close()
        thread.join()


def build_scene(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Make export/scene.blend of the exported files; textures and light are packed into it."""
    paths, scene, notes = _made_scene(options, reports)
    photos = {camera.data.background_images[0].image for camera in capture_cameras(scene)}
    for image in bpy.data.images:
        if image.source in ("FILE", "TILED") and image not in photos:
            image.pack()
    leave_machine(paths, paths.root.name)
    with _replacing_blend(paths.scene) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), compress=True, relative_remap=True)
    return [paths.scene], notes


def build_asset(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Make export/asset.blend: the object alone, marked as an asset, its origin at its foot."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _say(reports, {"progress": 0.0, "message": "making an asset for Blender's library"})
    paths = JobPaths(options.out.resolve())
    asset = import_result(paths.root, bpy.context.scene, use_sun_lamp=False).asset
    asset.name = paths.root.name
    make_asset(asset, paths, is_packed=options.pack)
    bpy.context.view_layer.update()  # the bounds of what is new are not known before
    stand(asset)
    data = asset.asset_data
    data.author, data.license = options.author, options.licence
    if options.catalogue:
        data.catalog_id = options.catalogue
    for tag in options.tag:
        data.tags.new(tag, skip_if_exists=True)
    fill_simple_name(data)
    leave_machine(paths, None)
    with _replacing_blend(paths.library_asset) as temporary:
        bpy.data.libraries.write(
            str(temporary), {asset}, path_remap="RELATIVE_ALL", fake_user=True, compress=True
        )
    return [paths.library_asset], ()


@contextmanager
def _replacing_blend(path: Path) -> Iterator[Path]:
    """A temporary path for a compressed .blend that replaces another once it is whole."""
    temporary = path.with_name(f".{path.stem}-{os.getpid()}.blend")
    try:
        yield temporary
        if not temporary.read_bytes().endswith(_COMPRESSED_END):
            raise cut_short(path)
        temporary.replace(path)
    except RuntimeError as fault:
        raise ResultError(f"{path} cannot be written: {fault}") from fault
    finally:
        temporary.unlink(missing_ok=True)


def render_views(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Render capture views of the exported files as they were photographed."""
    paths, scene = _scene_to_render(options, reports)
    cameras, table = _chosen_cameras(scene, options.views), _tone_table(paths)
    files = []
    for camera in _told(cameras, reports, lambda camera: f"rendering {camera[VIEW]}"):
        use_camera(scene, camera, options.max_side)
        files.append(_picture(paths.renders, f"rerender_{camera[VIEW]}.png"))
        render_still(scene, files[-1], table)
    return files, ()


def relight(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Render the result under another light: stills of the chosen views, or a turning light."""
    environment = found_environment(options.environment)
    paths, scene = _scene_to_render(options, reports)
    cameras, table = _chosen_cameras(scene, options.views), _tone_table(paths)
    if options.turntable:
        return _turntable(options, reports, environment, cameras[0]), ()
    show_environment(scene, scene.world, environment)
    turn_light(scene, math.radians(options.rotation))
    files = []
    text = f"relighting view {{}} with {environment.name}"
    for camera in _told(cameras, reports, lambda camera: text.format(camera[VIEW])):
        use_camera(scene, camera, options.max_side)
        files.append(_picture(paths.renders, f"relit_{environment.stem}_{camera[VIEW]}.png"))
        render_still(scene, files[-1], table)
    return files, ()


def picture_lights(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Small pictures of the object under the recovered light and each that Blender ships."""
    paths, scene = _scene_to_render(options, reports)
    table = _tone_table(paths)
    camera = _chosen_cameras(scene, "all")[0]
    use_close_up(scene, camera, _points_of_asset(scene), options.max_side)
    files = []
    for light, _, _ in _told(SHOWN_LIGHTS, reports, lambda shown: f"light {shown[1]}"):
        if light:
            show_environment(scene, scene.world, found_environment(Path(light)))
            turn_light(scene, 0.0)
        files.append(_picture(paths.renders, paths.light_picture(light).name))
        render_still(scene, files[-1], table)
    return files, ()


def convert_mesh(options: argparse.Namespace, reports: TextIO) -> _Made:
    """Make a GLB of a mesh file that only Blender reads."""
    _say(reports, {"progress": 0.0, "message": f"reading {options.file.name}"})
    if not options.within:
        return [options.out], convert_apart(options.file, options.out)
    bound(options.within)
    return [options.out], convert(options.file, options.out)


def _points_of_asset(scene: bpy.types.Scene) -> np.ndarray:
    """Vertices (N, 3) of the reconstructed object, world; none where it was taken out."""
    found = [np.empty((0, 3))]
    for item in scene.objects:
        if item.type == "MESH" and MARK in item:
            place = np.array(item.matrix_world)
            found.append(points_of(item) @ place[:3, :3].T + place[:3, 3])
    return np.concatenate(found)


def _turntable(
    options: argparse.Namespace, reports: TextIO, environment: Path, camera: bpy.types.Object
) -> list[Path]:
    """Frames of one full turn of the light, and a film of them."""
    scene, count = bpy.context.scene, options.turntable
    paths = JobPaths(options.out.resolve())
    renders, table = paths.renders, _tone_table(paths)
    name = f"turntable_{environment.stem}_{camera[VIEW]}"
    _picture(renders, name)
    use_camera(scene, camera, options.max_side)
    if options.side:
        grown = options.side / min(scene.render.resolution_x, scene.render.resolution_y)
        scene.render.resolution_x = round(grown * scene.render.resolution_x)
        scene.render.resolution_y = round(grown * scene.render.resolution_y)
    show_environment(scene, scene.world, environment)
    asset = next(o for o in scene.objects if o.type == "MESH" and MARK in o)
    start, middle, frames = asset.matrix_world.copy(), Vector(_points_of_asset(scene).mean(0)), []
    for index in _told(range(count), reports, lambda index: f"frame {index + 1} of {count}"):
        turn = 2.0 * math.pi * index / count
        if options.turns != "light":
            about = Matrix.Translation(middle) @ Matrix.Rotation(turn, 4, "Z")
            asset.matrix_world = about @ Matrix.Translation(-middle) @ start
        of_light = (options.turns != "object") * turn
        turn_light(scene, math.radians(options.rotation) + of_light)
        frames.append(renders / name / f"{index + 1:04d}.png")
        render_still(scene, frames[-1], table)
    film = renders / f"{name}.mp4"
    write_film(frames, film)
    return [*frames, film]


def _made_scene(
    options: argparse.Namespace, reports: TextIO
) -> tuple[JobPaths, bpy.types.Scene, tuple[str, ...]]:
    """The scene of the exported files: paths, the scene, sentences for the user.

    It is never read from scene.blend: a .blend is a program (compositor, drivers, shaders), and
    the folder may be a stranger's.
    """
    _say(reports, {"progress": 0.0, "message": "importing the asset"})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, paths = bpy.context.scene, JobPaths(options.out.resolve())
    import_result(paths.root, scene)
    notes = match_view_transform(scene, read_tone_curve(paths))
    prepare_scene(scene)
    return paths, scene, notes


def _scene_to_render(
    options: argparse.Namespace, reports: TextIO
) -> tuple[JobPaths, bpy.types.Scene]:
    paths, scene, _ = _made_scene(options, reports)
    scene.cycles.samples = options.samples
    set_threads(scene)
    return paths, scene


def _picture(folder: Path, name: str) -> Path:
    """A file of renders; views are named by the scene, which may have been tampered with."""
    try:
        return file_in(folder, name)
    except ValueError as fault:
        raise ResultError(f"a view of the scene cannot be rendered: {fault}") from fault


def _tone_table(paths: JobPaths) -> ToneTable | None:
    """The recovered curve where it is none of Blender's view transforms."""
    if read_tone_curve(paths)["blender_view_transform"]:
        return None
    return read_tone_table(paths.tone_lut)


def _chosen_cameras(scene: bpy.types.Scene, views: str) -> list[bpy.types.Object]:
    """Cameras for `--views`: "held_out", "train", "all", or names separated by commas."""
    if views == "all":
        chosen = capture_cameras(scene)
    elif views in ("held_out", "train"):
        chosen = capture_cameras(scene, views)
    else:
        by_name = {camera[VIEW]: camera for camera in capture_cameras(scene)}
        unknown = [name for name in views.split(",") if name not in by_name]
        if unknown:
            known = ", ".join(list(by_name)[:4])
            raise RequestError(f"no view is named {unknown[0]!r}; views are named like {known}")
        chosen = [by_name[name] for name in views.split(",")]
    if not chosen:
        raise RequestError(f"the capture has no {views} views; name views with --views A,B")
    return chosen


def _own_standard_output() -> TextIO:
    """A stream on the real standard output; what Blender itself prints there is dropped."""
    reports = os.fdopen(os.dup(1), "w", encoding="utf-8")
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    os.close(sink)
    return reports


def _say(reports: TextIO, line: dict[str, Any]) -> None:
    reports.write(json.dumps(line) + "\n")
    reports.flush()


def _told(items: Sequence[Any], reports: TextIO, message: Callable[[Any], str]) -> Iterator[Any]:
    """One after another, each with a line of progress."""
    for index, item in enumerate(items):
        _say(reports, {"progress": index / len(items), "message": message(item)})
        yield item


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m robir_addon.headless", description=str(__doc__).partition("\n")[0]
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    scene = commands.add_parser("scene", help="make export/scene.blend")
    scene.set_defaults(command=build_scene)
    render = commands.add_parser("render", help="render views of the capture again")
    render.set_defaults(command=render_views)
    light = commands.add_parser("relight", help="render under another light")
    light.set_defaults(command=relight)
    light.add_argument("--environment", type=Path, required=True, help=".exr, .hdr, or a name")
    light.add_argument("--rotation", type=float, default=0.0, help="degrees about the up axis")
    light.add_argument(
        "--turntable", type=int, default=0, metavar="N", help="frames of a full turn"
    )
    light.add_argument("--turns", choices=("light", "object", "both"), default="light")
    light.add_argument("--side", type=int, default=0, help="shorter side of the film, pixels")
    pictures = commands.add_parser("lights", help="small pictures under several lights")
    pictures.set_defaults(command=picture_lights)
    asset = commands.add_parser("asset", help="make export/asset.blend for Blender's library")
    asset.set_defaults(command=build_asset)
    for name in ("author", "licence", "catalogue"):
        asset.add_argument(f"--{name}", default="", help="catalogue: its UUID")
    asset.add_argument("--tag", action="append", default=[], help="may be given more than once")
    asset.add_argument("--pack", action="store_true", help="with its textures in the file")
    mesh = commands.add_parser("mesh", help="make a GLB of an FBX, USD or Alembic file")
    mesh.set_defaults(command=convert_mesh)
    mesh.add_argument("file", type=Path, metavar="FILE", help=", ".join(SUFFIXES))
    mesh.add_argument("out", type=Path, metavar="GLB", help="file to write")
    mesh.add_argument("--within", type=int, help=argparse.SUPPRESS)  # bytes; read it in here
    for command in (scene, render, light, pictures, asset):
        command.add_argument("out", type=Path, metavar="OUT", help="finished result folder")
    for command in (render, light):
        command.add_argument(
            "--views", default="held_out", help="held_out, train, all, or names with commas"
        )
    for command, side in ((render, 400), (light, 400), (pictures, 192)):
        command.add_argument("--samples", type=int, default=16, help="Cycles samples a pixel")
        command.add_argument("--max-side", type=int, default=side, help="longer side, pixels")
    return parser


if __name__ == "__main__":
    sys.exit(main())
