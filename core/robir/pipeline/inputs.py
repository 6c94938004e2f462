# SPDX-License-Identifier: Apache-2.0
"""The contents of a capture as one hash, so that a changed photograph is noticed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from robir.capture.frames import IMAGE_SUFFIXES
from robir.errors import CaptureError
from robir.poses.register import is_video

_POSES = (".json", ".npz", ".npy", ".bin", ".txt", ".csv", ".xml", ".sfm")
_SUFFIXES = frozenset([*_POSES, ".exr", *IMAGE_SUFFIXES])
"""Kinds of files a capture is made of; videos and archives beside them do not count."""

_TRUTH = "truth"
"""Ground truth is never an input of a reconstruction."""


def file_hash(path: Path) -> str:
    """SHA-256 of a file's contents, 64 hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def capture_fingerprint(source: Path, masks: Path | None, out: Path) -> str:
    """SHA-256 of the names and contents of all files a capture may consist of.

    Args:
        source: Capture folder, or a file in it.
        masks: Folder of masks, or None.
        out: Result folder; left out where it lies inside the capture.

    Raises:
        CaptureError: If the capture or the masks do not exist or cannot be read.
    """
    for name, path in (("capture", source), ("masks folder", masks)):
        if path is not None and not path.exists():
            raise CaptureError(f"the {name} {path} does not exist; check the path")
    digest = hashlib.sha256()
    try:
        if is_video(source):
            digest.update(file_hash(source).encode())
            folders = [masks]
        else:
            folders = [source if source.is_dir() else source.parent, masks]
        for folder in filter(None, folders):
            for path in _files(folder, out.resolve()):
                digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
                digest.update(file_hash(path).encode())
            digest.update(b"\n")
    except OSError as error:
        raise CaptureError(f"cannot read {error.filename}: {error.strerror}") from error
    return digest.hexdigest()


def _files(folder: Path, out: Path) -> Iterator[Path]:
    """Files of a capture in a fixed order; linked folders are followed once."""
    seen: set[str] = set()
    for parent, folders, names in os.walk(folder, followlinks=True):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".")
            and name != _TRUTH
            and Path(parent, name).resolve() != out
            and os.path.realpath(Path(parent, name)) not in seen
        )
        seen.update(os.path.realpath(Path(parent, name)) for name in folders)
        for name in sorted(names):
            if Path(name).suffix.lower() in _SUFFIXES and not name.startswith("."):
                yield Path(parent, name)
