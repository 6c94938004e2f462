# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the managed engine: a virtual environment of the running Python with torch and the core.

Run apart from Blender (`places.worker_command`). Standard output carries JSON lines {"progress":
0..1, "message": ...}, and at the end {"installed": {...}} or {"error": ..., "cure": ...}; an error
is also the last line of standard error. Exit codes: 0 done, 4 not possible, 130 cancelled.

Every step leaves alone what an earlier try has finished, so a broken installation goes on.
"""

import argparse
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import venv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import EngineError
from .pip import MEBIBYTE, Pip, Progress
from .places import CHOOSE_EXISTING, Place, inspect
from .remove import engine_lock
from .states import GO_ON, INSTALL, Record, read_record, wheel_hash, wheel_version, write_record

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
CUDA_INDEX = "https://download.pytorch.org/whl/cu130"

# versions and hashes: of what the core needs, of torch as the usual index has it, of pip
HASHES, TORCH_HASHES, PIP_HASHES = "hashes.txt", "hashes-torch.txt", "hashes-pip.txt"
# share of each step in the time
STEPS = {"environment": 0.04, "pip": 0.02, "robir": 0.27, "torch": 0.64, "check": 0.03}
TORCH_BYTES = {"CPU": 200 * MEBIBYTE, "CUDA": 2600 * MEBIBYTE}
OTHER_BYTES = 250 * MEBIBYTE
# room for the downloads, of which pip holds those of one step twice, and what they unpack to
NEEDED_BYTES = {"CPU": 3 << 30, "CUDA": 11 << 30}
_MARK = "RobIR's engine: made by the Blender add-on, removed by its preferences.\n"
_CANCELLED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Install; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        with _stopped_by_signals():
            record = install(
                options, lambda share, text: _say({"progress": round(share, 4), "message": text})
            )
    except EngineError as error:
        _say({"error": error.message, "cure": error.cure})
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        _say({"error": "The installation was cancelled", "cure": GO_ON})
        sys.stderr.write("cancelled\n")
        return _CANCELLED
    _say({"installed": vars(record)})
    return 0


def install(options: argparse.Namespace, progress: Progress) -> Record:
    """Bring the engine to the state the options ask for."""
    place = Place(options.root)
    if options.torch == "CUDA" and sys.platform == "darwin":
        raise EngineError("macOS has no CUDA", "choose CPU in the add-on's preferences")
    _take_folder(place)
    with engine_lock(place.lock):
        try:
            return _install(place, options, progress)
        except OSError as fault:
            raise EngineError(
                f"{fault.filename or place.root} cannot be written ({fault.strerror})",
                f"make room or mend the folder, then {GO_ON}",
            ) from fault


def _install(place: Place, options: argparse.Namespace, progress: Progress) -> Record:
    """The steps, in a folder that is ours and locked."""
    before = read_record(place)
    is_new = before is None or before.torch_build != options.torch
    if options.wheels is None and is_new:
        _refuse_little_room(place, options.torch)
    place.record.unlink(missing_ok=True)
    place.log.unlink(missing_ok=True)
    shutil.rmtree(place.unfinished, ignore_errors=True)
    pip = _environment_with_pip(place, options.wheels, _step(progress, "environment"))
    if options.wheels is None and not pip.can_resume:
        with suppress(EngineError):  # an old one works too, it begins a broken file again
            pip.install(_hashed(options, PIP_HASHES), 2 * MEBIBYTE, _step(progress, "pip"), "pip")
    if before is not None and before.torch_build != options.torch:
        pip.uninstall("torch")
    if before is None or before.wheel_sha256 != wheel_hash(options.wheel):
        pip.uninstall("robir")
    # torch last: what nobody offers for this Python is told before gigabytes are fetched
    pip.install(_robir_words(options), OTHER_BYTES, _step(progress, "robir"), "RobIR")
    pip.install(
        _torch_words(options), TORCH_BYTES[options.torch], _step(progress, "torch"), "torch"
    )
    _step(progress, "check")(0.0, "checking the engine")
    record = _checked(place, options)
    shutil.rmtree(place.cache, ignore_errors=True)
    write_record(place, record)
    return record


def _take_folder(place: Place) -> None:
    """Make the folder ours, or refuse one that is somebody else's."""
    try:
        place.root.mkdir(parents=True, exist_ok=True)
        if not place.marker.is_file():
            if any(place.root.iterdir()):
                raise EngineError(
                    f"{place.root} is not empty and not RobIR's", "move its files elsewhere"
                )
            place.marker.write_text(_MARK, encoding="utf-8")
    except OSError as fault:
        raise EngineError(
            f"{place.root} cannot be made ({fault.strerror})", "make it writable"
        ) from fault


