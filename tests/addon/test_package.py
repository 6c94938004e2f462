# SPDX-License-Identifier: Apache-2.0
"""The extension as a package: built, checked, installed, updated and removed in every Blender."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from addon.blenders import MODULE, ROOT, VERSIONS, run

import robir

pytestmark = pytest.mark.blender

COMMON = f"""
import os, sys
import bpy
import addon_utils

MODULE = {MODULE!r}


def install(archive, enable=True):
    return list(bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=enable))


def is_enabled():
    return MODULE in bpy.context.preferences.addons.keys()


def own_classes():
    return {{
        value for name, module in list(sys.modules.items()) if name.startswith(MODULE)
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, bpy.types.bpy_struct)
        and value.__module__ == name
    }}


def try_to_enable():
    faults = []
    addon_utils.enable(MODULE, default_set=True, handle_error=faults.append)
    return [str(fault) for fault in faults]
"""

LIFE = """
import importlib.metadata


def registered(classes):
    return sorted(cls.__name__ for cls in classes if cls.is_registered)


def blender_python(site_packages):
    import numpy

    files = [
        (os.path.join(folder, name), os.path.getsize(os.path.join(folder, name)))
        for folder, _, names in os.walk(site_packages)
        for name in names if not name.endswith(".pyc")
    ]
    distributions = importlib.metadata.distributions(path=[site_packages])
    return [
        numpy.__version__,
        numpy.__file__,
        sorted(f"{d.name} {d.version}" for d in distributions),
        sorted(files),
    ]


def main(archive, site_packages):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    answer = {}
    python, paths = blender_python(site_packages), list(sys.path)
    answer["installed"] = install(archive)
    answer["enabled"] = is_enabled()
    classes = own_classes()
    answer["classes"] = sorted(cls.__name__ for cls in classes)
    answer["registered"] = [registered(classes)]
    import robir
    answer["robir"] = robir.__file__
    answer["loaded"] = sorted({name.partition(".")[0] for name in sys.modules})
    bpy.ops.preferences.addon_disable(module=MODULE)
    answer["registered"].append(registered(classes | own_classes()))
    answer["pointers"] = [hasattr(t, "robir") for t in (bpy.types.Scene, bpy.types.WindowManager)]
    bpy.ops.preferences.addon_enable(module=MODULE)
    answer["registered"].append(registered(own_classes()))
    (index,) = [
        i for i, repo in enumerate(bpy.context.preferences.extensions.repos)
        if repo.module == "user_default"
    ]
    bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="robir")
    answer["registered"].append(registered(classes | own_classes()))
    answer["left"] = sorted(
        os.path.join(folder, name)
        for folder, _, names in os.walk(os.environ["BLENDER_USER_RESOURCES"])
        for name in names if "robir" in os.path.join(folder, name)
    )
    answer["python"] = "as before" if blender_python(site_packages) == python else "changed"
    return answer
"""


def test_the_zip_is_small_and_holds_no_bench(extension_zip):
    with zipfile.ZipFile(extension_zip) as archive:
        names = archive.namelist()
        sample = sum(i.file_size for i in archive.infolist() if i.filename.startswith("sample/"))
        (wheel,) = (name for name in names if name.endswith(".whl"))
        with archive.open(wheel) as stream, zipfile.ZipFile(stream) as inner:
            rooms = {name.partition("/")[0] for name in inner.namelist()}
    assert extension_zip.stat().st_size < 8_000_000
    assert 0 < sample < 6_000_000
    assert "robir" in rooms and "robir_bench" not in rooms


@pytest.mark.parametrize("blender", VERSIONS, indirect=True)
def test_install_disable_enable_uninstall(blender, extension_zip, tmp_path):
    user = tmp_path / "user"
    answer = run(blender, COMMON + LIFE, str(extension_zip), str(blender.site_packages), user=user)
    assert answer["installed"] == ["FINISHED"]
    assert answer["enabled"]
    assert {"ROBIR_PG_settings", "ROBIR_PG_state"} <= set(answer["classes"])
    assert answer["registered"] == [answer["classes"], [], answer["classes"], []]
    assert answer["pointers"] == [False, False]
    local = user / "extensions" / ".local"
    assert Path(answer["robir"]).is_relative_to(local), "robir came from elsewhere"
    assert answer["left"] == []
    assert answer["python"] == "as before"
    assert not {"torch", "scipy", "rich", "skimage", "trimesh"} & set(answer["loaded"])


UPDATE = """
def main(*archives):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    found = []
    for archive in archives:
        install(archive)
        assert is_enabled()
        gateway = sys.modules[MODULE + ".gateway"]
        found.append([gateway.__version__, sys.modules["robir"].__doc__.strip()])
    return found
