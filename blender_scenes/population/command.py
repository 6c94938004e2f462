# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m blender_scenes population DIR`: renders the captures of a range of seeds."""

import argparse
import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from blender_scenes import cache
from blender_scenes.command_line import carried_out, say
from blender_scenes.format import read_view, write_capture
from blender_scenes.photographs import stock
from blender_scenes.population import ranges
from blender_scenes.population.draw import Drawn, Sources, draw
from blender_scenes.population.exposing import held
from blender_scenes.population.facts import classes
from blender_scenes.population.photo_draw import draw_photographs
from blender_scenes.request import SceneError, fingerprint
from blender_scenes.wheel import data_folder, wheel_version

RENDERS = ".renders"
"""Folder beside the captures where linear renders grow until a capture is whole."""


def main(arguments: Sequence[str]) -> int:
    """Runs the command line.

    Args:
        arguments: those after `population`.

    Returns:
        Exit code: 0 done, 2 a request that cannot be fulfilled, 130 interrupted.
    """
    options = _parser().parse_args(arguments)
    seeds = range(options.seed, options.seed + options.count)
    if seeds and seeds[-1] >= ranges.VERDICT_SEED:
        say(
            f"seeds from {ranges.VERDICT_SEED} on are for verdicts: run them to report, never to "
            "choose or to tune by"
        )

    def render() -> None:
        sources = Sources(_files(options.assets, ("obj", "gltf", "glb")), _maps(options.hdris))
        for number, seed in enumerate(seeds, 1):
            make = _make_photographs if options.photographs else _make
            say(f"{number}/{len(seeds)} {make(options.out, seed, sources)}")

    return carried_out(render, options.out)


def capture_name(seed: int) -> str:
    """Name of a capture's folder, "seed_0007"."""
    return f"seed_{seed:04d}"


def _make(folder: Path, seed: int, sources: Sources) -> str:
    """Renders the capture of a seed unless it is there; what became of it, in words."""
    out = folder / capture_name(seed)
    drawn = draw(seed, sources)
    wanted = fingerprint(drawn.request, wheel_version())
    if _is_there(out, wanted):
        return f"{out.name}: already there"
    start = time.process_time()
    rendered, _ = cache.linear_renders(drawn.request, folder / RENDERS, _progress)
    views = [read_view(file) for file in sorted((rendered / "train").glob("r_*.exr"))]
    tone = held(views, drawn.tone)
    scene = json.loads((rendered / "scene.json").read_text(encoding="utf-8"))
    more = {"classes": classes(drawn, scene, views), "recipe": _recipe(drawn)}
    write_capture(out, rendered, tone, more)
    shutil.rmtree(rendered)
    _tidy(folder)
    return f"{out.name}: {time.process_time() - start:.0f} CPU-s, {_words(drawn)}"


def _make_photographs(folder: Path, seed: int, sources: Sources) -> str:
    """The same of the half that is photographs."""
    out = folder / capture_name(seed)
    recipe = draw_photographs(seed, sources)
    if _is_there(out, stock.fingerprint(recipe)):
        return f"{out.name}: already there"
    start = time.process_time()
    stock.make(out, folder / RENDERS, recipe, _progress)
    _tidy(folder)
    frame, handover = recipe.frame, recipe.handover
    return (
        f"{out.name}: {time.process_time() - start:.0f} CPU-s, {recipe.thing.kind}, "
        f"{recipe.light.kind}, {recipe.walk.photographs} photographs of {frame.width} x "
        f"{frame.height}, poses {handover.poses}, masks {handover.masks}"
    )


def _is_there(out: Path, wanted: str) -> bool:
    """Whether a capture of a fingerprint is there; one of another is refused."""
    if not out.exists():
        return False
    scene = json.loads((out / "truth" / "scene.json").read_text(encoding="utf-8"))
    if scene["fingerprint"] != wanted:
        raise SceneError(
            f"{out} was made from another table, program or set of files; name a new folder"
        )
    return True


def _tidy(folder: Path) -> None:
    """Removes the folder of renders once nothing grows there."""
    if not any((folder / RENDERS).iterdir()):
        (folder / RENDERS).rmdir()


def _progress(done: int, total: int) -> None:
    say(f"rendered {done}/{total}", ending="\r")


def _recipe(drawn: Drawn) -> dict:
    """The recipe as JSON values, files by their names."""
    return json.loads(json.dumps(asdict(drawn.recipe), default=lambda path: path.name))


def _words(drawn: Drawn) -> str:
    request = drawn.request
    return (
        f"{drawn.thing}, {request.views} views of {request.resolution} pixels, "
        f"{request.samples} samples"
    )


def _files(folder: Path | None, suffixes: Sequence[str]) -> tuple[Path, ...]:
    """All files of some kinds below a folder, in order of their paths."""
    if folder is None:
        return ()
    if not folder.is_dir():
        raise SceneError(f"{folder}: no such folder")
    return tuple(sorted(f for f in folder.rglob("*") if f.suffix.lower()[1:] in suffixes))


def _maps(folder: Path | None) -> tuple[Path, ...]:
    """The maps that are given, then those that Blender ships."""
    return (*_files(folder, ("hdr", "exr")), *_files(data_folder("studiolights/world"), ("exr",)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m blender_scenes population",
        description="Renders random captures with truth, one a seed, named seed_0000 and so on.",
        epilog="What is drawn, and how often, stands in blender_scenes/population/ranges.py.",
    )
    add = parser.add_argument
    add("out", type=Path, metavar="DIR", help="folder of the captures; those there are kept")
    add("--count", type=_count, required=True, metavar="N", help="how many captures")
    add(
        "--seed",
        type=_count,
        required=True,
        metavar="S",
        help=f"the first seed; below {ranges.VERDICT_SEED} for development, above for verdicts",
    )
    add(
        "--photographs",
        action="store_true",
        help="photographs as a hand-held camera takes them, instead of renderings",
    )
    add(
        "--assets",
        type=Path,
        metavar="DIR",
        help="folder of .obj, .gltf and .glb files to draw from",
    )
    add(
        "--hdris",
        type=Path,
        metavar="DIR",
        help="folder of .hdr and .exr maps, beside Blender's own",
    )
    return parser


def _count(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return number