def _environment_with_pip(place: Place, wheels: Path | None, progress: Progress) -> Pip:
    """The pip of the virtual environment; a whole one is kept, a broken one made anew."""
    progress(0.0, "making the environment")
    if place.python.exists() and place.whole.exists():
        return Pip(place, wheels)
    if importlib.util.find_spec("ensurepip") is None:
        release = "{}.{}".format(*sys.version_info[:2])
        raise EngineError(
            f"{sys.executable} has no ensurepip to make an environment with",
            f"install it (on Debian and Ubuntu the package python{release}-venv), then "
            f"{INSTALL}, or {CHOOSE_EXISTING}",
        )
    builder = venv.EnvBuilder(clear=True, symlinks=os.name != "nt", with_pip=True)
    try:
        builder.create(place.environment)
    except subprocess.CalledProcessError as fault:
        said = (fault.output or b"").decode(errors="replace").strip().splitlines() or [""]
        raise EngineError(
            f"{sys.executable} cannot make an environment ({said[-1]})", CHOOSE_EXISTING
        ) from fault
    place.whole.touch()
    return Pip(place, wheels)


def _torch_words(options: argparse.Namespace) -> list[str]:
    """The requirement of torch for the wanted device, and where that lies.

    The usual index has torch with CUDA for Linux and without it for Windows and macOS. The others
    lie in indexes of torch's own, under versions with a label; without the label pip would take the
    usual one, several times as large or unable to use the card, where such an index is out of
    reach. What torch needs besides comes from the usual index with the rest.
    """
    is_usual = {"linux": "CUDA", "win32": "CPU", "darwin": "CPU"}.get(sys.platform)
    if options.wheels is not None:
        return ["torch", "--constraint", str(options.constraints)]
    if options.torch == is_usual:
        return _hashed(options, TORCH_HASHES)
    label, index = ("cpu", CPU_INDEX) if options.torch == "CPU" else ("cu130", CUDA_INDEX)
    text = options.constraints.read_text(encoding="utf-8")
    version = re.search(r"^torch==([\w.]+)", text, re.MULTILINE)
    if version is None:
        raise EngineError(f"{options.constraints} does not pin torch", CHOOSE_EXISTING)
    return [f"torch=={version[1]}+{label}", "--no-deps", "--index-url", index]


def _robir_words(options: argparse.Namespace) -> list[str]:
    """The core with what it needs, for photographs alone too; what was tested, by its hash."""
    if options.wheels is not None:
        return [f"{options.wheel}[photos]", "--constraint", str(options.constraints)]
    address = f"{options.wheel.as_uri()}#sha256={wheel_hash(options.wheel)}"
    return [*_hashed(options, HASHES), f"robir @ {address}"]


def _hashed(options: argparse.Namespace, name: str) -> list[str]:
    """All packages of a list in the versions and with the hashes that it states, and no others."""
    return ["--require-hashes", "--no-deps", "--requirement", str(options.hashes / name)]


def _refuse_little_room(place: Place, build: str) -> None:
    """What was broken off goes on in any room: what it needs, it has fetched in part."""
    free, needed = shutil.disk_usage(place.root).free, NEEDED_BYTES[build]
    if free < needed and not place.cache.exists():
        raise EngineError(
            f"the disk of {place.root} has {free / 2**30:.1f} GB free, the engine needs about "
            f"{needed >> 30} GB",
            "make room, then press Install Engine",
        )


def _checked(place: Place, options: argparse.Namespace) -> Record:
    """What was installed, asked of the new interpreter itself."""
    facts = inspect(place.python, wheel_version(options.wheel))
    label = facts.torch.partition("+")[2]
    has_cuda = label.startswith("cu") or (not label and sys.platform == "linux")
    if options.torch == "CUDA" and not has_cuda:
        raise EngineError(
            f"only torch {facts.torch} was found, which knows no CUDA",
            "choose CPU in the add-on's preferences, or give a folder with torch for CUDA",
        )
    return Record(
        robir=facts.robir,
        wheel_sha256=wheel_hash(options.wheel),
        torch_build=options.torch,
        torch=facts.torch,
        numpy=facts.numpy,
        python=facts.python,
        size=_size(place.environment),
    )


def _size(folder: Path) -> int:
    """Bytes of all files below a folder."""
    files = (Path(parent, name) for parent, _, names in os.walk(folder) for name in names)
    return sum(file.lstat().st_size for file in files)


def _step(whole: Progress, step: str) -> Progress:
    """Progress of one step as a part of that of the whole."""
    names = list(STEPS)
    begin = sum(STEPS[name] for name in names[: names.index(step)])
    return lambda share, message: whole(begin + STEPS[step] * share, message)


def _absolute(text: str) -> Path:
    return Path(text).absolute()  # pip runs in another folder


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="engine.install")
    parser.add_argument("--root", type=_absolute, required=True, help="the engine's folder")
    parser.add_argument("--wheel", type=_absolute, required=True, help="wheel of the core")
    parser.add_argument("--constraints", type=_absolute, required=True, help="versions to take")
    own, text = Path(__file__).parent, "folder of the lists of what the network may give"
    parser.add_argument("--hashes", type=_absolute, default=own, help=text)
    parser.add_argument("--torch", choices=("CPU", "CUDA"), required=True)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--wheels", type=_absolute, help="folder of wheels; the network is left alone"
    )
    source.add_argument("--online", action="store_true", help="the user allows the network")
    return parser


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Let a request to end run the same way as Ctrl-C: pip is stopped, too."""

    def stop(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _say(report: dict[str, Any]) -> None:
    """One JSON line; when Blender is gone nobody listens, and the work is finished all the same."""
    try:
        sys.stdout.write(json.dumps(report) + "\n")
        sys.stdout.flush()
    except OSError:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