"""

FROM_REPOSITORY = """
def main(url, newer, served):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.system.use_online_access = True  # asked for though the file is local
    bpy.ops.preferences.extension_repo_add(type="REMOTE", remote_url=url, name="own")
    repositories = bpy.context.preferences.extensions.repos
    index = [repository.remote_url for repository in repositories].index(url)
    module = f"bl_ext.{repositories[index].module}.robir"
    bpy.ops.extensions.repo_sync(repo_index=index)
    bpy.ops.extensions.package_install(repo_index=index, pkg_id="robir")
    versions = [sys.modules[module + ".gateway"].__version__]
    os.rename(served, served + " before")
    os.rename(newer, served)
    bpy.ops.extensions.repo_sync(repo_index=index)
    bpy.ops.extensions.package_upgrade_all()
    versions.append(sys.modules[module + ".gateway"].__version__)
    return versions
"""

FOREIGN = """
def main(archive, foreign):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    install(archive, enable=False)
    sys.path.insert(0, foreign)
    answer = {"said": try_to_enable(), "enabled": is_enabled()}
    sys.path.remove(foreign)
    answer["cured"] = try_to_enable() or is_enabled()
    return answer
"""


@pytest.fixture(scope="module")
def newer_tree(tmp_path_factory):
    """The parts of the checkout that a build needs, elsewhere, with a version of its own."""
    tree = tmp_path_factory.mktemp("newer") / "a tree's copy"
    skip = shutil.ignore_patterns("__pycache__")
    for folder in ("core", "robir_addon", "LICENSES"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=skip)
    for file in ("build_addon.py", "constraints.txt", "pyproject.toml", "README.md"):
        shutil.copyfile(ROOT / file, tree / file)
    init = tree / "core/robir/__init__.py"
    text = init.read_text(encoding="utf-8").replace(robir.__version__, "98.7.6")
    init.write_text(text, encoding="utf-8")
    return tree


def build(tree, *arguments):
    command = [sys.executable, tree / "build_addon.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd="/")


@pytest.fixture(scope="module")
def archives(extension_zip, newer_tree, tmp_path_factory) -> list[str]:
    """This version, a newer one, and that one built again from other sources."""
    folder = tmp_path_factory.mktemp("archives")
    assert build(newer_tree, "--out", folder / "newer").returncode == 0
    newer = folder / "newer" / "robir-98.7.6.zip"
    tree = folder / "rebuilt"
    shutil.copytree(newer_tree, tree)
    init = tree / "core/robir/__init__.py"
    text = init.read_text(encoding="utf-8")
    init.write_text(text.replace('"""RobIR:', '"""Rebuilt:'), encoding="utf-8")
    assert build(tree, "--out", folder / "again").returncode == 0
    return [str(archive) for archive in (extension_zip, newer, folder / "again" / newer.name)]


def test_update_within_one_session(blender, archives, tmp_path):
    """The old version's modules are loaded when the new one starts; so are those of a rebuild."""
    found = run(blender, COMMON + UPDATE, *archives, user=tmp_path / "user")
    assert [version for version, _ in found] == [robir.__version__, "98.7.6", "98.7.6"]
    assert [text.partition(":")[0] for _, text in found] == ["RobIR", "RobIR", "Rebuilt"]


def test_blender_updates_from_the_repository(own_blender, extension_zip, newer_tree, tmp_path):
    assert build(newer_tree, "--out", tmp_path).returncode == 0
    served = tmp_path / "served"
    shutil.copytree(extension_zip.parent / "repository", served)
    versions = run(
        own_blender,
        COMMON + FROM_REPOSITORY,
        (served / "index.json").as_uri(),
        str(tmp_path / "repository"),
        str(served),
        user=tmp_path / "user",
    )
    assert versions == [robir.__version__, "98.7.6"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("__version__ = '0.0.9'", "another package named robir"),
        (None, "finds 0.0.9"),
    ],
)
def test_a_foreign_robir_is_refused_in_words(extension_zip, tmp_path, content, words, own_blender):
    foreign = tmp_path / "foreign"
    package = foreign / "robir"
    if content is None:
        shutil.copytree(ROOT / "core/robir/jobs", package / "jobs")
        shutil.copyfile(ROOT / "core/robir/errors.py", package / "errors.py")
        content = "__version__ = '0.0.9'"
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").write_text(content, encoding="utf-8")
    answer = run(
        own_blender, COMMON + FOREIGN, str(extension_zip), str(foreign), user=tmp_path / "user"
    )
    (sentence,) = answer["said"]
    assert words in sentence
    assert str(package) in sentence
    assert not answer["enabled"]
    assert answer["cured"] is True


