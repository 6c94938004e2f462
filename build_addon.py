# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the Blender extension: `python build_addon.py [--out DIR] [--install BLENDER]`.

For Blender's extensions platform, which wants nothing installed at run time, `--without-installer`
leaves out Install Engine: that add-on uses an engine that is there. `--website URL` is the page
that Blender's list of extensions links to.

DIR/robir-VERSION.zip is the extension: the add-on, the `robir` wheel and a filled-in manifest. One
zip serves every Blender from 4.2 on, on every system, for nothing in it is compiled.
DIR/repository is a folder for any web server; a Blender that has its address as a repository
updates the extension by itself. Both are made and checked by Blender's own packaging tool, which
lies in the bpy wheel and needs no Blender to run. The same tree gives the same bytes.
"""

import argparse
import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
SOURCE = ROOT / "robir_addon"
EPOCH = (1980, 1, 1, 0, 0, 0)
BILL = "sbom.cdx.json"
COMPILED = (".so", ".pyd", ".dll", ".dylib")
INSTALLER = ("install.py", "pip.py", "remove.py", "hashes*.txt")


class BuildError(Exception):
    """Something is missing or wrong; the message says what and what to do."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Build, and install where asked for; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="default dist")
    parser.add_argument(
        "--install", metavar="BLENDER", help="executable of the Blender to install it in"
    )
    parser.add_argument("--website", metavar="URL", default="", help="for the manifest")
    parser.add_argument("--without-installer", action="store_true", help="leave out Install Engine")
    options = parser.parse_args(arguments)
    try:
        archive = build(options.out.resolve(), options.website, not options.without_installer)
        print(archive)
        if options.install:
            install(options.install, archive)
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def build(out: Path, website: str = "", installs: bool = True) -> Path:
    """Make the zip and the repository; what was there before stays until both are whole.

    Args:
        out: Folder for them; made if it is missing.
        website: For the manifest; empty for none.
        installs: Whether the add-on can install an engine.

    Returns:
        The zip.

    Raises:
        BuildError: If a tool is missing or finds a fault.
    """
    blender_ext, tags = _packaging_tool()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".building-", dir=out) as folder:
        work = Path(folder)
        stage, repository = work / "robir", work / "repository"
        wheel = _build_wheel(work)
        _stage(stage, wheel, website, installs)
        draft = work / "draft.zip"
        _tool(blender_ext, "build", "--source-dir", stage, "--output-filepath", draft)
        repository.mkdir()
        archive = repository / f"robir-{_version(wheel)}.zip"
        _repack(draft, archive)
        _tool(blender_ext, "validate", f"--valid-tags={tags}", archive)
        _tool(blender_ext, "server-generate", "--repo-dir", repository, "--html")
        shutil.copyfile(archive, work / archive.name)
        (work / archive.name).replace(out / archive.name)
        if (out / "repository").exists():
            (out / "repository").rename(work / "old")
        repository.rename(out / "repository")
    return out / archive.name


def install(blender: str, archive: Path) -> None:
    """Install and enable the zip in a Blender of this machine, for this user.

    Raises:
        BuildError: If that Blender cannot be run or refuses it.
    """
    _run([blender, "--command", "extension", "install-file", "-r", "user_default", "-e", archive])


def _packaging_tool() -> tuple[Path, Path]:
    """Blender's script for extensions and its list of tags, found without loading Blender."""
    found = importlib.util.find_spec("bpy")
    for place in (found and found.submodule_search_locations) or ():
        for script in Path(place).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"):
            return script, script.parents[3] / "modules/_bpy_internal/extensions/tags.py"
    raise BuildError(
        "Blender's packaging tool comes with the bpy wheel, which is not installed; run `make "
        "setup`, then .venv/bin/python build_addon.py"
    )


def _build_wheel(work: Path) -> Path:
    """Build the core's wheel, marked with its content, and make sure it runs on every system."""
    if importlib.util.find_spec("hatchling") is None:
        raise BuildError("hatchling, which builds the wheel, is not installed; run `make setup`")
    folder = work / "wheels"
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder]
    _run(build, ROBIR_BUILD=f"+b{_fingerprint(ROOT / 'core/robir')[:8]}")
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        compiled = [name for name in archive.namelist() if name.endswith(COMPILED)]
    if compiled or not wheel.name.endswith("-py3-none-any.whl"):
        raise BuildError(f"{wheel.name} holds compiled code and would run on one system only")
    return wheel


