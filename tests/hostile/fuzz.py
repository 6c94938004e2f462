# SPDX-License-Identifier: Apache-2.0
"""Long fuzzing of all or some targets by coverage: `python -m hostile.fuzz SECONDS [TARGET ...]`.

Needs atheris, which `make fuzz` installs. A crash becomes a file in `crashes`, for the tests. The
exit code is the number of targets that crashed.
"""

import os
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(
    include=["robir", "hostile", "json", "zipfile", "numpy.lib.format"]
):
    from hostile.targets import CRASHES, Targets


def fuzz(name: str, seconds: str) -> None:
    """Fuzz one target until it crashes or time is up; ends the process."""
    warnings.simplefilter("error", RuntimeWarning)  # users would see it
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


def main() -> int:
    """Fuzz targets one after another, each in a fork, so that what is loaded is loaded once."""
    seconds, *names = sys.argv[1:]
    if not names:
        with tempfile.TemporaryDirectory() as folder:
            names = list(Targets(Path(folder)).calls)
    crashed = []
    for name in names:
        print(f"== {name}", flush=True)
        child = os.fork()
        if not child:
            fuzz(name, seconds)
            os._exit(0)
        if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
            crashed.append(name)
    print(f"{len(names)} targets, {len(crashed)} crashed: {' '.join(crashed)}")
    return len(crashed)


if __name__ == "__main__":
    sys.exit(main())
