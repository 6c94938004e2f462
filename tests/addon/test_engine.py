# SPDX-License-Identifier: Apache-2.0
"""The engine without Blender: made, broken off, gone on with, updated, removed; others' Pythons."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace

import pytest
from addon.wheelhouse import (
    CONSTRAINTS,
    ROOT,
    Source,
    build_robir,
    plain,
    serve,
    stand_ins,
    write_hashes,
)
from packaging.requirements import Requirement

import robir
from robir_addon.engine.errors import EngineError
from robir_addon.engine.places import Place, worker_command
from robir_addon.engine.remove import engine_lock, remove
from robir_addon.engine.states import read_record, status, write_record

UNUSUAL = "an 'engine' \"of\" Grüße & 漢字"


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Source:
    folder = tmp_path_factory.mktemp("house")
    wheels, cuda = folder / 'it\'s "all" hére', folder / "cuda"
    stand_ins(wheels)
    stand_ins(cuda, "cu130")
    hashes = write_hashes(folder / "hashes", cuda)
    return Source(build_robir(folder / "robir"), wheels, cuda, hashes)


def command(place, source, *, build="CPU", wheels=None):
    words = ["--root", str(place.root), "--wheel", str(source.robir), "--torch", build]
    network = ["--online", "--hashes", str(source.hashes)]
    origin = network if wheels == "" else ["--wheels", str(wheels or source.wheels)]
    return worker_command(*words, "--constraints", str(CONSTRAINTS), *origin)


def variables(**more):
    """No settings of pip but these."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    return kept | {"PIP_CONFIG_FILE": os.devnull} | more


def run(words, **more):
    """Exit code, the JSON lines, the last line of standard error."""
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, env=variables(**more), timeout=120
    )
    said = done.stderr.strip().splitlines()
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], said[-1:]


@pytest.fixture(scope="module")
def made(source, tmp_path_factory):
    """An engine in a folder with an unusual name, made while Python's variables point elsewhere.

    It was killed before its environment was whole, and went on from there.
    """
    folder = tmp_path_factory.mktemp("made")
    trap = folder / "trap"
    for name in ("robir", "torch", "pip", "engine", "venv"):
        (trap / name).mkdir(parents=True)
        (trap / name / "__init__.py").write_text("raise SystemExit('wrong module')")
    place = Place(folder / UNUSUAL)
    killed = killed_at_once(place, source)
    with serve(source.wheels) as index:
        answer = run(
            command(place, source),
            PYTHONPATH=str(trap),
            PIP_INDEX_URL=index.url,
        )
        return place, answer, index.asked, killed


def killed_at_once(place, source):
    """Whether a killed engine is whole, and what is known of it: it has a Python, and no pip."""
    with subprocess.Popen(
        command(place, source), stdout=subprocess.DEVNULL, start_new_session=True, env=variables()
    ) as process:
        while not place.python.exists():
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGKILL)
    return place.whole.exists(), status(place, source.robir, "CPU")


@pytest.fixture
def copy(made, tmp_path):
    """A copy of the engine to be spoilt; its files are the same until they are replaced."""
    place = Place(tmp_path / "engine")
    shutil.copytree(made[0].root, place.root, symlinks=True, copy_function=os.link)
    return place


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_an_engine_is_made_and_known(made, source):
    place, (code, lines, _), _, (was_whole, before) = made
    assert not was_whole and before.state == "incomplete"
    assert "goes on" in before.cure
    assert code == 0
    assert lines[-1]["installed"]["robir"] == robir.__version__
    found = status(place, source.robir, "CPU")
    assert (found.state, found.python, found.cure) == ("ready", place.python, "")
    assert "torch 2.13.0+cpu" in found.text
    where = "import robir, pycolmap, sys; print(robir.__file__, sys.prefix)"
    said = subprocess.run([place.python, "-I", "-c", where], capture_output=True, text=True)
    assert said.stdout.count(str(place.environment)) == 2
    assert not place.cache.exists()


def test_a_folder_of_wheels_leaves_the_network_alone(made):
    assert made[2] == []