def _fingerprint(folder: Path) -> str:
    """A number for the content of a folder; Blender takes a wheel of the same version as known."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix != ".pyc":
            digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _version(wheel: Path) -> str:
    """Version of the extension: that of the wheel without the mark of its content."""
    return wheel.name.split("-")[1].partition("+")[0]


def _stage(stage: Path, wheel: Path, website: str, installs: bool) -> None:
    """Lay out what the zip will hold."""
    shutil.copytree(SOURCE, stage, ignore=shutil.ignore_patterns("__pycache__", "*.pyc", ".*"))
    for name in () if installs else INSTALLER:
        for file in (stage / "engine").glob(name):
            file.unlink()
    (stage / "wheels").mkdir()
    shutil.copyfile(wheel, stage / "wheels" / wheel.name)
    shutil.copyfile(ROOT / "constraints.txt", stage / "engine" / "constraints.txt")
    shutil.copyfile(ROOT / "LICENSES" / "GPL-3.0-or-later.txt", stage / "LICENSE")
    bill = json.dumps(_bill_of_materials(wheel), indent=2) + "\n"
    (stage / BILL).write_text(bill, encoding="utf-8")
    manifest = stage / "blender_manifest.toml"
    text = manifest.read_text(encoding="utf-8")
    blank, filled = (
        'version = "0.0.0"\n',
        f'version = "{_version(wheel)}"\nwheels = ["./wheels/{wheel.name}"]\n',
    )
    if text.count(blank) != 1:
        raise BuildError(f"{SOURCE / manifest.name} has no line {blank.strip()} to fill in")
    filled += f"website = {json.dumps(website)}\n" if website else ""
    text = text.replace(blank, filled)
    if not installs:
        text = re.sub(r"(?m)^network = .*\n", "", text)
    manifest.write_text(text, encoding="utf-8")


def _bill_of_materials(wheel: Path) -> dict[str, Any]:
    """What the zip holds and what its engine is installed from, in CycloneDX 1.5.

    Without a serial number and a date, so that equal trees give equal bytes.
    """
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    core = _component("robir", wheel.name.split("-")[1], "required")
    core["hashes"] = [{"alg": "SHA-256", "content": digest}]
    pins = [line.partition("#")[0].strip() for line in _constraints()]
    needed = []
    for pin in filter(None, pins):
        requirement, _, marker = pin.partition(";")
        name, _, version = requirement.strip().partition("==")
        component = _component(name, version, "optional")
        if marker:
            component["properties"] = [{"name": "python:marker", "value": marker.strip()}]
        needed.append(component)
    version = _version(wheel)
    addon = {"type": "application", "bom-ref": "robir-addon", "name": "RobIR for Blender"}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": {**addon, "version": version}},
        "components": [core, *needed],
    }


def _component(name: str, version: str, scope: str) -> dict[str, Any]:
    """A package of the Python index; optional is what the engine downloads."""
    address = f"pkg:pypi/{re.sub('[-_.]+', '-', name).lower()}@{version.replace('+', '%2B')}"
    facts = {"type": "library", "name": name, "version": version}
    return {"bom-ref": address, "purl": address, "scope": scope, **facts}


def _constraints() -> list[str]:
    return (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()


def _repack(draft: Path, archive: Path) -> None:
    """Write the same files in a fixed order with a fixed date, so that equal trees give equal zips.

    Blender's tool stores them in the order of the file system, with the dates of the files.
    """
    with zipfile.ZipFile(draft) as source, zipfile.ZipFile(archive, "w") as target:
        for name in sorted(source.namelist()):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            target.writestr(entry, source.read(name), compresslevel=9)


def _tool(script: Path, *arguments: str | Path) -> None:
    _run([sys.executable, "-B", script, *arguments])


def _run(command: Sequence[str | Path], **variables: str) -> None:
    """Run a command in the root of the checkout; what it says is shown only if it fails."""
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, **variables},
        )
    except OSError as fault:
        raise BuildError(f"{command[0]} cannot be run: {fault.strerror}") from fault
    if done.returncode != 0:
        said = (done.stdout + done.stderr).strip()
        raise BuildError(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{said}")


if __name__ == "__main__":
    sys.exit(main())