def contents(archive):
    with zipfile.ZipFile(archive) as file:
        return {name: file.read(name) for name in file.namelist()}


def test_what_the_zip_holds(extension_zip):
    files = contents(extension_zip)
    manifest = tomllib.loads(files["blender_manifest.toml"].decode())
    assert manifest["version"] == robir.__version__
    (wheel,) = manifest["wheels"]
    assert wheel.removeprefix("./") in files
    assert files["engine/constraints.txt"] == (ROOT / "constraints.txt").read_bytes()
    assert {"__init__.py", "gateway.py", "LICENSE"} <= set(files)
    allowed = (".po", ".py", ".toml", ".txt", ".whl", "LICENSE", "sbom.cdx.json")
    code = [name for name in files if not name.startswith("sample/")]
    assert [name for name in code if not name.endswith(allowed)] == []
    sample = {name: content for name, content in files.items() if name.startswith("sample/")}
    kinds = {name.rpartition(".")[2] for name in sample}
    assert kinds == {"exr", "glb", "json", "png", "txt", "webp"}
    assert max(map(len, sample.values())) < 1_500_000
    (licence,) = (content for name, content in sample.items() if name.endswith("README.txt"))
    assert b"CC0 1.0" in licence


def test_the_zip_says_what_it_is_made_of(extension_zip):
    files = contents(extension_zip)
    bill = json.loads(files["sbom.cdx.json"])
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")
    core, *needed = bill["components"]
    (wheel,) = (name for name in files if name.endswith(".whl"))
    assert core["hashes"][0]["content"] == hashlib.sha256(files[wheel]).hexdigest()
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {line.partition(";")[0].strip() for line in pins if "==" in line}
    assert {f"{part['name']}=={part['version']}" for part in needed} == pinned


def test_the_same_tree_gives_the_same_zip(newer_tree, tmp_path):
    assert build(newer_tree, "--out", tmp_path / "a").returncode == 0
    again = tmp_path / "again"
    shutil.copytree(newer_tree, again)
    (again / "robir_addon/__pycache__").mkdir()
    (again / "robir_addon/__pycache__/rest.pyc").write_bytes(b"rest")
    assert build(again, "--out", tmp_path / "b").returncode == 0
    first, second = (tmp_path / name / "robir-98.7.6.zip" for name in "ab")
    assert first.read_bytes() == second.read_bytes()


WITHOUT_INSTALLER = """
def main(archive, python):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    install(archive)
    preferences = bpy.context.preferences.addons[MODULE].preferences
    engine = sys.modules[MODULE + ".preferences"]
    answer = {"engine": preferences.engine, "before": engine.engine_status(bpy.context).text}
    answer["may_install"] = bpy.ops.robir.install_engine.poll()
    preferences.python = python
    answer["after"] = engine.engine_status(bpy.context).state
    return answer
"""


def test_the_platform_gets_an_add_on_that_installs_nothing(newest, tmp_path):
    page = "https://example.org/robir"
    done = build(ROOT, "--out", tmp_path, "--without-installer", "--website", page)
    assert done.returncode == 0, done.stderr
    (archive,) = tmp_path.glob("*.zip")
    files = contents(archive)
    manifest = tomllib.loads(files["blender_manifest.toml"].decode())
    assert manifest["website"] == page and "network" not in manifest["permissions"]
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later", "SPDX:CC0-1.0", "SPDX:Apache-2.0"]
    assert not {"engine/install.py", "engine/pip.py", "engine/hashes.txt"} & files.keys()
    words = str(archive), sys.executable
    answer = run(newest, COMMON + WITHOUT_INSTALLER, *words, user=tmp_path / "user")
    assert answer["engine"] == "EXISTING" and not answer["may_install"]
    assert answer["before"] == "No existing environment is chosen" and answer["after"] == "ready"


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('"Lighting"', '"Nonsense"', "Nonsense"),
        ('id = "robir"', 'id = "rob-ir"', "Not a valid identifier"),
        ('version = "0.0.0"', 'version = "1.0.0"', "to fill in"),
    ],
)
def test_a_bad_manifest_builds_nothing(newer_tree, tmp_path, before, after, words):
    tree = tmp_path / "tree"
    shutil.copytree(newer_tree, tree)
    manifest = tree / "robir_addon/blender_manifest.toml"
    text = manifest.read_text(encoding="utf-8")
    assert before in text
    manifest.write_text(text.replace(before, after), encoding="utf-8")
    done = build(tree, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert words in done.stderr
    assert list((tmp_path / "out").iterdir()) == []
