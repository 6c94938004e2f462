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

_ANOTHER = "choose another one in the add-on's preferences"

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
    """Versions of what a Python has."""

    python: str
    robir: str
    torch: str
    numpy: str


def interpreter(given: Path) -> Path:
    """The interpreter that a path means: itself, or that of an environment's folder."""
    found = python_in(given) if given.is_dir() else given
    if found.is_file():
        return found
    name = "Scripts\\python.exe" if IS_WINDOWS else "bin/python"
    raise EngineError(
        "{found} does not exist",
        "choose the environment's {name} in the add-on's preferences",
        found=found,
        name=name,
    )


def inspect(python: Path, version: str) -> Facts:
    """Run a Python and see that it has what the engine needs."""
    facts = _probe(python)
    release = ".".join(map(str, facts["python"]))
    if tuple(facts["python"]) < OLDEST:
        raise EngineError(
            "{python} is Python {release}, RobIR needs {oldest} or newer",
            "choose another environment",
            python=python,
            release=release,
            oldest=".".join(map(str, OLDEST)),
        )
    pip = f'"{python}" -m pip install'
    if facts["robir"] is None:
        raise EngineError(
            "{python} has no robir",
            "install it there: {pip} and the robir {version} wheel",
            python=python,
            pip=pip,
            version=version,
        )
    if facts["robir"] != version:
        raise EngineError(
            "{python} has robir {found}, this add-on needs {version}",
            "install the same version there: {pip} and the robir {version} wheel",
            python=python,
            found=facts["robir"],
            version=version,
            pip=pip,
        )
    for name in ("torch", "numpy"):
        if facts[name] is None:
            raise EngineError(
                "{python} has no {name}",
                "install it there: {pip} {name}",
                python=python,
                name=name,
                pip=pip,
            )
    return Facts(release, facts["robir"], facts["torch"], facts["numpy"])


def _probe(python: Path) -> dict:
    """What the interpreter says of itself."""
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
        raise EngineError(
            "{python} gives no answer in {seconds} s", _ANOTHER, python=python, seconds=_SECONDS
        ) from None
    except OSError as fault:
        raise EngineError(
            "{python} cannot be run ({fault})", _ANOTHER, python=python, fault=fault.strerror
        ) from fault
    try:
        return json.loads(done.stdout)
    except ValueError:
        said = (done.stderr.strip().splitlines() or ["it says nothing"])[-1]
        raise EngineError(
            "{python} is not a Python that works ({said})", _ANOTHER, python=python, said=said
        ) from None
