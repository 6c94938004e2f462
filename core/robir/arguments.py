# SPDX-License-Identifier: Apache-2.0
"""What stands behind an option or by itself on a command line, read from its text."""

from __future__ import annotations

import argparse
import errno
import math
from collections.abc import Callable
from pathlib import Path

from robir.errors import UsageError
from robir.jobs.library import FORMATS
from robir.jobs.paths import STAGES


def path_argument(text: str) -> Path:
    """A path that the operating system can be asked for; whether it exists is looked at later."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(
            f"{text[:80]!a} is no path of valid text; rename it, or set LC_ALL=C.UTF-8"
        ) from None
    try:
        Path(text).lstat()
    except ValueError as fault:
        raise argparse.ArgumentTypeError(f"{text[:80]!a} is no path ({fault})") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise argparse.ArgumentTypeError(f"{text[:80]!a}... is too long for a path") from None
    return Path(text)


def refuse_lost_folder() -> None:
    """Refuse to work from a folder that is gone: libraries look for it and die.

    `UsageError` if it is.
    """
    try:
        Path.cwd()
    except OSError:
        raise UsageError("the working folder has been deleted; change to another") from None


def stage_range(text: str) -> tuple[str, str]:
    """The first and the last of some stages, such as transport-export."""
    first, separator, last = text.partition("-")
    if first not in STAGES or (separator and last not in STAGES[STAGES.index(first) :]):
        raise argparse.ArgumentTypeError(f"{text!a} names no stages; they are {', '.join(STAGES)}")
    return first, last or first


def asset_formats(text: str) -> tuple[str, ...]:
    """Formats of an asset, with commas between them."""
    chosen = [kind for kind in FORMATS if kind in text.lower().split(",")]
    unknown = sorted(set(text.lower().split(",")) - set(chosen))
    if unknown:
        raise argparse.ArgumentTypeError(
            f"{unknown[0]!a} is no format; known: {', '.join(FORMATS)}"
        )
    return tuple(chosen)


def add_constant(parser: argparse.ArgumentParser) -> None:
    """Add what the bench sweeps constants by: for developers, so not in the help."""
    parser.add_argument(
        "--constant", action="append", default=[], dest="constants", help=argparse.SUPPRESS
    )


def finite(text: str) -> float:
    """A number."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is no number to turn by")
    return value


def up_to(most: int) -> Callable[[str], int]:
    """Reads a whole number of at least 1 that is at most another."""

    def read(text: str) -> int:
        value = positive(text)
        if value > most:
            raise argparse.ArgumentTypeError(f"{text} is more than {most}")
        return value

    return read


def positive(text: str) -> int:
    """A whole number of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not at least 1")
    return value
