# SPDX-License-Identifier: GPL-3.0-or-later
"""What state the managed engine is in, told from its files alone; fast enough to be drawn."""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from .errors import Sentence
from .places import Place

State = Literal["missing", "incomplete", "outdated", "ready"]
Build = Literal["CPU", "CUDA"]
INSTALL = "press Install Engine"
UPDATE = "press Update Engine"
GO_ON = "press Install Engine again; it goes on where it stopped"


@dataclass(frozen=True)
class Record:
    """What an engine consists of, and its size in bytes (0: not noted); content of engine.json."""

    robir: str
    wheel_sha256: str
    torch_build: Build
    torch: str
    numpy: str
    python: str
    size: int = 0


@dataclass(frozen=True)
class Status:
    """State of an engine in words; it has an interpreter, and no cure, where it is ready."""

    state: State
    text: str
    cure: str = ""
    python: Path | None = None


def status(place: Place, wheel: Path, build: Build) -> Status:
    """State of the managed engine."""
    if not place.marker.is_file():
        return Status("missing", "No engine is installed", INSTALL)
    record = read_record(place)
    if record is None:
        return Status("incomplete", "The engine's installation is not finished", GO_ON)
    if not place.python.exists():
        return Status(
            "incomplete", "The Python that the engine was made with is gone", "press Install Engine"
        )
    version = wheel_version(wheel)
    if record.robir != version:
        text = Sentence(
            "The engine was made by RobIR {made_by}, the add-on is RobIR {version}",
            made_by=record.robir,
            version=version,
        )
        return Status("outdated", text, UPDATE)
    if record.wheel_sha256 != wheel_hash(wheel):
        text = Sentence("The engine was made by another build of RobIR {version}", version=version)
        return Status("outdated", text, UPDATE)
    if record.torch_build != build:
        text = Sentence(
            "The engine computes with {made_for}, chosen is {chosen}",
            made_for=record.torch_build,
            chosen=build,
        )
        return Status("outdated", text, UPDATE)
    text = Sentence(
        "Engine ready: RobIR {robir}, torch {torch}, numpy {numpy}, Python {python}",
        **{name: getattr(record, name) for name in ("robir", "torch", "numpy", "python")},
    )
    return Status("ready", text, python=place.python)


def read_record(place: Place) -> Record | None:
    """What engine.json says; None if it is missing or not to be trusted."""
    try:
        return Record(**json.loads(place.record.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def write_record(place: Place, record: Record) -> None:
    """Make the engine count as installed; a killed process leaves no half record."""
    temporary = place.record.with_name(f".{place.record.name}-{os.getpid()}")
    with temporary.open("w", encoding="utf-8") as file:
        json.dump(asdict(record), file, indent=2)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(place.record)


def wheel_version(wheel: Path) -> str:
    """Version in a wheel's file name, without the mark of its content."""
    return wheel.name.split("-")[1].partition("+")[0]


def wheel_hash(wheel: Path) -> str:
    """SHA-256 of a wheel, 64 hex digits."""
    found = wheel.stat()
    return _hash(wheel, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=4)
def _hash(wheel: Path, _changed: int, _size: int) -> str:
    """Read once as long as the file stays the same: a panel asks at every redraw."""
    return hashlib.sha256(wheel.read_bytes()).hexdigest()
