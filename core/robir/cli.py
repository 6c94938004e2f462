# SPDX-License-Identifier: Apache-2.0
"""The command line: `robir reconstruct|batch|check|relight|evaluate|selftest`, and `robir_bench`'s.

Standard output carries the result alone (a path, or JSON where asked for); progress and messages
go to standard error. Exit codes: 0 done, 1 bug, 2 usage, 3 capture rejected, 4 no usable device or
out of memory, 5 the fit failed its own quality check, 6 a file of the result cannot be read,
written or trusted, 130 cancelled.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec

from robir import __version__, commands
from robir.arguments import (
    add_constant,
    asset_formats,
    finite,
    path_argument,
    positive,
    refuse_lost_folder,
    stage_range,
    up_to,
)
from robir.errors import CancelledError, RobirError, StorageError
from robir.jobs.paths import STAGES
from robir.streams import make_patient, output_fault

_log = logging.getLogger("robir")

_EXIT_CODES = (
    "exit codes: 0 done, 1 bug, 2 usage, 3 capture rejected, 4 no usable device or out of memory, "
    "5 the fit failed its own quality check, 6 a file of the result cannot be read, written or "
    "trusted, 130 cancelled"
)

_CAPTURE = "folder of posed images or photographs, or a video"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, of given words or those of the process; its exit code."""
    # Idle OpenMP threads that spin count as CPU seconds, and matrix products come out otherwise on
    # other numbers of threads. Both must be set before NumPy and torch load.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.captureWarnings(True)
    for logger in (_log, logging.getLogger("py.warnings")):
        logger.setLevel(logging.INFO)
        logger.propagate = False
        logger.addHandler(logging.NullHandler())
    if arguments is None:  # else a caller has streams of its own
        make_patient()
        # such as a half-written archive that cannot be closed: the fault itself is told
        sys.unraisablehook = lambda found: _log.info("in %r: %s", found.object, found.exc_value)
    options = _parser().parse_args(arguments)
    try:
        refuse_lost_folder()
        code = options.command(options)
        if fault := output_fault():
            raise StorageError(f"standard output cannot be written: {fault}")  # noqa: TRY301
        return code
    except RobirError as error:
        return _fail(options, str(error), error.exit_code)
    except KeyboardInterrupt:
        return _fail(options, "stopped", CancelledError.exit_code)
    except Exception as error:
        if fault := commands.fault_of_folder(options, error):
            return _fail(options, str(fault), fault.exit_code)
        return _fail(options, commands.describe_bug(options, error), 1)


def _fail(options: argparse.Namespace, message: str, exit_code: int) -> int:
    commands.show_failure(options, message, exit_code)
    return exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="robir",
        description="Photographs in, a relightable Blender asset out.",
        epilog=_EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=f"robir {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_reconstruct(subparsers)
    _add_batch(subparsers)
    _add_check(subparsers)
    _add_relight(subparsers)
    _add_evaluate(subparsers)
    _add_selftest(subparsers)
    if find_spec("robir_bench") is not None:
        # a package beside this one, which the panel does not install
        import_module("robir_bench.command").add_to(subparsers)
    return parser


def _add_reconstruct(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "reconstruct", help="make an asset from a capture", epilog=_EXIT_CODES
    )
    parser.set_defaults(command=commands.reconstruct)
    parser.add_argument("capture", type=path_argument, metavar="CAPTURE", help=_CAPTURE)
    parser.add_argument("-o", "--out", type=path_argument, required=True, help="result folder")
    parser.add_argument("--device", choices=("cpu", "cuda", "auto"), default="auto")
    parser.add_argument(
        "--config", type=path_argument, metavar="FILE", help="TOML file of changed settings"
    )
    _add_set(parser)
    add_constant(parser)
    parser.add_argument(
        "--masks", type=path_argument, metavar="DIR", help="masks named like the images"
    )
    parser.add_argument(
        "--mesh",
        type=path_argument,
        metavar="FILE",
        help="take this mesh, in the capture's frame, or in any for photographs alone, instead of "
        "reconstructing one: .glb, .gltf, .obj, .ply, .stl or .off (of .fbx, .abc and USD, Blender "
        "makes a .glb first)",
    )
    parser.add_argument(
        "--fit-mesh",
        action="append_const",
        const="geometry.fit_mesh=true",
        dest="assignments",
        help="turn, scale and shift the mesh to where the photographs show it",
    )
    parser.add_argument("--seed", type=int, help="seed of all random numbers, default 0")
    parser.add_argument(
        "--threads", type=positive, help="cores to work on, default all; the result is the same"
    )
    parser.add_argument(
        "--asset",
        type=path_argument,
        metavar="FILE",
        help="also make an asset for Blender's library, with the author, licence, tags and "
        "catalogue that this TOML file names",
    )
    parser.add_argument(
        "--until",
        choices=STAGES,
        default=STAGES[-1],
        help="end after this stage; --resume goes on from there, here or on another machine",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on in an unfinished result folder, by its own settings but for those given",
    )
    parser.add_argument(
        "--defaults",
        action="store_true",
        help="with --resume: start from the defaults, not from the folder's own settings",
    )
    _add_progress(parser)


