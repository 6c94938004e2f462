# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line: `python -m blender_scenes SCENE OUT [options]`, or `population DIR [options]`."""

import argparse
import json
import sys
from pathlib import Path

from blender_scenes import cache
from blender_scenes.command_line import carried_out, say
from blender_scenes.format import ToneMapping, capture_facts, write_capture
from blender_scenes.population import command
from blender_scenes.request import (
    DEFAULT_GROUND,
    GROUNDS,
    LIGHTS,
    NAMED_SCENES,
    PRESETS,
    SceneError,
    SceneRequest,
    fingerprint,
)
from blender_scenes.variation import parse
from blender_scenes.view_transform import VIEW_TRANSFORMS
from blender_scenes.wheel import wheel_version

POPULATION = "population"
"""In place of a scene: random captures, see `blender_scenes.population`."""


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line.

    Args:
        arguments: without the program's name; None takes those of the process.

    Returns:
        Exit code: 0 done, 2 a request that cannot be fulfilled, 130 interrupted.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == [POPULATION]:
        return command.main(words[1:])
    options = _parser().parse_args(words)
    return carried_out(lambda: _make(options), options.out)


def _make(options: argparse.Namespace) -> None:
    """Renders the capture that is asked for, unless it is there."""
    request = SceneRequest(
        scene=options.scene,
        ground=options.ground or DEFAULT_GROUND.get(options.scene, "plain"),
        light=options.light,
        preset=options.preset,
        hdri=options.hdri,
        asset=options.asset,
        resolution=options.resolution,
        views=options.views,
        test_views=options.test_views,
        samples=options.samples,
        seed=options.seed,
        variation=parse(options.vary),
    )
    tone = ToneMapping(options.view_transform, options.exposure)
    if _already_there(options.out, request, tone):
        say("already there, nothing to do")
    else:
        folder, rendered = cache.linear_renders(
            request, options.cache or cache.default_folder(), _report
        )
        write_capture(options.out, folder, tone)
        say(f"{rendered} views rendered now, the others taken from {folder}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m blender_scenes",
        description="Renders a capture with ground truth in Cycles.",
        epilog=f"python -m blender_scenes {POPULATION} --help: random captures, one a seed.",
    )
    add = parser.add_argument
    add("scene", choices=NAMED_SCENES, metavar="SCENE", help=", ".join(NAMED_SCENES))
    add("out", type=Path, metavar="OUT", help="folder to write the capture to")
    add("--ground", choices=GROUNDS, help="plate under the scene (truck: checker, others: plain)")
    add(
        "--light",
        choices=LIGHTS,
        default="lamp",
        help="sun lamp with a dim map, or a sun inside a map",
    )
    add("--hdri", type=Path, metavar="FILE", help="lat-long .hdr or .exr (one from the bpy wheel)")
    add("--asset", type=Path, metavar="FILE", help=".obj, .gltf or .glb of scene 'asset'")
    add("--view-transform", choices=VIEW_TRANSFORMS, default="Filmic")
    add(
        "--exposure",
        type=float,
        default=0.0,
        metavar="EV",
        help="stops added before the view transform",
    )
    add("--resolution", type=int, default=160, help="width and height in pixels (160)")
    add("--views", type=int, default=40, help="training views (40)")
    add("--test-views", type=int, default=8, help="test views, at other positions (8)")
    add("--samples", type=int, default=64, help="samples per pixel before denoising (64)")
    add(
        "--seed",
        type=int,
        default=0,
        help="decides layout, colours, cameras and light direction (0)",
    )
    add("--preset", choices=PRESETS, help="high_illumination: the lamp gives 90 %% of the light")
    add(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one departure from the scene, may be given more than once: sun_share, sun_size "
        "(degrees), suns, roughness, metallic, albedo (white, black), texture_scale, bounces, rods "
        "(radius)",
    )
    add(
        "--cache",
        type=Path,
        metavar="DIR",
        help=f"linear renders are kept here ({cache.default_folder()})",
    )
    return parser


def _already_there(out: Path, request: SceneRequest, tone: ToneMapping) -> bool:
    """Whether `out` holds this very capture; refuses a folder that holds anything else."""
    if out.exists() and not out.is_dir():
        raise SceneError(f"{out} is a file; name a folder")
    if not out.exists() or not any(out.iterdir()):
        return False
    description = out / "truth" / "scene.json"
    if not description.exists():
        raise SceneError(f"{out} is not empty and no capture; name a new folder or empty it")
    found = json.loads(description.read_text(encoding="utf-8"))
    wanted = {"fingerprint": fingerprint(request, wheel_version()), **capture_facts(tone)}
    differing = [name for name, value in wanted.items() if found.get(name) != value]
    if differing:
        raise SceneError(
            f"{out} holds another capture ({found.get('scene')}, {found.get('view_transform')}; "
            f"differs in {', '.join(differing)}); name a new folder"
        )
    return True


def _report(done: int, total: int) -> None:
    say(f"rendered {done}/{total}", ending="\n" if done == total else "\r")


if __name__ == "__main__":
    sys.exit(main())
