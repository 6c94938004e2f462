# SPDX-License-Identifier: Apache-2.0
"""The stage writes the whole contract, with and without Blender."""

import importlib.util
import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import PyOpenColorIO as OCIO
import pytest
from evaluation import sphere_run

from robir.errors import CancelledError, DeviceError, RobirError, UsageError
from robir.export import blender, stage
from robir.export.config import ExportConfig
from robir.jobs.context import StageContext
from robir.jobs.paths import read_json


@dataclass
class Recorder:
    fractions: list = field(default_factory=list)
    warnings: list = field(default_factory=list)
    stop_at: float = 2.0

    def progress(self, fraction, message):
        self.fractions.append(fraction)
        if fraction >= self.stop_at:
            raise CancelledError("stopped")

    def warn(self, message):
        self.warnings.append(message)

    def metric(self, name, value):
        pass


def context(paths, reporter, **settings):
    return StageContext(
        paths=paths,
        config=ExportConfig(**settings),
        source=Path("capture"),
        masks=None,
        seed=0,
        device="cpu",
        reporter=reporter,
    )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    paths = sphere_run.make_run(tmp_path_factory.mktemp("run") / "out")
    recorder = Recorder()
    metrics = stage.run(context(paths, recorder, renders=False))
    return paths, recorder, metrics


def test_the_result_folder_is_complete(exported):
    paths, recorder, metrics = exported
    present = {p.relative_to(paths.root).as_posix() for p in paths.export.rglob("*") if p.is_file()}
    assert present == {
        *(f"export/{name}" for name in ("asset.glb", "cameras.json", "transforms.json")),
        *(f"export/colmap/sparse/0/{name}.txt" for name in ("cameras", "images", "points3D")),
        "export/environment.exr",
        "export/environment_without_sun.exr",
        "export/light.json",
        *(f"export/tone_curve.{kind}" for kind in ("cube", "json", "png")),
        "export/textures/albedo.exr",
        "export/textures/albedo.png",
        "export/textures/coverage.png",
        "export/textures/roughness.png",
        "export/textures/uncertainty.png",
    }
    assert paths.report.is_file()
    assert recorder.fractions == sorted(recorder.fractions)
    assert recorder.fractions[-1] == 1.0
    assert metrics["faces"] == len(sphere_run.sphere_mesh().faces)
    json.dumps(metrics, allow_nan=False)


def test_look_up_table_is_read_by_opencolorio(exported):
    transform = OCIO.FileTransform(str(exported[0].tone_lut), interpolation=OCIO.INTERP_LINEAR)
    processor = OCIO.Config.CreateRaw().getProcessor(transform).getDefaultCPUProcessor()
    table = read_json(exported[0].tone_curve)
    assert len(table["samples"]["linear"]) == len(table["samples"]["display"])
    for linear, display in zip(*table["samples"].values(), strict=True):
        if linear > 2e-2:
            assert processor.applyRGB([linear] * 3)[0] == pytest.approx(display, abs=4e-3)


def test_without_blender_the_rest_is_there_and_the_report_says_how(tmp_path, monkeypatch):
    paths = sphere_run.make_run(tmp_path / "out")
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "bpy" else find(name, *a)
    )
    recorder = Recorder()
    paths.renders.mkdir()
    paths.export.mkdir()
    # of an earlier asset, but for the one that the user asked for
    for name in ("rerender_a.png", "relit_city_a.png", "relit_mine_a.png"):
        (paths.renders / name).touch()
    paths.scene.touch()
    stage.run(context(paths, recorder))
    assert "pip install" in recorder.warnings[0]
    assert paths.asset.is_file()
    assert not paths.scene.exists()
    left = [file.name for file in paths.renders.iterdir() if not file.name.startswith("compare_")]
    assert left == ["relit_mine_a.png"]
    assert "pip install" in read_json(paths.report_json)["missing"][0]
    assert "pip install" in paths.report.read_text(encoding="utf-8")


FAKE = """
import json, sys, time
print(json.dumps({"progress": 0.5, "message": "half"}), flush=True)
if sys.argv[1] == "fail":
    sys.stderr.write("noise\\nerror: no such view\\n"); sys.exit(2)
if sys.argv[1] == "die":
    import os, signal; os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[1] == "hang":
    time.sleep(600)
sum(i * i for i in range(2_000_000))
print(json.dumps({"files": ["a.png"], "notes": ["n"]}))
"""


@pytest.fixture
def fake_addon(tmp_path, monkeypatch):
    package = tmp_path / "robir_addon"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "headless.py").write_text(FAKE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(blender, "missing_blender", lambda: None)


def test_a_request_to_stop_ends_blender(fake_addon):
    def stop(fraction, message):
        raise CancelledError("stop")

    start = time.monotonic()
    with pytest.raises(CancelledError):
        blender.run_headless(["hang"], stop)
    assert time.monotonic() - start < 300


FAKE_BLENDER = """
import json, sys
print("Blender 9.9.9 LTS", flush=True)
print("{not json}")
if sys.argv[7:] == ["unknown"]:
    sys.stderr.write('Unrecognized command: "robir_scene"\\n'); sys.exit(1)
if sys.argv[7:] == ["fail"]:
    sys.stderr.write("error: no such view\\nBlender is sorry\\n"); sys.exit(2)
if sys.argv[7:] != ["silent"]:
    print(json.dumps({"progress": 0.5, "message": "half"}))
    print(json.dumps({"files": sys.argv[1:], "notes": []}))
print("Blender quit")
"""


@pytest.fixture
def fake_blender(tmp_path, monkeypatch):
    """An executable that stands for a whole Blender, which says more than it is asked."""
    executable = tmp_path / "a blender"
    executable.write_text(f"#!{sys.executable}\n{FAKE_BLENDER}")
    executable.chmod(0o755)
    monkeypatch.setenv("ROBIR_BLENDER", str(executable))
    return executable


def test_a_whole_blender_takes_the_place_of_the_wheel(fake_blender, monkeypatch):
    seen = []
    outcome = blender.run_headless(["go", "a b"], lambda f, m: seen.append((f, m)))
    assert seen == [(0.5, "half")]
    start = ["--background", "--disable-autoexec", "--addons", "bl_ext.user_default.robir"]
    assert [str(file) for file in outcome.files] == [
        *start,
        "--command",
        "robir_scene",
        "go",
        "a b",
    ]
    monkeypatch.setenv("ROBIR_ADDON", "bl_ext.studio.robir")
    assert "bl_ext.studio.robir" in map(str, blender.run_headless(["go"], lambda f, m: None).files)


def test_faults_of_a_whole_blender_are_said_in_words(fake_blender):
    with pytest.raises(UsageError, match=r"^no such view$"):
        blender.run_headless(["fail"], lambda f, m: None)
    with pytest.raises(RobirError, match="no RobIR extension"):
        blender.run_headless(["unknown"], lambda f, m: None)
    with pytest.raises(RobirError, match="without a word"):
        blender.run_headless(["silent"], lambda f, m: None)
    fake_blender.unlink()
    with pytest.raises(DeviceError, match="a blender, which is no program"):
        blender.run_headless(["go"], lambda f, m: None)
