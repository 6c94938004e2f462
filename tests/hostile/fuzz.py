# SPDX-License-Identifier: Apache-2.0
"""Long fuzzing of one target, guided by coverage: `python -m hostile.fuzz TARGET SECONDS`.

Needs atheris, which `make fuzz` installs. A crash becomes a file in `crashes`, for the tests.
"""

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(
    include=["robir", "hostile", "json", "zipfile", "numpy.lib.format"]
):
    from hostile.targets import CRASHES, Targets


def main() -> None:
    """Fuzz until it crashes or time is up."""
    name, seconds = sys.argv[1:3]
    with tempfile.TemporaryDirectory(prefix="robir-fuzz-") as folder:
        targets = Targets(Path(folder))
        corpus = Path(folder, "corpus")
        corpus.mkdir()
        for number, seed in enumerate(targets.seeds[name]):
            (corpus / str(number)).write_bytes(seed)
        found = CRASHES / name
        found.mkdir(parents=True, exist_ok=True)
        options = [f"-max_total_time={seconds}", "-timeout=15", "-rss_limit_mb=2000"]
        options += [f"-artifact_prefix={found}/", str(corpus)]
        atheris.Setup([sys.argv[0], *options], targets.calls[name])
        atheris.Fuzz()


if __name__ == "__main__":
    main()
