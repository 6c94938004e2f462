# SPDX-License-Identifier: Apache-2.0
"""Results that somebody tampered with: no script runs, nothing is written outside, one sentence."""

from __future__ import annotations

import getpass
import json
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from robir.jobs.paths import JobPaths

pytestmark = pytest.mark.blender

TAMPER = """
import os
import sys
import bpy

scene, folder = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=scene, use_scripts=False)
text = bpy.data.texts.new("run.py")
text.from_string(f"open({folder + '/mark'!r}, 'w').close()")
text.use_module = True
scene = bpy.context.scene
scene.render.engine = "BLENDER_WORKBENCH"
scene.use_nodes = True
nodes, links = scene.node_tree.nodes, scene.node_tree.links
written = nodes.new("CompositorNodeOutputFile")
written.base_path = folder
links.new(nodes.new("CompositorNodeRLayers").outputs[0], written.inputs[0])
for item in bpy.data.objects:
    item.driver_add("location", 0).driver.expression = "__import__('os').getpid()"
    if "robir_view" in item:
        item["robir_view"] = "x/../../../" + item["robir_view"]
bpy.ops.wm.save_mainfile()
os._exit(0)  # with such drivers Blender's own end waits for ever
"""

# the commands in a Blender whose user lets every file run its scripts
RUNS_SCRIPTS = """
import sys
import time
import bpy
from robir_addon.headless import main

bpy.context.preferences.filepaths.use_scripts_auto_execute = True
sys.exit(main(sys.argv[1:]))
"""


def headless(*arguments):
    command = [sys.executable, "-c", RUNS_SCRIPTS, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def copy(result, tmp_path):
    return JobPaths(shutil.copytree(result.root, tmp_path / "in" / "copy"))


@pytest.mark.slow
def test_nothing_of_a_strangers_scene_is_run_or_rendered(copy, tmp_path):
    """Its scripts, drivers, compositor and names: the scene is made of the exported files."""
    assert headless("scene", copy.root).returncode == 0
    words = ["relight", copy.root, "--views", "held_out_000", "--samples", 1]
    words += ["--environment", "city", "--max-side", 16]
    whole = headless(*words)
    picture = copy.renders / "relit_city_held_out_000.png"
    before = picture.read_bytes()
    picture.unlink()
    tamper = [sys.executable, "-c", TAMPER, copy.scene, tmp_path / "elsewhere"]
    subprocess.run(tamper, capture_output=True, check=True)
    again = headless(*words)
    assert (again.returncode, again.stdout) == (0, whole.stdout), again.stderr
    assert picture.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


@pytest.mark.slow
def test_exported_files_name_nothing_of_the_machine(copy):
    """Neither folder nor host, nor what lay in the process's memory."""
    import zstandard

    assert headless("scene", copy.root).returncode == 0
    assert headless("asset", copy.root, "--pack").returncode == 0
    private = [str(copy.root.parent), str(copy.root.parents[1])]
    private += [name for name in (socket.gethostname(), getpass.getuser()) if len(name) > 5]
    files = [path for path in copy.export.rglob("*") if path.is_file()]
    assert {copy.scene, copy.library_asset} <= set(files)
    for file in [*files, copy.run, copy.report]:
        content = file.read_bytes()
        if file.suffix == ".blend":
            stream = zstandard.ZstdDecompressor().stream_reader(content, read_across_frames=True)
            content = stream.read()
            assert content.startswith(b"BLENDER")
        assert [word for word in private if word.encode() in content] == [], file.name
        if file == copy.library_asset:
            assert b"Reconstructed by RobIR".ljust(63) + b"\0" in content


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table["views"][0].update(name="x/../../../pwn"),
        lambda table: table["views"][0].update(image="../../../elsewhere.png"),
        lambda table: table["views"][0].update(image="/etc/passwd"),
        lambda table: table["views"][0].pop("width"),
        lambda table: table["views"][0].update(width=None),
        lambda table: table["views"][0].update(fx=0),
        lambda table: table.update(views=[]),
        lambda table: table.update(bounds=[]),
    ],
)
def test_cameras_that_cannot_be(copy, change):
    from robir_addon.engine.errors import ResultError
    from robir_addon.result.importer import read_cameras

    read_cameras(copy)
    table = json.loads(copy.cameras.read_text())
    change(table)
    copy.cameras.write_text(json.dumps(table))
    with pytest.raises(ResultError, match=r"cameras\.json"):
        read_cameras(copy)


