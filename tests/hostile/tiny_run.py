# SPDX-License-Identifier: Apache-2.0
"""A real run of all stages in seconds, in a process that may be killed, and what it left behind.

The stages are loaded once; every run is a fork, so that it costs only itself.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from robir import cli
from robir.jobs.paths import JobPaths
from robir.pipeline.runner import load_stages
from robir.specimen import SETTINGS

# the least that Blender can be asked for
RENDERS = ("export.render_views=1", "export.render_samples=2", "export.render_max_side=32")

# no good result is needed, only one that is the same every time
LEAST = (
    "geometry.level_steps=[40]", 'appearance.families=["standard"]', "appearance.iterations=20",
    "appearance.texture_size=64", "transport.num_directions=64",
)  # fmt: skip

_COSTS = re.compile(r"(.*_)?(seconds|peak_memory_bytes|heartbeat|pid)|threads")
_TIMES = re.compile(
    r"<td>(?:capture|geometry|transport|appearance|export|reconstruction|rendering in Blender, "
    r'counted apart)</td><td class="n">[\d.]+</td><td class="n">[\d.]+</td>|<dd>\d+ CPU-s</dd>'
    r'|<td class="n">[\d.]+</td>(?=<td class="n">[\d.]+</td>)'
    r'|<td class="n">[\d.]+</td>(?=<td>)|width:[\d.]+%'
)
# files that tell how the result came about, or show it halfway
_HISTORY = (
    "events.jsonl", "log.txt", "worker.json", "worker.log", "preview.png", "growing.npz",
)  # fmt: skip


def words(capture: Path, out: Path, *, has_renders: bool) -> list[str]:
    """The command that makes the small result, or goes on with it."""
    kept = [s for s in SETTINGS if not (has_renders and s.startswith("export."))]
    chosen = [*kept, *LEAST, *(RENDERS if has_renders else ())]
    return [
        *("reconstruct", str(capture), "-o", str(out), "--resume", "--progress", "plain"),
        *(word for setting in chosen for word in ("--set", setting)),
    ]


def forked(call: Callable[[], int], log: Path) -> int:
    """Start a call in a process of its own, which leads a group; its number.

    Args:
        call: Returns the exit code.
        log: What it prints is added there.
    """
    load_stages()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        os.setpgid(0, 0)
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        code = call()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def begun(command: Sequence[str], log: Path) -> int:
    """Start a command of `robir`; the number of its process."""
    return forked(lambda: cli.main(list(command)), log)


def ended(process: int) -> int:
    """Exit code of a process of ours once it has ended; negative where a signal ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def without_costs(value: Any) -> Any:
    """A JSON value without what equal runs differ in: times, memory, threads, process numbers."""
    if isinstance(value, dict):
        return {k: without_costs(v) for k, v in value.items() if not _COSTS.fullmatch(k)}
    return [without_costs(v) for v in value] if isinstance(value, list) else value


def contents(out: Path) -> dict[str, str]:
    """A hash of every file of a result by its name, times and the way it came about apart.

    Blender's files hold addresses of memory, so that no two are alike: they count as there or not
    here, `scenes` looks into them.
    """
    found = {}
    for path in sorted(out.rglob("*")):
        name = path.relative_to(out).as_posix()
        if path.is_dir() or name in _HISTORY:
            continue
        data = path.read_bytes()
        if path.suffix == ".blend":
            data = b""
        elif path.suffix == ".json":
            data = _plain_json(name, data, out)
        elif path.suffix == ".html":
            data = _TIMES.sub("", data.decode("utf-8")).encode("utf-8")
        found[name] = hashlib.sha256(data).hexdigest()
    return found


def _plain_json(name: str, data: bytes, out: Path) -> bytes:
    value = without_costs(json.loads(data.replace(str(out).encode(), b"OUT")))
    if name.endswith("stage.json"):  # hashes of files that hold times
        value["outputs"] = sorted(value["outputs"])
    elif name == "status.json":  # a run that had ended says that there is nothing to do
        del value["message"]
    return json.dumps(value, sort_keys=True).encode()


_DUMP = """
import hashlib, sys
import bpy

def plain(owner, depth):
    said = []
    for rna in sorted(owner.bl_rna.properties, key=lambda rna: rna.identifier):
        name = rna.identifier
        if name in ("rna_type", "session_uid", "pixels", "library") or depth > 6:
            continue
        if name in ("pin", "vertex_selection", "edge_selection"):  # asked for, they are made
            continue
        try:
            value = getattr(owner, name)
        except Exception:
            continue
        if rna.type == "POINTER":
            is_part = value is not None and not isinstance(value, bpy.types.ID)
            said.append((name, plain(value, depth + 1) if is_part else getattr(value, "name", "")))
        elif rna.type == "COLLECTION":
            kind = rna.fixed_type.identifier
            is_id = issubclass(getattr(bpy.types, kind, object), bpy.types.ID)
            said.append((name, [v.name if is_id else plain(v, depth + 1) for v in value]))
        elif getattr(rna, "is_array", False):
            said.append((name, [repr(v) for v in value]))
        else:
            said.append((name, repr(value)))
    return said

for path in sys.argv[1:]:
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    digest = hashlib.sha256()
    for collection in ("meshes", "materials", "objects", "cameras", "lights", "worlds", "images"):
        for item in sorted(getattr(bpy.data, collection), key=lambda item: item.name):
            text = repr((collection, item.name, plain(item, 0)))
            digest.update(text.replace(path.rpartition("/export/")[0], "").encode())
    print("SCENE", digest.hexdigest(), flush=True)
"""


def scenes(results: Sequence[Path]) -> list[str]:
    """Hashes of all that Blender's files of each result say: every property of their data."""
    files = [sorted(JobPaths(out).export.glob("*.blend")) for out in results]
    words = [str(file) for some in files for file in some]
    done = subprocess.run(
        [sys.executable, "-c", _DUMP, *words], capture_output=True, text=True, check=True
    )
    said = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("SCENE")]
    assert len(said) == len(words)
    return ["".join(said.pop(0) for _ in some) for some in files]
