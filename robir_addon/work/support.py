# SPDX-License-Identifier: GPL-3.0-or-later
"""A report for whoever is asked for help: versions, settings, the end of the log.

It is meant to be pasted in public, so it names no folder of the user's and not the user.
"""

import getpass
import platform
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import bpy

from ..gateway import JobPaths, __version__, leads_out, read_regular

_LOG_LINES = 40
_MOST_BYTES = 1 << 26
_SETTINGS = ("texture", "device", "rotation", "turntable_frames", "use_sun_lamp")
_FOLDERS = ("capture", "masks", "out", "result")


def support_report(context: bpy.types.Context) -> str:
    """Everything that helps, in plain text without private paths."""
    settings, state = context.scene.robir, context.window_manager.robir
    folder = state.job or settings.result
    values = [f"{name} = {getattr(settings, name)!r}" for name in _SETTINGS]
    parts = [_versions(state.engine_text), "Settings: " + ", ".join(values)]
    if state.error:
        parts.insert(0, f"Problem: {state.error}\nCure: {state.error_cure}")
    if folder:
        parts += _from_folder(JobPaths(Path(bpy.path.abspath(folder))))
    folders = {f"<{name}>": bpy.path.abspath(getattr(settings, name)) for name in _FOLDERS}
    return without_private_paths("\n\n".join(parts), folders) + "\n"


def without_private_paths(text: str, folders: Mapping[str, str]) -> str:
    """The text with known folders under other names, the home folder as ~, the user as USER."""
    known = [(Path(folder), name) for name, folder in folders.items() if folder]
    known.append((Path.home(), "~"))
    for folder, name in sorted(known, key=lambda pair: -len(str(pair[0]))):
        for spelling in {str(folder), folder.as_posix(), str(folder).replace("\\", "\\\\")}:
            if len(spelling) > 1:  # a root is no secret, and is in every path
                text = re.sub(re.escape(spelling) + r"(?![\w.-])", lambda _, n=name: n, text)
    users = {Path.home().name}
    with suppress(OSError, KeyError, ImportError):  # no such entry in the system's list of users
        users.add(getpass.getuser())
    for user in users - {""}:
        text = re.sub(rf"(?<![A-Za-z0-9]){re.escape(user)}(?![A-Za-z0-9])", "USER", text)
    return text


def _versions(engine: str) -> str:
    build = bpy.app.build_hash
    blender = build.decode("ascii", "replace") if isinstance(build, bytes) else build
    lines = [
        f"RobIR {__version__}",
        f"Blender {bpy.app.version_string} ({blender}), Python {sys.version.split()[0]}",
        f"System: {platform.system()} {platform.release()}, {platform.machine()}",
        f"Engine: {engine or 'not checked'}",
    ]
    return "\n".join(lines)


def _from_folder(paths: JobPaths) -> list[str]:
    """What the result folder says about the run; missing files are left out."""
    parts = []
    for title, file, lines in (
        ("run.json", paths.run, None),
        ("status.json", paths.status, None),
        ("config.toml", paths.config, None),
        (f"The log's last {_LOG_LINES} lines", paths.log, _LOG_LINES),
    ):
        if leads_out(file, [paths.root]):  # a link in a folder of somebody else's
            continue
        try:
            text = read_regular(file, _MOST_BYTES).decode("utf-8", errors="replace")
        except OSError:
            continue
        kept = text.rstrip().splitlines()[-lines if lines else None :]
        parts.append("\n".join([f"--- {title}", *kept]))
    return parts