@pytest.mark.parametrize("name", ["export/asset.glb", "export/textures/albedo.png", "log.txt"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_pipes_and_links_stop_no_import(copy, name, make):
    import bpy

    from robir_addon.engine.errors import ResultError
    from robir_addon.result.importer import import_result

    (copy.root / name).unlink(missing_ok=True)
    make(copy.root / name)
    with pytest.raises(ResultError, match="remove it"):
        import_result(copy.root, bpy.context.scene)


@pytest.mark.parametrize(
    "text", [b"[" * 100_000, b'{"meshes": [{"primitives": [{"indices": 0}]}]}']
)
def test_assets_that_are_none(copy, text):
    from robir_addon.engine.errors import ResultError
    from robir_addon.result.glb import read_glb

    chunk = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0) + text
    copy.asset.write_bytes(chunk)
    with pytest.raises(ResultError, match="cannot be read as RobIR's asset"):
        read_glb(copy.asset)


def test_a_report_for_help_tells_nothing_of_other_files(copy, tmp_path):
    """It is pasted in public."""
    from robir_addon.work.support import _from_folder

    (tmp_path / "key").write_text("private")
    copy.log.unlink(missing_ok=True)
    copy.log.symlink_to(tmp_path / "key")
    copy.status.unlink(missing_ok=True)
    os.mkfifo(copy.status)
    told = "\n".join(_from_folder(copy))
    assert "run.json" in told
    assert "private" not in told


@pytest.mark.skipif(sys.platform == "win32", reason="takes POSIX limits")
def test_a_disk_that_takes_no_more_is_told_as_such(copy):
    import resource

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    run = subprocess.run(
        [sys.executable, "-m", "robir_addon.headless", "scene", str(copy.root)],
        capture_output=True, text=True, check=False, preexec_fn=limited,
    )  # fmt: skip
    assert run.returncode == 6, run.stderr
    assert run.stderr.startswith("error: ")
    # Blender notices it only where its last block is not the one that is cut
    assert re.search("only a part of it could be written|File too large", run.stderr)
    assert "; make room" in run.stderr
    assert run.stderr.count("\n") == 1
    assert not list(copy.export.glob(".scene*"))


@pytest.mark.slow
def test_a_command_ends_with_the_process_that_waits_for_it(copy):
    """What a killed run leaves behind would write into the folder that goes on without it."""
    words = ["render", str(copy.root), "--views", "all", "--samples", "100000"]
    with subprocess.Popen(
        [sys.executable, "-m", "robir_addon.headless", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "ROBIR_FOLLOWED": "1"},
    ) as process:
        assert b"progress" in process.stdout.readline()
        time.sleep(0.5)
        assert process.poll() is None
        process.stdin.close()
        try:
            assert process.wait(120) == 130
        finally:
            process.kill()
    assert not list(copy.renders.glob("rerender_*"))


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
def test_who_reads_ends_with_its_parent(tmp_path):
    body = "point3f[] points = [(1, 0, 0), (0, 2, 0), (0, 0, 3)]\nint[] faceVertexCounts = [3]\n"
    body += "int[] faceVertexIndices = [0, 1, 2]\n"
    meshes = "".join(f'def Mesh "Post{number}"\n{{\n{body}}}\n' for number in range(20_000))
    (tmp_path / "many.usda").write_text(f"#usda 1.0\n{meshes}")  # minutes of reading
    words = ["mesh", str(tmp_path / "many.usda"), str(tmp_path / "many.glb")]
    parent = subprocess.Popen([sys.executable, "-m", "robir_addon.headless", *words])
    while (child := reader_of(parent.pid)) is None:
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    patience = time.monotonic() + 90.0
    while is_running(child) and time.monotonic() < patience:
        time.sleep(0.02)
    assert not is_running(child)


def reader_of(parent: int) -> Path | None:
    """Folder of /proc of the process that a command started to read a mesh, once it reads."""
    for number in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with suppress(FileNotFoundError, ProcessLookupError):
            child = Path("/proc", number)
            spent = int((child / "stat").read_text().rpartition(")")[2].split()[11])  # hundredths
            if b"--within" in (child / "cmdline").read_bytes() and spent > 150:
                return child
    return None


def is_running(process: Path) -> bool:
    """Whether a process, by its folder of /proc, is neither gone nor only to be waited for."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
