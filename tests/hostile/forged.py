# SPDX-License-Identifier: Apache-2.0
"""Forged results whose later stages run again: `python -m hostile.forged SEED COUNT`.

A finished result is changed in one place, the hashes in its manifests are made right again, and the
stages after that place are taken away, so that `--resume` reads what was forged. It has to end with
a sentence or a result. Prints what broke a promise; the exit code is the number of those.
"""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hostile.damage import NASTY, damage_file, places, replaced
from hostile.sandbox import Outcome, tried
from hostile.tiny_run import begun, ended, words
from PIL import Image

from robir import cli
from robir.jobs.paths import STAGES, JobPaths
from robir.specimen import write_specimen

CODES = (0, 1, 2, 3, 4, 5, 6)  # every end that a command may come to by itself

# the one program that these stages start: this Python, for charts of the texture
UNWRAP = "robir.geometry.mesh.charts"


@dataclass(frozen=True, slots=True)
class Forgery:
    """One case: a file of a result, and the stage that runs again first."""

    name: Path
    again: str
    seed: str


class Forge:
    """A finished result of a small capture, and copies of it that were tampered with."""

    def __init__(self, folder: Path) -> None:
        """Make the result."""
        self._folder, self._capture, self._whole = folder, folder / "capture", folder / "whole/out"
        write_specimen(self._capture)
        self._whole.parent.mkdir()
        log = folder / "log.txt"
        code = ended(begun(words(self._capture, self._whole, has_renders=False), log))
        assert code in (0, 5), log.read_text()

    def cases(self, seed: int, count: int) -> Iterator[Forgery]:
        """So many, spread over all files that a later stage or `--resume` itself reads."""
        files = [p for p in sorted(self._whole.rglob("*")) if p.is_file() and _is_read(p)]
        for number in range(count):
            name = files[number % len(files)].relative_to(self._whole)
            stage = name.parts[1] if name.parts[0] == "stages" else STAGES[-2]
            later = STAGES[STAGES.index(stage) + 1 :]
            again = random.Random(f"{seed} stage {number}").choice(later)
            yield Forgery(name, again, f"{seed} {number}")

    def judged(self, case: Forgery) -> Outcome:
        """What `--resume` makes of it."""
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            out = Path(shutil.copytree(self._whole, Path(folder, "out")))
            forge(out / case.name, random.Random(case.seed))
            paths = JobPaths(out)
            for stage in STAGES[STAGES.index(case.again) :]:
                paths.manifest(stage).unlink(missing_ok=True)
            for stage in STAGES[: STAGES.index(case.again)]:
                _make_right(paths, paths.manifest(stage))
            command = words(self._capture, out, has_renders=False)
            return tried(lambda: cli.main(command), CODES, [out], UNWRAP)


def _is_read(path: Path) -> bool:
    """Whether a file is worth to be tampered with; of pictures of views two are enough."""
    if path.parent.name == "views":
        return path.name in ("train_view_03.png", "test_view_00.png")
    return path.name not in ("stage.json", "preview.png", "growing.npz") and (
        "stages" in path.parts or path.parent.name == "out"
    )


def forge(path: Path, generator: random.Random) -> None:
    """Change a file into one that may pass for whole, or damage it."""
    chance = generator.random()
    if path.suffix == ".npz" and chance < 0.8:
        _forge_arrays(path, generator)
    elif path.suffix == ".png" and chance < 0.6:
        _forge_picture(path, generator)
    elif path.suffix == ".json" and chance < 0.9 and places(json.loads(path.read_text())):
        document = json.loads(path.read_text())
        value = generator.choice([*NASTY, ...])
        path.write_text(replaced(document, generator.choice(places(document)), value))
    else:
        damage_file(path, generator)


def _forge_arrays(path: Path, generator: random.Random) -> None:
    with np.load(path, allow_pickle=False) as arrays:
        kept = dict(arrays)
    name = generator.choice(sorted(kept))
    array = kept.pop(name)
    is_number = array.dtype.kind in "fiu"
    makers = (
        lambda: None,
        lambda: array[:-1] if array.ndim else np.zeros(3),
        lambda: np.full(array.shape, np.nan),
        lambda: array.astype("U9").ravel()[:5],
        lambda: np.zeros((0, *array.shape[1:]), array.dtype),
        lambda: array.ravel(),
        lambda: array * array.dtype.type(100) if is_number else array,
        lambda: np.zeros(1 << 28, np.uint8),
        lambda: -array if is_number else array,
        lambda: np.full(array.shape, 1e30),
    )
    with np.errstate(all="ignore"):
        changed = generator.choice(makers)()
    np.savez_compressed(path, **kept, **({} if changed is None else {name: changed}))


def _forge_picture(path: Path, generator: random.Random) -> None:
    with Image.open(path) as picture:
        kind = generator.choice(["L", "RGB", "size"])
        changed = picture.resize((9, 9)) if kind == "size" else picture.convert(kind)
    changed.save(path)


def _make_right(paths: JobPaths, manifest: Path) -> None:
    """Let a manifest say of its stage's files what they now are."""
    facts = json.loads(manifest.read_text())
    for name in facts["outputs"]:
        path = paths.root / name
        if path.is_file() and not path.is_symlink():
            content = path.read_bytes()
            told = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
            facts["outputs"][name] = told
    manifest.write_text(json.dumps(facts))


def main() -> int:
    """Try so many forgeries."""
    seed, count = map(int, sys.argv[1:])
    bad = refused = 0
    with tempfile.TemporaryDirectory(prefix="robir-forged-") as folder:
        bench = Forge(Path(folder))
        for case in bench.cases(seed, count):
            outcome = bench.judged(case)
            refused += outcome.code in (1, 2, 3, 4)
            if outcome.faults:
                bad += 1
                told = f"{case.name}, {case.seed}, from {case.again}: {'; '.join(outcome.faults)}"
                print(f"{told}\n{outcome.said[-600:]}", flush=True)
    print(f"{count} forged results: {refused} refused, {bad} broke a promise")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
