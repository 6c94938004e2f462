# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs pip in the engine's environment: progress while it works, a sentence when it fails."""

import os
import re
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import distributions
from pathlib import Path
from typing import IO, cast

from .errors import EngineError
from .places import CHOOSE_EXISTING, NEWEST, OLDEST, QUIETLY, Place, clean_environment
from .states import GO_ON

Progress = Callable[[float, str], None]
MEBIBYTE = 1 << 20
TAIL = 40  # lines of pip that are searched for the reason of a failure
_RAW_PROGRESS = (24, 1)
_RESUMES = (25, 1)

# what pip's output means: pattern, sentence, cure; the first that fits
_REASONS = (
    (r"No module named pip", "the environment is damaged",
     "press Remove Engine, then Install Engine"),
    (r"No space left on device|Errno 28|not enough space on the disk", "the disk is full",
     f"make room, then {GO_ON}"),
    (r"Long Path support", "Windows refuses the long names of torch's files",
     f"turn on long paths in Windows (LongPathsEnabled), or {CHOOSE_EXISTING}"),
    (r"CERTIFICATE_VERIFY_FAILED|SSLError", "the server's certificate is not trusted",
     "check the clock, or give pip your proxy's certificate with PIP_CERT"),
    (r"DO NOT MATCH THE HASHES|BadZipFile|invalid wheel|Wheel .* is invalid|incomplete-download",
     "a package arrived damaged", GO_ON),
    (r"NewConnectionError|NameResolutionError|Temporary failure|getaddrinfo failed",
     "the network cannot be reached", f"check that this machine is online, then {GO_ON}"),
    (r"ConnectionError|ConnectionReset|IncompleteRead"
     r"|Connection broken|ProtocolError|ReadTimeout|Max retries|timed out",
     "the download broke off", f"check the network, then {GO_ON}"),
    (r"Permission denied|Errno 13|WinError 5|WinError 32",
     "a file of the engine cannot be written",
     "close other Blenders and reconstructions that use the engine, then press Install Engine"),
)  # fmt: skip


