# SPDX-License-Identifier: Apache-2.0
"""Strangers' libraries and scenes: `python -m hostile.strangers SEED LIBRARIES SCENES`.

One file of a library or of what a result exports is damaged, or is a link, a pipe or a folder. Then
a library is drawn, gone on with and worked on; a scene is lit anew by Blender. Prints what broke a
promise; the exit code is the number of those.
"""

from __future__ import annotations

import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hostile.damage import damage_file
from hostile.forged import CODES
from hostile.sandbox import Outcome, tried
from hostile.tiny_run import begun, ended, words

from robir import cli
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import JobPaths
from robir.pipeline.runner import load_stages
from robir.specimen import write_specimen

# what is done with a library; a task of an empty capture ends at once
ACTS = (["--page"], ["--resume", "--on", "openjd"], ["--task", "0"])

ENDS = (*CODES, 130)
BLENDER = "robir_addon.headless"  # the one program that lighting a scene anew starts


def libraries(folder: Path, seed: int, count: int) -> Iterator[tuple[str, Outcome]]:
    """Damaged libraries, and what became of each."""
    (folder / "cap").mkdir()
    whole = LibraryPaths(folder / "whole")
    command = ["batch", str(folder / "cap"), "-o", str(whole.root), "--on", "openjd"]
    assert ended(begun(command, folder / "log.txt")) == 0, (folder / "log.txt").read_text()
    names = [p.relative_to(whole.root) for p in sorted(whole.root.rglob("*")) if p.is_file()]
    load_stages()
    for number in range(count):
        name, act = names[number % len(names)], ACTS[number // len(names) % len(ACTS)]
        with _copied(whole.root, folder) as place:
            damage_file(Path(place, "out", name), random.Random(f"{seed} {number}"))
            words = ["batch", "-o", str(Path(place, "out")), *act]
            outcome = tried(lambda words=words: cli.main(words), ENDS, [Path(place)], "reconstruct")
            yield f"{name} {' '.join(act)}, {seed} {number}", outcome


def scenes(folder: Path, seed: int, count: int) -> Iterator[tuple[str, Outcome]]:
    """Results with a damaged export, and what became of each under another light."""
    write_specimen(folder / "capture")
    whole, log = folder / "result" / "out", folder / "log.txt"
    whole.parent.mkdir()
    code = ended(begun(words(folder / "capture", whole, has_renders=False), log))
    assert code in (0, 5), log.read_text()
    export = JobPaths(whole).export
    names = [p.relative_to(whole) for p in sorted(export.rglob("*")) if p.is_file()]
    for number in range(count):
        name = names[number % len(names)]
        with _copied(whole, folder) as place:
            damage_file(Path(place, "out", name), random.Random(f"{seed} {number}"))
            light = ["--environment", "city", "--samples", "1", "--max-side", "16"]
            command = ["relight", str(Path(place, "out")), *light]
            outcome = tried(lambda command=command: cli.main(command), ENDS, [Path(place)], BLENDER)
            yield f"{name}, {seed} {number}", outcome


def _copied(whole: Path, folder: Path) -> tempfile.TemporaryDirectory[str]:
    """A folder with a copy, named out; it goes when left."""
    place = tempfile.TemporaryDirectory(dir=folder)
    shutil.copytree(whole, Path(place.name, "out"))
    return place


def main() -> int:
    """Try so many libraries and scenes."""
    seed, *counts = map(int, sys.argv[1:])
    bad = 0
    for count, cases in zip(counts, (libraries, scenes), strict=True):
        refused = 0
        with tempfile.TemporaryDirectory(prefix="robir-strangers-") as folder:
            for name, outcome in cases(Path(folder), seed, count) if count else ():
                refused += outcome.code != 0
                if outcome.faults:
                    bad += 1
                    print(f"{name}: {'; '.join(outcome.faults)}\n{outcome.said[-600:]}", flush=True)
        print(f"{count} {cases.__name__}: {refused} refused; in all {bad} broke a promise")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
