# SPDX-License-Identifier: Apache-2.0
"""Wheels to install from without a network, and an index that can break off.

The wheel of robir is the real one. Those of what it needs bear the right names and versions and
hold next to nothing: that is all pip's resolver looks at.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
CONSTRAINTS = ROOT / "constraints.txt"


@dataclass(frozen=True)
class Source:
    """What is installed from: the wheel of robir, and folders of wheels."""

    robir: Path
    wheels: Path
    cuda_wheels: Path
    hashes: Path


def build_robir(folder: Path) -> Path:
    """The real wheel of the core."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    (wheel,) = folder.glob("robir-*.whl")
    return wheel


def stand_ins(folder: Path, label: str = "cpu", leave_out: tuple[str, ...] = ()) -> Path:
    """Fill a folder with stand-ins for everything that robir needs.

    Args:
        folder: Made if it is missing.
        label: Local version of torch, such as "cpu" or "cu130".
        leave_out: Packages that are not made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {}
    for line in CONSTRAINTS.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            pin = Requirement(line)
            if pin.marker is None or pin.marker.evaluate():
                pins[plain(pin.name)] = str(pin.specifier).removeprefix("==")
    for requirement in project["dependencies"] + project["optional-dependencies"]["photos"]:
        name = Requirement(requirement).name
        if plain(name) in leave_out:
            continue
        version = pins[plain(name)] + (f"+{label}" if name == "torch" else "")
        write_wheel(folder, name, version, size=300_000 if name == "torch" else 0)
    return folder


def plain(name: str) -> str:
    return name.lower().replace("-", "_")


def write_wheel(folder: Path, name: str, version: str, size: int = 0) -> Path:
    """A wheel with one module and as many bytes as wanted."""
    module, info = plain(name), f"{plain(name)}-{version}.dist-info"
    file = folder / f"{module}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(f"{module}/__init__.py", f"__version__ = {version!r}\n")
        archive.writestr(f"{module}/padding", bytes(size))
        facts = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        archive.writestr(f"{info}/METADATA", facts)
        tags = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        archive.writestr(f"{info}/WHEEL", tags)
        archive.writestr(f"{info}/RECORD", "")
    return file


def write_hashes(folder: Path, wheels: Path) -> Path:
    """The lists of what an index may give, for one that offers the wheels of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lists: dict[str, str] = {"hashes.txt": "", "hashes-torch.txt": "", "hashes-pip.txt": ""}
    for wheel in sorted(wheels.glob("*.whl")):
        name, version = wheel.name.split("-")[:2]
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        line = f"{name}=={version} --hash=sha256:{digest}\n"
        lists["hashes-torch.txt" if name == "torch" else "hashes.txt"] += line
    for name, text in lists.items():
        (folder / name).write_text(text)
    return folder


@dataclass
class Index:
    """A package index on this machine."""

    url: str = ""  # its address
    asked: list[str] = field(default_factory=list)  # paths that were asked for
    # names of files of which, once each, only half is sent
    break_off: set[str] = field(default_factory=set)


@contextmanager
def serve(folder: Path) -> Iterator[Index]:
    """Offer the wheels of a folder as an index does."""
    index = Index()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            index.asked.append(self.path)
            words = [word for word in self.path.replace("%2B", "+").split("/") if word]
            file = folder / words[-1]
            if words[0] == "files" and file.is_file():
                self.answer(file.read_bytes(), "application/octet-stream", file.name)
                return
            found = sorted(folder.glob(f"{plain(words[-1])}-*.whl"))
            page = "".join(f'<a href="/files/{path.name}">{path.name}</a>' for path in found)
            if found:
                self.answer(page.encode(), "text/html")
            else:
                self.send_error(404)

        def answer(self, content: bytes, kind: str, name: str = ""):
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "max-age=3600" if name else "no-cache")
            self.end_headers()
            if name in index.break_off:
                index.break_off.remove(name)
                content = content[: len(content) // 2]
                self.close_connection = True
            self.wfile.write(content)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    index.url = f"http://127.0.0.1:{server.server_port}/"
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield index
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