class Pip:
    """pip of one environment, with what its version can do."""

    def __init__(self, place: Place, wheels: Path | None) -> None:
        """Nothing is run yet."""
        self._place = place
        self._wheels = wheels

    @property
    def can_resume(self) -> bool:
        """Whether it goes on with a file whose download broke off."""
        return self._version >= _RESUMES

    @property
    def _version(self) -> tuple[int, ...]:
        found = re.match(r"(\d+)\.(\d+)", self._installed().get("pip", ""))
        return tuple(map(int, found.groups())) if found else (0, 0)

    def _installed(self) -> dict[str, str]:
        """Versions of the environment's packages by name."""
        found = distributions(path=[str(self._place.site_packages)])
        return {item.metadata["Name"].lower(): item.version for item in found}

    def install(
        self, words: Sequence[str], expected_bytes: int, progress: Progress, name: str
    ) -> None:
        """Install packages; what is there already is left alone."""
        options = ["--only-binary", ":all:", "--no-input", "--no-color", "--progress-bar"]
        options += ["raw" if self._version >= _RAW_PROGRESS else "off"]
        options += ["--cache-dir", str(self._place.cache)]
        if self._wheels is not None:
            options += ["--isolated", "--no-index", "--find-links", str(self._wheels)]
        elif self.can_resume:
            options += ["--resume-retries", "20"]
        meter = _Meter(expected_bytes, progress, name)
        code, tail = self._run(["install", *options, *words], meter)
        if code != 0:
            raise self._reason(name, tail)

    def uninstall(self, *names: str) -> None:
        """Remove packages that are there."""
        there = self._installed().keys() & set(names)
        if there:
            self._run(["uninstall", "--yes", *there])

    def _run(
        self, words: Sequence[str], on_line: Callable[[str], object] = str
    ) -> tuple[int, Sequence[str]]:
        """Run pip; the code it ended with and its last lines. Stopped when this is stopped."""
        # A file of settings may name another folder, another Python or another index.
        environment = clean_environment() | {
            "PIP_CONFIG_FILE": os.devnull,
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
            "PYTHONUTF8": "1",
            # the system's place for temporary files may be small, and a stopped pip clears nothing
            **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(self._place.unfinished)),
        }
        self._place.unfinished.mkdir(parents=True, exist_ok=True)
        tail: deque[str] = deque(maxlen=TAIL)
        process = None
        with self._place.log.open("a", encoding="utf-8") as log:
            try:
                with _stops_held():
                    process = subprocess.Popen(
                        [self._place.python, "-P", "-u", "-m", "pip", *words],
                        stdin=subprocess.DEVNULL,
                        stdout=subprocess.PIPE,
                        stderr=subprocess.STDOUT,
                        text=True,
                        encoding="utf-8",
                        errors="replace",
                        env=environment,
                        cwd=self._place.root,
                        creationflags=QUIETLY,
                    )
                with cast("IO[str]", process.stdout) as lines:
                    for line in lines:
                        if not line.startswith("Progress "):
                            log.write(line)
                            tail.append(line.strip())
                        on_line(line.strip())
                return process.wait(), tail
            except BaseException:
                if process is not None:
                    with process:  # waits for it and closes its pipe
                        process.kill()
                raise

    def _reason(self, name: str, tail: Sequence[str]) -> EngineError:
        """Why pip failed, for the user."""
        text = "\n".join(tail)
        for pattern, message, cure in _REASONS:
            if re.search(pattern, text, re.IGNORECASE):
                return EngineError(f"{message} while {name} was installed", cure)
        # pip calls it a conflict where the one version that the constraints allow is not there
        lacking = re.findall(r"No matching distribution found for (\S+)", text) or re.findall(
            r"The user requested \(constraint\) (\S+)", text
        )
        if lacking and self._wheels is not None:
            return EngineError(
                f"the folder of wheels lacks {', '.join(lacking)} for this Python",
                f"put it into {self._wheels}",
            )
        if lacking:
            release = "{}.{}".format(*sys.version_info[:2])
            return EngineError(
                f"nobody offers {', '.join(lacking)} for Python {release} on this system",
                "make an environment of Python {}.{} to {}.{} with robir in it, and ".format(
                    *OLDEST, *NEWEST
                )
                + CHOOSE_EXISTING,
            )
        errors = [line for line in tail if line.startswith("ERROR:")] or list(tail)[-1:]
        said = errors[-1].removeprefix("ERROR: ") if errors else "it says nothing"
        return EngineError(
            f"{name} could not be installed ({said})", f"see {self._place.log.name}, then {GO_ON}"
        )


@contextmanager
def _stops_held() -> Iterator[None]:
    """Keep a request to stop until the end of the block: in the midst of it pip would go astray."""
    caught: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: caught.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if caught:
        raise KeyboardInterrupt


class _Meter:
    """Reads pip's lines as progress."""

    def __init__(self, expected_bytes: int, progress: Progress, name: str) -> None:
        self._expected = expected_bytes
        self._progress = progress
        self._name = name
        self._file = ""
        self._finished = self._current = 0
        progress(0.0, f"looking for {name}")

    def __call__(self, line: str) -> None:
        counted = re.fullmatch(r"Progress (\d+) of (\d+)", line)
        if counted:
            done, total = int(counted[1]), int(counted[2])
            self._current = done
            text = f"{self._file}, {done / MEBIBYTE:.0f} of {total / MEBIBYTE:.0f} MB"
            self._progress(self._share(), f"downloading {text}")
        elif found := re.match(r"(?:Downloading|Using cached|Processing) (.+\.whl)", line):
            self._finished, self._current = self._finished + self._current, 0
            wheel = re.split(r"[/\\]", found[1])[-1].replace("%2B", "+")  # of an address or path
            self._file = " ".join(wheel.split("-")[:2])
            self._progress(self._share(), f"fetching {self._file}")
        elif line.startswith("Installing collected packages"):
            self._progress(0.92, f"unpacking {self._name}, which takes a while")

    def _share(self) -> float:
        return 0.9 * min(1.0, (self._finished + self._current) / self._expected)