def kill_at(words, message, number, group=True):
    """Send a signal when a message is told; the exit code and what was said."""
    with subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        env=variables(),
    ) as process:
        said = []
        for line in process.stdout:
            said.append(json.loads(line))
            if said[-1].get("message", "").startswith(message):
                (os.killpg if group else os.kill)(process.pid, number)
                break
        said += [json.loads(line) for line in process.stdout]
    return process.returncode, said


def forget(place, *packages):
    """Take packages out of an engine, and its record, as if it had broken off before them."""
    place.record.unlink()
    place.cache.mkdir()
    for name in packages:
        for path in place.site_packages.glob(f"{name}*"):
            shutil.rmtree(path)


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_cancelled_it_says_so_and_takes_pip_along(copy, source):
    forget(copy, "torch")
    code, said = kill_at(command(copy, source), "looking for torch", signal.SIGTERM, group=False)
    assert code == 130
    assert "cancelled" in said[-1]["error"]
    assert "goes on" in said[-1]["cure"]
    assert status(copy, source.robir, "CPU").state == "incomplete"
    with engine_lock(copy.lock):
        listing = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(copy.environment) not in listing


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere torch has an index of its own")
def test_a_download_that_breaks_off_goes_on(copy, source, tmp_path):
    """Whatever pip's settings are for where packages go."""
    forget(copy, "torch", "numpy", "scipy")
    words = command(copy, source, build="CUDA", wheels="")
    with serve(source.cuda_wheels) as index:
        index.break_off = {file.name for file in source.cuda_wheels.glob("scipy-*")}
        online = {"PIP_INDEX_URL": index.url, "PIP_RETRIES": "0", "PIP_TRUSTED_HOST": "127.0.0.1"}
        online |= {"PIP_USER": "1", "PIP_TARGET": str(tmp_path / "elsewhere")}
        settings = tmp_path / "pip/pip.conf"
        settings.parent.mkdir()
        settings.write_text(f"[global]\ntarget = {tmp_path / 'elsewhere'}\n")
        online |= {"PIP_CONFIG_FILE": str(settings), "XDG_CONFIG_HOME": str(tmp_path)}
        code, lines, said = run(words, **online)
        assert code == 4
        assert re.search("broke off|damaged", lines[-1]["error"])
        assert "goes on" in lines[-1]["cure"]
        assert said == [f"{lines[-1]['error']}; {lines[-1]['cure']}"]
        assert status(copy, source.robir, "CUDA").state == "incomplete"
        assert run(words, **online)[0] == 0
    assert status(copy, source.robir, "CUDA").state == "ready"
    fetched = [path.split("/")[2].split("-")[0] for path in index.asked if "/files/" in path]
    assert not (tmp_path / "elsewhere").exists()
    assert sorted(fetched) == ["numpy", "scipy", "scipy", "torch"]
    assert not copy.cache.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere torch has an index of its own")
@pytest.mark.parametrize("name", ["torch", "scipy"])
def test_what_is_not_as_it_was_pinned_is_not_installed(copy, source, tmp_path, name):
    """An index that gives the right version with other contents."""
    forget(copy, "torch", "scipy")
    lists = shutil.copytree(source.hashes, tmp_path / "hashes")
    file = lists / ("hashes-torch.txt" if name == "torch" else "hashes.txt")
    file.write_text(re.sub(rf"({name}==\S+ --hash=sha256:)....", r"\g<1>0000", file.read_text()))
    words = command(copy, replace(source, hashes=lists), build="CUDA", wheels="")
    with serve(source.cuda_wheels) as index:
        code, lines, _ = run(words, PIP_INDEX_URL=index.url, PIP_TRUSTED_HOST="127.0.0.1")
    assert code == 4
    assert "arrived damaged" in lines[-1]["error"]
    assert not list(copy.site_packages.glob(f"{name}-*"))


