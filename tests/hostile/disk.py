# SPDX-License-Identifier: Apache-2.0
"""Faults of the disk under a real run: `python -m hostile.disk [KIND[:COUNT]...]`, Linux only.

Kinds: `full` (a disk of ten sizes, which takes root: it is mounted in a namespace of its own),
`readonly` from some moments on, `gone` for a network drive that goes away then, `write` and `read`
for bad blocks in some files, by a library that stands before the system's. Each has to end with a
sentence, and to go on to the unbroken result once the disk is well again. With counts Blender is
left out.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from hostile.tiny_run import begun, contents, ended, words

from robir.errors import StorageError
from robir.specimen import write_specimen

KINDS = ("full", "readonly", "write", "read", "gone")
SHIM = Path(__file__).with_name("faulty_disk.c")
# set in the process that has the library and, where possible, the namespace
INSIDE = "ROBIR_FAULTY_DISK"

# sizes of a full disk, as shares of what the result takes
SHARES = (0.0, 0.001, 0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95)

# files of OUT after whose appearance the disk is read-only
MOMENTS = (
    "run.json", "stages/capture/capture.json", "stages/geometry/mesh.npz",
    "stages/transport/stage.json", "stages/appearance/choices.json", "export/asset.glb",
    "export/light.json", "report/report.json",
)  # fmt: skip

# names of files that cannot be written; the last two are Blender's
WRITTEN = (
    "status", "run", "capture", "mesh", "bounce", "textures", "albedo", "environment", "asset",
    "light", "index", "config", "scene", "rerender_test_view_00",
)  # fmt: skip

# files that cannot be read
READ = ("train/view_03.png", "transforms_train.json", "geometry/mesh.npz", "capture/capture.json")


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault and what came of it."""

    name: str  # kind and place
    code: int  # exit code under the fault
    said: str  # last line of what was said
    is_clear: bool  # whether it ended as an error of the disk or capture does, without a traceback
    resumed: int  # exit code once the disk was well again
    differing: tuple[str, ...]  # files that then differ from the unbroken result


class Bench:
    """A capture, its unbroken result, and runs on a disk that fails."""

    def __init__(self, folder: Path, *, has_renders: bool) -> None:
        """Render the capture and make the unbroken result."""
        self._folder, self._has_renders = folder, has_renders
        folder.mkdir(parents=True, exist_ok=True)
        self._capture = folder / "capture"
        write_specimen(self._capture)
        self._log = folder / "log.txt"
        whole = folder / "whole" / "out"
        self.code = self._run(whole)
        assert self.code in (0, 5), self._log.read_text()
        self._expected = contents(whole)
        self._bytes = sum(p.stat().st_size for p in whole.rglob("*") if p.is_file())

    def faults(self, kind: str, count: int = 100) -> Iterator[Fault]:
        """The first faults of a kind."""
        cases = {"full": SHARES, "write": WRITTEN, "read": READ}.get(kind, MOMENTS)
        if kind == "write" and not self._has_renders:
            cases = cases[:-2]
        for case in cases[:count]:
            if isinstance(case, float):
                yield self._full(case)
            else:
                yield self._midway(kind, case) if cases is MOMENTS else self._bad(kind, case)

    def _full(self, share: float) -> Fault:
        home = self._folder / "disk"
        home.mkdir(exist_ok=True)
        size = max(4096, int(share * self._bytes))
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(home)]
        subprocess.run(mount, check=True)
        try:
            mend = ["mount", "-o", "remount,size=1g", str(home)]
            return self._tried(
                f"full at {size} bytes", home / "out", {}, lambda: subprocess.run(mend, check=True)
            )
        finally:
            subprocess.run(["umount", str(home)], check=True)

    def _midway(self, kind: str, moment: str) -> Fault:
        out = self._folder / "disk" / "out"
        fault = {"FAULT_KIND": kind, "FAULT_NAME": str(out), "FAULT_AFTER": str(out / moment)}
        return self._tried(f"{kind} after {moment}", out, fault)

    def _bad(self, kind: str, name: str) -> Fault:
        out = self._folder / "disk" / "out"
        # a file is written beside its place first
        part = f".{name}-" if kind == "write" else name
        fault = {"FAULT_KIND": kind, "FAULT_NAME": part, "FAULT_AFTER": ""}
        return self._tried(f"bad block, {kind} {name}", out, fault)

    def _run(self, out: Path) -> int:
        out.parent.mkdir(exist_ok=True)
        return ended(begun(words(self._capture, out, has_renders=self._has_renders), self._log))

    def _tried(
        self, name: str, out: Path, fault: dict[str, str], mend: Callable[[], object] = bool
    ) -> Fault:
        self._log.write_text("")
        os.environ.update(fault)
        try:
            code = self._run(out)
        finally:
            for key in fault:
                del os.environ[key]
        text = self._log.read_text()
        mend()
        resumed = self._run(out)
        found = contents(out)
        names = sorted(found.keys() | self._expected.keys())
        differing = tuple(n for n in names if found.get(n) != self._expected.get(n))
        shutil.rmtree(out)
        is_clear = code in (StorageError.exit_code, 3) and "Traceback" not in text
        is_clear = is_clear and "internal error" not in text
        return Fault(name, code, (text.splitlines() or [""])[-1], is_clear, resumed, differing)


def inside(kinds: list[str]) -> int:
    """Run this module again with the library, and in a namespace if a disk is to be mounted."""
    with tempfile.TemporaryDirectory(prefix="robir-disk-") as folder:
        library = Path(folder, "faulty_disk.so")
        build = ["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(SHIM), "-ldl"]
        subprocess.run(build, check=True)
        is_mounted = any(kind.startswith("full") for kind in kinds)
        space = ["unshare", "--mount", "--propagation", "private"] if is_mounted else []
        command = [*space, sys.executable, "-m", "hostile.disk", *kinds]
        search = os.pathsep.join(os.path.abspath(entry or ".") for entry in sys.path)  # noqa: PTH100
        extra = {"LD_PRELOAD": str(library), INSIDE: folder, "PYTHONPATH": search}
        return subprocess.run(command, env={**os.environ, **extra}, check=False).returncode


def main() -> int:
    """Try all faults of the kinds; returns the number of those that were not told or mended."""
    kinds = sys.argv[1:] or list(KINDS)
    if INSIDE not in os.environ:
        return inside(kinds)
    bench = Bench(Path(os.environ[INSIDE], "bench"), has_renders=":" not in kinds[0])
    tried = bad = 0
    for kind, _, count in (word.partition(":") for word in kinds):
        for fault in bench.faults(kind, int(count or 100)):
            tried += 1
            is_good = fault.is_clear and fault.resumed == bench.code and not fault.differing
            bad += not is_good
            end = "the same" if not fault.differing else f"DIFFERS {fault.differing[:5]}"
            print(
                f"{'' if is_good else 'BAD '}{fault.name}: {fault.code}, {fault.said}", flush=True
            )
            print(f"    then {fault.resumed}, {end}", flush=True)
    print(f"{tried - bad} of {tried} faults of the disk were told and overcome")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
