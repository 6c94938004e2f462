# SPDX-License-Identifier: Apache-2.0
"""The contents of a capture as one hash, so that a changed photograph is noticed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from robir.capture.frames import IMAGE_SUFFIXES
from robir.capture.images.decode import MAX_FILE_BYTES
from robir.capture.mesh_file import mesh_parts
from robir.capture.poses.sources import MAX_BYTES, is_video
from robir.errors import CaptureError
from robir.jobs.names import leads_out, open_regular

_POSES = (".json", ".npz", ".npy", ".bin", ".txt", ".csv", ".xml", ".sfm")
_SUFFIXES = frozenset([*_POSES, ".exr", *IMAGE_SUFFIXES])  # no videos, no archives
_TRUTH = "truth"  # ground truth is never an input of a reconstruction


def is_capture_file(path: Path) -> bool:
    """Whether a regular file may be a capture by itself: a video, or one of poses."""
    return path.is_file() and (is_video(path) or path.suffix.lower() in _POSES)


def file_hash(path: Path) -> str:
    """SHA-256 of a regular file, 64 hex digits; an OSError names it, as a bad block does not."""
    with os.fdopen(open_regular(path), "rb") as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


def mesh_fingerprint(mesh: Path | None) -> str:
    """SHA-256 of the files of the user's mesh, "" without one; else a `CaptureError`."""
    if mesh is None:
        return ""
    if not mesh.is_file():
        raise CaptureError(f"the mesh {mesh} does not exist; check the path")
    digest = hashlib.sha256()
    for name, content in sorted(mesh_parts(mesh).items()):
        digest.update(os.fsencode(name) + b"\0" + hashlib.sha256(content).digest())
    return digest.hexdigest()


def capture_fingerprint(
    source: Path, masks: Path | None, out: Path, follows_links: bool = False
) -> str:
    """SHA-256 of the names and contents of all files a capture may consist of, masks included.

    The result folder is left out where it lies inside; links out of the capture's folder are
    followed as `capture.outside` says. `CaptureError` if something does not exist or cannot be
    read.
    """
    for name, path in (("capture", source), ("masks folder", masks)):
        if path is not None and not path.exists():
            raise CaptureError(f"the {name} {path} does not exist; check the path")
    digest = hashlib.sha256()
    try:
        if is_video(source):
            if source.stat().st_size > MAX_BYTES:
                raise CaptureError(f"the video {source} is too large; cut it")
            digest.update(file_hash(source).encode())
            folders = [masks]
        else:
            folders = [source if source.is_dir() else source.parent, masks]
        for folder in filter(None, folders):
            for path in _files(folder, out.resolve(), follows_links):
                digest.update(os.fsencode(path.relative_to(folder).as_posix()) + b"\0")
                digest.update(file_hash(path).encode())
            digest.update(b"\n")
    except OSError as error:
        raise CaptureError(f"cannot read {error.filename}: {error.strerror}") from error
    return digest.hexdigest()


def _files(folder: Path, out: Path, follows_links: bool) -> Iterator[Path]:
    """Regular files of a capture in a fixed order; linked folders are followed once, if at all."""
    seen = {os.path.realpath(folder)}
    for parent, folders, names in os.walk(folder, followlinks=follows_links):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".")
            and name != _TRUTH
            and Path(os.path.realpath(Path(parent, name))) != out
            and os.path.realpath(Path(parent, name)) not in seen
        )
        seen.update(os.path.realpath(Path(parent, name)) for name in folders)
        for name in sorted(names):
            path = Path(parent, name)
            if path.suffix.lower() not in _SUFFIXES or name.startswith("."):
                continue
            is_ours = follows_links or not path.is_symlink() or not leads_out(path, [folder])
            if is_ours and path.is_file() and path.stat().st_size <= MAX_FILE_BYTES:
                yield path
