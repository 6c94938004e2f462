# SPDX-License-Identifier: Apache-2.0
"""A library in Blender: an asset that is whole, in Preferences, and the list of a batch."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from addon.blenders import MODULE, run

from robir.errors import UsageError
from robir.export.asset import AssetFacts, catalogue_id, is_current, make_asset
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import JobPaths, write_json

pytestmark = pytest.mark.blender

LOOK = """
import bpy

def main(file):
    with bpy.data.libraries.load(file) as (whole, _):
        others = [*whole.cameras, *whole.lights, *whole.worlds, *whole.collections]
    with bpy.data.libraries.load(file, link=True, assets_only=True) as (there, wanted):
        names = list(there.objects)
        wanted.objects = list(names)
    (asset,) = wanted.objects
    data = asset.asset_data
    low, high = asset.bound_box[0], asset.bound_box[6]
    images = [n.image for s in asset.material_slots for n in s.material.node_tree.nodes
              if n.type == "TEX_IMAGE"]
    return {
        "names": names, "author": data.author, "licence": data.license,
        "catalogue": data.catalog_id, "tags": sorted(t.name for t in data.tags),
        "location": list(asset.location), "low": list(low), "high": list(high),
        "preview": list(asset.preview.image_size), "others": others,
        "packed": [bool(i.packed_file) for i in images], "paths": [i.filepath for i in images],
        "sizes": [list(i.size) for i in images], "marks": [k for k in asset.keys()],
    }
"""

PANEL = f"""
import bpy, sys

MODULE = {MODULE!r}

def call(_name, **given):
    try:
        return sorted(getattr(bpy.ops.robir, _name)("EXEC_DEFAULT", **given))
    except RuntimeError as refusal:
        return str(refusal).strip()

def main(archive, folder):
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module=MODULE)
    libraries = bpy.context.preferences.filepaths.asset_libraries
    before = len(libraries)
    answer = {{"unchosen": bpy.ops.robir.add_library.poll()}}
    bpy.context.scene.robir.library = folder
    answer["added"] = [call("add_library"), call("add_library")]
    answer["libraries"] = [[l.name, l.path] for l in libraries][before:]
    batch = sys.modules[MODULE + ".work.batch"]
    known = batch.shown()
    answer["queue"] = [known.is_live, known.text, known.captures]
    answer["dropped"] = [call("drop_from_batch", name="lamp"), call("drop_from_batch", name="../x")]
    answer["preferred"] = [call("prefer_in_batch", name=name) for name in ("vase", "../x")]
    answer["order"] = [row[0] for row in batch.shown().captures]
    bpy.context.scene.robir.library = folder + "/nowhere"
    answer["nowhere"] = [call("add_library"), batch.shown().captures]
    return answer
"""


@pytest.fixture
def facts():
    return AssetFacts(
        author="Ann", licence="CC0-1.0", tags=("truck", "--wood"), catalogue="toys/cars"
    )


def made(result: JobPaths, facts: AssetFacts) -> JobPaths:
    write_json(result.manifest("export"), {"fingerprint": "1"})
    write_json(result.report_json, {"trust": {"is_trusted": False}, "metal_share": 0.2})
    make_asset(result, facts, lambda *_: None)
    return result


def test_an_asset_stands_alone(result, facts, oldest, tmp_path):
    made(result, facts)
    seen = run(oldest, LOOK, str(result.library_asset), user=tmp_path / "user")
    assert seen["names"] == [result.root.name]
    assert (seen["author"], seen["licence"]) == ("Ann", "CC0-1.0")
    assert seen["catalogue"] == catalogue_id("toys/cars")
    assert {"truck", "--wood", "doubtful", "partly metal"} <= set(seen["tags"])
    low, high = seen["low"], seen["high"]
    assert seen["location"] == [0.0, 0.0, 0.0]
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert [a + b for a, b in zip(low[:2], high[:2], strict=True)] == pytest.approx(
        [0, 0], abs=1e-5
    )
    assert 128 < seen["preview"][0] <= 256
    assert seen["others"] == []
    assert all(seen["packed"])
    assert "robir_result" not in seen["marks"]
    content = result.library_asset.read_bytes()
    assert str(result.root).encode() not in decompressed(content)


def decompressed(content: bytes) -> bytes:
    """What a compressed .blend holds."""
    import shutil

    program = shutil.which("zstd")
    if program is None:
        return b""
    return subprocess.run([program, "-dcq"], input=content, capture_output=True, check=True).stdout


def test_an_asset_is_current_until_what_is_known_of_it_changes(result, facts):
    made(result, facts)
    assert is_current(result, facts)
    assert not is_current(result, AssetFacts(author="Ben"))
    write_json(result.manifest("export"), {"fingerprint": "2"})
    assert not is_current(result, facts)
    result.library_asset.unlink()
    assert not is_current(result, facts)


@pytest.mark.parametrize("name", ["a//b", "/a", "a/", "a: b", " a", "a\nb"])
def test_names_that_no_catalogue_may_have_are_refused(name):
    with pytest.raises(UsageError, match="is none"):
        AssetFacts(catalogue=name)


def test_the_panel_registers_the_library_and_lists_its_batch(
    extension_zip: Path, blender, tmp_path
):
    library = LibraryPaths(tmp_path / "my library")
    library.root.mkdir()
    rows = [("chair", "done", ""), ("lamp", "failed", "no photographs"), ("cup", "waiting", "")]
    rows.append(("vase", "waiting", ""))
    captures = [{"name": n, "state": s, "fraction": 0.0, "message": m} for n, s, m in rows]
    write_json(library.state, {"fraction": 0.5, "seconds_left": None, "captures": captures})
    seen = run(blender, PANEL, str(extension_zip), str(library.root), user=tmp_path / "user")
    assert not seen["unchosen"]
    assert seen["added"] == [["FINISHED"], ["FINISHED"]]
    assert seen["libraries"] == [["my library", str(library.root)]]
    assert seen["queue"] == [False, "1 of 4 done", [list(rows[n]) for n in (1, 2, 3, 0)]]
    assert seen["dropped"][0] == ["FINISHED"]
    assert "leads out" in seen["dropped"][1]
    assert [file.name for file in library.dropped.iterdir()] == ["lamp"]
    assert seen["preferred"][0] == ["FINISHED"] and "leads out" in seen["preferred"][1]
    assert seen["order"] == ["lamp", "vase", "cup", "chair"]
    assert "is no folder" in seen["nowhere"][0]
    assert seen["nowhere"][1] == []
