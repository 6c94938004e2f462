# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the engine's files, and what its subprocesses may inherit."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .errors import EngineError

IS_WINDOWS = os.name == "nt"
CHOOSE_EXISTING = "choose an existing environment in the add-on's preferences"

# releases of Python for which all that the engine consists of is offered
OLDEST, NEWEST = (3, 11), (3, 13)
_ADDON = Path(__file__).parents[1]

# variables besides Python's and pip's own that lead another Python astray
_LEAKS = ("__PYVENV_LAUNCHER__",)
# what pip is told of the network it is in; nothing else of its settings is passed on
_PIP_KEEPS = frozenset(
    f"PIP_{name}"
    for name in (
        *("CERT", "CLIENT_CERT", "PROXY", "TIMEOUT", "DEFAULT_TIMEOUT", "RETRIES"),
        *("INDEX_URL", "TRUSTED_HOST"),
    )
)


class _Below:
    """A file or folder of fixed name below the `root` of what has it as an attribute."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, owner: Any, kind: Any = None) -> Path:
        return owner.root / self._name


@dataclass(frozen=True)
class Place:
    """Names of the managed engine's files, below its folder; nothing else may spell them."""

    root: Path

    marker = _Below("robir-engine.txt")  # says that the folder is ours; written first
    record = _Below("engine.json")  # what was installed; written last, so absent where unfinished
    environment = _Below("env")  # the virtual environment
    whole = _Below("env/robir-whole")  # says that the environment was made to its end
    cache = _Below("downloads")  # finished ones, kept until the installation is done
    unfinished = _Below("downloads/unfinished")  # pip works there; a stopped one leaves its parts
    log = _Below("install.log")  # all that pip said, for a report
    lock = _Below("lock")  # held by the one process that installs or removes

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return python_in(self.environment)

    @property
    def site_packages(self) -> Path:
        """Where the environment keeps its packages."""
        if IS_WINDOWS:
            return self.environment / "Lib/site-packages"
        found = sorted(self.environment.glob("lib/python*/site-packages"))
        return found[0] if found else self.environment / "lib"


def python_in(environment: Path) -> Path:
    """Where a virtual environment has its interpreter on this system."""
    return environment / ("Scripts/python.exe" if IS_WINDOWS else "bin/python")


def bundled_wheel() -> Path | None:
    """The wheel of the core that this extension brings; None in a checkout, which has none."""
    wheels = sorted((_ADDON / "wheels").glob("robir-*.whl"))
    return wheels[-1] if wheels else None


def constraints() -> Path:
    """The versions that were tested: beside this file in the extension, else the checkout's."""
    shipped = Path(__file__).with_name("constraints.txt")
    return shipped if shipped.is_file() else _ADDON.parent / "constraints.txt"


def clean_environment(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Variables for a Python that is not Blender's.

    What steers Python (PYTHONPATH, PYTHONHOME and the like) is meant for the Python it was set for,
    and another one finds wrong modules, or none, with it.
    """
    return {
        name: value
        for name, value in environment.items()
        if not name.upper().startswith("PYTHON")
        and name.upper() not in _LEAKS
        and (not name.upper().startswith("PIP_") or name.upper() in _PIP_KEEPS)
    }


def worker_command(*words: str, module: str = "install", python: Path | None = None) -> list[str]:
    """Command that runs a module of this package apart from Blender."""
    if python is None:
        python = _own_python()
    if python is None:
        raise EngineError("this Blender comes without a Python to run", CHOOSE_EXISTING)
    boot = (
        f"import sys; sys.path.append(sys.argv.pop(1)); from engine.{module} import main; "
        "raise SystemExit(main())"
    )
    return [str(python), "-I", "-c", boot, str(_ADDON), *words]


def base_python() -> Path:
    """The Python that the engine's environment is made of.

    Blender's own, or, as the engine is a process of its own anyway, one that this machine has
    besides where the engine's parts are not offered for Blender's.
    """
    own = _own_python()
    if own is not None and OLDEST <= sys.version_info[:2] <= NEWEST:
        return own
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        found = _installed_python(minor)
        if found is not None:
            return found
    release, newest = ("{}.{}".format(*version) for version in (sys.version_info, NEWEST))
    text = "the engine's parts are not offered for Python {release}, Blender's own"
    cure = (
        "install Python {newest} beside it (on Debian and Ubuntu the package python{newest}-venv, "
        "else from python.org), then press Install Engine"
    )
    raise EngineError(text, cure, release=release, newest=newest)


def _own_python() -> Path | None:
    """Blender's Python, where it comes as a program."""
    own = Path(sys.executable or "")
    return own if own.stem.lower().startswith("python") else None


def _installed_python(minor: int) -> Path | None:
    """A Python 3.minor of this machine that can make environments; None if it has none."""
    names = [["py", f"-3.{minor}"]] if IS_WINDOWS else [[f"python3.{minor}"]]
    for name, *rest in names:
        program = shutil.which(name)
        if program is None:
            continue
        try:
            said = subprocess.run(
                [program, *rest, "-I", "-c", "import ensurepip, sys; print(sys.executable)"],
                capture_output=True,
                text=True,
                timeout=20,
                check=True,
                env=clean_environment(),
            )
        except (OSError, subprocess.SubprocessError):
            continue  # it is broken, or lacks what makes environments
        return Path(said.stdout.strip())
    return None


# keeps Windows from opening a console for a subprocess
QUIETLY = getattr(subprocess, "CREATE_NO_WINDOW", 0)
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
    text = "{found} does not exist"
    cure = "choose the environment's {name} in the add-on's preferences"
    raise EngineError(text, cure, found=found, name=name)


def inspect(python: Path, version: str) -> Facts:
    """Run a Python and see that it has what the engine needs."""
    facts = _probe(python)
    release = ".".join(map(str, facts["python"]))
    if tuple(facts["python"]) < OLDEST:
        text = "{python} is Python {release}, RobIR needs {oldest} or newer"
        cure = "choose another environment"
        raise EngineError(
            text, cure, python=python, release=release, oldest=".".join(map(str, OLDEST))
        )
    known = {"python": python, "version": version, "found": facts["robir"]}
    known["pip"] = f'"{python}" -m pip install'
    cure = "install it there: {pip} and the robir {version} wheel"
    if facts["robir"] is None:
        raise EngineError("{python} has no robir", cure, **known)
    if facts["robir"] != version:
        text = "{python} has robir {found}, this add-on needs {version}"
        raise EngineError(text, cure, **known)
    for name in ("torch", "numpy"):
        if facts[name] is None:
            text = "{python} has no {name}"
            raise EngineError(text, "install it there: {pip} {name}", name=name, **known)
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
