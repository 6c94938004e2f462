# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands share: sentences for people, and what becomes of a request that fails."""

import sys
from collections.abc import Callable
from pathlib import Path

from blender_scenes.request import SceneError
from blender_scenes.variation import VariationError

USAGE_ERROR = 2
INTERRUPTED = 130


def carried_out(work: Callable[[], None], out: Path) -> int:
    """Does the work of a command, then names its result on standard output.

    Args:
        work: writes what was asked for to `out`.
        out: the result.

    Returns:
        Exit code: 0 done, 2 a request that cannot be fulfilled, 130 interrupted.
    """
    try:
        work()
    except (SceneError, VariationError) as error:
        say(f"error: {error}")
        return USAGE_ERROR
    except OSError as error:
        say(f"error: {error.filename or out}: {error.strerror or error}")
        return USAGE_ERROR
    except KeyboardInterrupt:
        say("interrupted; the same command goes on from here")
        return INTERRUPTED
    sys.stdout.write(f"{out}\n")
    return 0


def say(sentence: str, ending: str = "\n") -> None:
    """Writes to standard error; standard output is for the result's path alone."""
    sys.stderr.write(sentence + ending)
    sys.stderr.flush()