def _add_batch(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "batch", help="make a library of assets from many captures", epilog=_EXIT_CODES
    )
    parser.set_defaults(command=commands.batch)
    parser.add_argument(
        "sources",
        nargs="*",
        metavar="PLAN.toml | CAPTURE",
        help="a plan, or captures, also with *; none goes on with the library's own plan",
    )
    parser.add_argument(
        "-o", "--out", type=path_argument, required=True, metavar="LIBRARY", help="results' folder"
    )
    _add_set(parser)
    parser.add_argument(
        "--format",
        type=asset_formats,
        metavar="LIST",
        help="what LIBRARY offers of each result, with commas: glb, usd, and blend, which makes it "
        "an asset of Blender's library; default glb,blend",
    )
    parser.add_argument(
        "--on",
        choices=("local", "openjd", "slurm"),
        default="local",
        help="who works: this machine (default), a render farm by an Open Job Description bundle, "
        "or Slurm",
    )
    parser.add_argument(
        "--jobs",
        type=positive,
        help="most captures at a time; default: one a core",
    )
    parser.add_argument(
        "--memory", metavar="SIZE", help="what all may need together, such as 8G; default: free now"
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on with what LIBRARY's plan still lacks"
    )
    parser.add_argument("--page", action="store_true", help="only draw the contact sheet anew")
    _add_farm(parser)
    _add_progress(parser)


def _add_farm(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--split",
        action="store_true",
        help="on a farm: what comes before and after the fit of the surface are tasks of their "
        "own, so that the fit alone asks for a GPU",
    )
    parser.add_argument(
        "--fit-queue", metavar="PARTITION", help="Slurm's partition for the fit, with --split"
    )
    parser.add_argument(
        "--task", type=int, metavar="N", help="only capture N of LIBRARY's plan, for farms"
    )
    parser.add_argument(
        "--stages",
        type=stage_range,
        default=(STAGES[0], STAGES[-1]),
        metavar="FIRST-LAST",
        help="with --task: only these stages, once those before them are done, for farms",
    )
    parser.add_argument(
        "--captures",
        type=path_argument,
        metavar="DIR",
        help="folder of the captures, where it is not where it was",
    )


def _add_check(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser("check", help="look at a capture before time is spent on it")
    parser.set_defaults(command=commands.check)
    parser.add_argument("capture", type=path_argument, metavar="CAPTURE", help=_CAPTURE)
    _add_set(parser)
    parser.add_argument(
        "--masks", type=path_argument, metavar="DIR", help="masks named like the images"
    )
    parser.add_argument("--json", action="store_true", help="findings as JSON on standard output")
    _add_progress(parser)


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="assignments",
        metavar="SECTION.KEY=VALUE",
        help="change one setting; may be given more than once",
    )
    parser.add_argument(
        "--skip-missing",
        action="append_const",
        const="capture.missing=skip",
        dest="assignments",
        help="do without photographs that have a pose but are not there",
    )


def _add_relight(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser("relight", help="render a result under another light in Cycles")
    parser.set_defaults(command=commands.relight)
    parser.add_argument("out", type=path_argument, metavar="OUT", help="finished result folder")
    parser.add_argument(
        "--environment",
        required=True,
        metavar="FILE",
        help="lat-long .hdr or .exr, or the name of one that Blender ships, such as city",
    )
    parser.add_argument("--views", help="held_out (default), train, all, or names with commas")
    parser.add_argument("--rotation", type=finite, help="degrees about the up axis")
    parser.add_argument("--turntable", type=up_to(10_000), metavar="N", help="frames of a turn")
    parser.add_argument("--samples", type=up_to(1 << 20), help="Cycles samples per pixel")
    parser.add_argument("--max-side", type=up_to(1 << 14), help="longer side, pixels")
    _add_progress(parser)


def _add_evaluate(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "evaluate", help="say which stage loses the photographs, and compare with a truth"
    )
    parser.set_defaults(command=commands.evaluate, truth=None)
    parser.add_argument("out", type=path_argument, metavar="OUT", help="finished result folder")
    parser.add_argument("--json", action="store_true", help="scores as JSON on standard output")


def _add_selftest(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "selftest", help="see by a small fit whether this machine can reconstruct"
    )
    parser.set_defaults(command=commands.selftest)
    parser.add_argument("--device", choices=("cpu", "cuda", "auto"), default="auto")
    parser.add_argument(
        "--json", action="store_true", help="progress and at last the verdict as JSON lines"
    )


def _add_progress(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--progress", choices=("auto", "rich", "plain", "json"), default="auto")
