# SPDX-License-Identifier: Apache-2.0
"""Mutated captures against the promises: `python -m hostile.corpus SEED ROUNDS [PART/PARTS]`.

Prints what broke one and a summary; the exit code is the number of those.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from capture.scene import cameras, shoot
from hostile.mutants import FORMATS, Mutant, corpus, write_wholes
from hostile.sandbox import Outcome, tried

from robir import cli
from robir.pipeline.ledger import capture_fingerprint

TAKEN, REFUSED = 0, 3


def judged(mutants: Iterable[Mutant]) -> Iterator[tuple[Mutant, Outcome]]:
    """Each mutant read as a run reads it: its files are hashed, then it is checked."""
    with tempfile.TemporaryDirectory(prefix="robir-corpus-") as name:
        folder = Path(name)
        shots = [shoot(camera) for camera in cameras(count=6)]
        wholes = write_wholes(folder / "whole", shots)
        for number, mutant in enumerate(mutants):
            place = folder / str(number)
            place.mkdir()
            root = mutant.make(wholes[mutant.form], place)
            yield mutant, tried(lambda root=root: _read(root), (TAKEN, REFUSED))
            shutil.rmtree(place)


def _read(root: Path) -> int:
    try:
        capture_fingerprint(root, None, root / "out")
    except Exception as error:
        if type(error).__name__ != "CaptureError":
            raise
    return cli.main(["check", str(root), "--progress", "plain"])


def main() -> int:
    """Run a part of the corpus."""
    seed, rounds = map(int, sys.argv[1:3])
    part, parts = map(int, sys.argv[3].split("/")) if len(sys.argv) > 3 else (1, 1)
    mutants = [m for i, m in enumerate(corpus(seed, rounds)) if i % parts == part - 1]
    codes: Counter[int] = Counter()
    bad, slowest, largest = 0, 0.0, 0
    for mutant, outcome in judged(mutants):
        codes[outcome.code] += 1
        slowest, largest = max(slowest, outcome.seconds), max(largest, outcome.peak_bytes)
        if outcome.faults:
            bad += 1
            print(f"{mutant.name}: {'; '.join(outcome.faults)}\n{outcome.said[-1500:]}", flush=True)
    print(
        f"{len(mutants)} captures in {len(FORMATS)} formats: {codes[REFUSED]} refused, "
        f"{codes[TAKEN]} taken, {bad} broke a promise; "
        f"at most {slowest:.1f} s and {largest / 1e9:.2f} GB"
    )
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
