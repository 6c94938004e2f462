# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures that were reconstructed, the latest first, and where their results went.

They are kept in the extension's own folder, so that they outlive a file that was never saved.
"""

from contextlib import suppress
from pathlib import Path

from ..gateway import read_json, write_json
from ..home import own_folder

_MOST = 6
_NAME = "recent.json"

_known: list[tuple[str, str]] = []
"""Capture and chosen result folder, absolute; read once, for panels show them."""


def remember(capture: Path, out: str) -> None:
    """Put a capture at the head of the list; an empty `out` means beside it."""
    entry = (str(capture), out)
    _known[:] = [entry, *(known for known in _known if known[0] != entry[0])][:_MOST]
    folder = own_folder(create=True)
    if folder is not None:
        with suppress(OSError):  # the list is a help, no reason to stop
            write_json(folder / _NAME, {"captures": _known})


def recent_captures() -> list[str]:
    """Captures, the latest first; touches no file."""
    return [capture for capture, _ in _known]


def result_of(capture: Path) -> str:
    """Result folder that was chosen for a capture; empty for the one beside it."""
    return next((out for known, out in _known if known == str(capture)), "")


def register() -> None:
    """Read what earlier sessions have kept; a damaged list is an empty one."""
    folder = own_folder(create=False)
    try:
        kept = read_json(folder / _NAME)["captures"] if folder is not None else []
        _known[:] = [(str(capture), str(out)) for capture, out in kept][:_MOST]
    except (OSError, ValueError, KeyError, TypeError):
        _known.clear()


def unregister() -> None:
    """Forget what was read."""
    _known.clear()