def test_the_network_may_give_the_pinned_versions_and_nothing_else():
    """The lists hold all that the core needs, in the versions of constraints.txt, with hashes."""
    folder = ROOT / "robir_addon/engine"
    texts = [(folder / f"hashes{name}.txt").read_text() for name in ("", "-torch", "-pip")]
    blocks = re.split(r"\n(?=\S)", "\n".join(text.strip() for text in texts))
    assert all(block.count(" --hash=sha256:") >= 1 for block in blocks)
    found = [re.match(r"([a-z][\w.-]*)==(\S+)", block) for block in blocks]
    listed = {(plain(entry[1]), entry[2]) for entry in found if entry}
    assert len(listed) == len(blocks)
    pins = [Requirement(line) for line in CONSTRAINTS.read_text().splitlines() if line[0] != "#"]
    pinned = {(plain(pin.name), str(pin.specifier).removeprefix("==")) for pin in pins}
    names = {name for name, _ in pinned}
    assert {entry for entry in listed if entry[0] in names} <= pinned
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = project["dependencies"] + project["optional-dependencies"]["photos"]
    needed = {plain(Requirement(line).name) for line in lines}
    assert needed <= {name for name, _ in listed}


def test_another_version_is_outdated_and_updated(copy, source, tmp_path):
    record = read_record(copy)
    write_record(copy, type(record)(**vars(record) | {"robir": "0.0.9"}))
    found = status(copy, source.robir, "CPU")
    assert found.state == "outdated"
    assert "made by RobIR 0.0.9, the add-on is RobIR " + robir.__version__ in found.text
    assert "Update" in found.cure


def test_another_build_of_the_same_version_is_installed_anew(copy, source, tmp_path):
    newer = tmp_path / source.robir.name
    shutil.copyfile(source.robir, newer)
    with newer.open("r+b") as file:  # the archive's comment: other bytes, the same content
        file.seek(-2, os.SEEK_END)
        file.write(b"\x01\x00!")
    found = status(copy, newer, "CPU")
    assert found.state == "outdated"
    assert "another build" in found.text
    file = copy.site_packages / "robir/cli.py"
    file.unlink()
    file.write_text("spoilt")
    assert run(command(copy, replace(source, robir=newer)))[0] == 0
    assert status(copy, newer, "CPU").state == "ready"
    assert "spoilt" not in file.read_text()


def test_the_other_torch_takes_the_place_of_the_first(copy, source):
    found = status(copy, source.robir, "CUDA")
    assert found.state == "outdated"
    assert "computes with CPU, chosen is CUDA" in found.text
    assert run(command(copy, source, build="CUDA", wheels=source.cuda_wheels))[0] == 0
    assert status(copy, source.robir, "CUDA").state == "ready"
    assert read_record(copy).torch.endswith("+cu130")


def test_torch_without_cuda_is_not_taken_for_one_with(copy, source):
    code, lines, _ = run(command(copy, source, build="CUDA"))
    assert code == 4
    assert "knows no CUDA" in lines[-1]["error"]
    assert status(copy, source.robir, "CUDA").state == "incomplete"


def test_a_folder_that_is_not_ours_is_left_alone(source, tmp_path):
    place = Place(tmp_path)
    (tmp_path / "thesis.txt").write_text("mine")
    code, lines, _ = run(command(place, source))
    assert code == 4
    assert "not RobIR's" in lines[-1]["error"]
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(EngineError, match="no mark of RobIR"):
        remove(place)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_removal_takes_what_is_ours_and_leaves_the_rest(copy, tmp_path):
    other = tmp_path / "other"
    (other / "kept").mkdir(parents=True)
    shutil.rmtree(copy.environment)
    copy.environment.symlink_to(other)
    (copy.root / "notes.txt").write_text("mine")
    assert remove(copy) == (copy.root / "notes.txt",)
    assert (other / "kept").is_dir()
    assert [path.name for path in copy.root.iterdir()] == ["notes.txt"]


def test_one_works_on_it_at_a_time(copy, source):
    with engine_lock(copy.lock):
        code, lines, _ = run(command(copy, source))
        assert code == 4
        assert "another process" in lines[-1]["error"]
        with pytest.raises(EngineError, match="another process"):
            remove(copy)
    assert status(copy, source.robir, "CPU").state == "ready"
