# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a Python that the user already has can serve as the engine."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .errors import EngineError
from .places import IS_WINDOWS, OLDEST, clean_environment, python_in

QUIETLY = getattr(subprocess, "CREATE_NO_WINDOW", 0)
"""Keeps Windows from opening a console for a subprocess."""

_SECONDS = 60

_PROBE = """
import json, sys
from importlib.metadata import PackageNotFoundError, version
sys.path = [place for place in sys.path if place]
facts = {"python": list(sys.version_info[:3]), "robir": None}
try:
    import robir
    facts["robir"] = getattr(robir, "__version__", "unknown")
except ImportError:
    pass
for name in ("torch", "numpy"):
    try:
        facts[name] = version(name)
    except PackageNotFoundError:
        facts[name] = None
print(json.dumps(facts))
"""


@dataclass(frozen=True)
class Facts:
    """What a Python has.

    Attributes:
        python: Its version, such as "3.11.7".
        robir: Version of the core.
        torch: Version of torch.
        numpy: Version of numpy.
    """

    python: str
    robir: str
    torch: str
    numpy: str


def interpreter(given: Path) -> Path:
    """The interpreter that a path means: itself, or that of an environment's folder.

    Raises:
        EngineError: If there is none.
    """
    found = python_in(given) if given.is_dir() else given
    if found.is_file():
        return found
    name = "Scripts\\python.exe" if IS_WINDOWS else "bin/python"
    raise EngineError(
        f"{found} does not exist",
        f"choose the environment's {name} in the add-on's preferences",
    )


def inspect(python: Path, version: str) -> Facts:
    """Run a Python and see that it has what the engine needs.

    Args:
        python: Interpreter.
        version: The one version of robir that fits this add-on.

    Raises:
        EngineError: If it does not run or lacks something; the cure names the command.
    """
    facts = _probe(python)
    release = ".".join(map(str, facts["python"]))
    if tuple(facts["python"]) < OLDEST:
        raise EngineError(
            f"{python} is Python {release}, RobIR needs {'.'.join(map(str, OLDEST))} or newer",
            "choose another environment",
        )
    pip = f'"{python}" -m pip install'
    if facts["robir"] is None:
        raise EngineError(
            f"{python} has no robir", f"install it there: {pip} and the robir {version} wheel"
        )
    if facts["robir"] != version:
        raise EngineError(
            f"{python} has robir {facts['robir']}, this add-on needs {version}",
            f"install the same version there: {pip} and the robir {version} wheel",
        )
    for name in ("torch", "numpy"):
        if facts[name] is None:
            raise EngineError(f"{python} has no {name}", f"install it there: {pip} {name}")
    return Facts(release, facts["robir"], facts["torch"], facts["numpy"])


def _probe(python: Path) -> dict:
    """What the interpreter says of itself."""
    cure = "choose another one in the add-on's preferences"
    try:
        done = subprocess.run(
            [python, "-c", _PROBE],
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=_SECONDS,
            check=False,
            env=clean_environment(),
            creationflags=QUIETLY,
        )
    except subprocess.TimeoutExpired:
        raise EngineError(f"{python} gives no answer in {_SECONDS} s", cure) from None
    except OSError as fault:
        raise EngineError(f"{python} cannot be run ({fault.strerror})", cure) from fault
    try:
        return json.loads(done.stdout)
    except ValueError:
        said = (done.stderr.strip().splitlines() or ["it says nothing"])[-1]
        raise EngineError(f"{python} is not a Python that works ({said})", cure) from None
