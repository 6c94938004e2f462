# SPDX-License-Identifier: Apache-2.0
"""The USD file against another reader: Blender's importer, which is Pixar's library."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from evaluation import sphere_run
from export.test_stage import Recorder, context

from robir.errors import ConfigError
from robir.export import stage
from robir.export.asset import AssetFacts, make_asset, read_facts
from robir.jobs.paths import write_json

LOOK = """
import bpy, json, sys

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1])
(item,) = [item for item in bpy.data.objects if item.type == "MESH"]
mesh = item.data
material = item.material_slots[0].material.node_tree
shader = next(node for node in material.nodes if node.type == "BSDF_PRINCIPLED")
images = {}
for name in ("Base Color", "Roughness", "Metallic"):
    node = shader.inputs[name].links[0].from_node if shader.inputs[name].links else None
    while node and node.type != "TEX_IMAGE":
        node = next(link.from_node for entry in node.inputs for link in entry.links)
    if node:
        image = node.image
        images[name] = [bpy.path.abspath(image.filepath), image.colorspace_settings.name,
                        list(image.size)]
    else:
        images[name] = shader.inputs[name].default_value
print("SEEN", json.dumps({
    "points": [list(item.matrix_world @ v.co) for v in mesh.vertices],
    "faces": [list(f.vertices) for f in mesh.polygons],
    "uvs": [list(one.uv) for one in mesh.uv_layers.active.data],
    "normals": [list(one.vector) for one in mesh.corner_normals],
    "images": images, "ior": shader.inputs["IOR"].default_value,
}))
"""


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    paths = sphere_run.make_run(tmp_path_factory.mktemp("usd") / "2 balls")
    stage.run(context(paths, Recorder(), renders=False))
    write_json(paths.manifest("export"), {"fingerprint": "1"})
    return paths


def made(result, **known) -> AssetFacts:
    facts = AssetFacts(formats=("usd",), **known)
    make_asset(result, facts, lambda *_: None)
    return facts


@pytest.mark.blender
def test_blender_reads_what_is_in_the_result(result):
    made(result)
    done = subprocess.run(
        [sys.executable, "-c", LOOK, str(result.usd)], capture_output=True, text=True, check=True
    )
    line = next(line for line in done.stdout.splitlines() if line.startswith("SEEN"))
    seen, mesh = json.loads(line.partition(" ")[2]), sphere_run.world_mesh()
    points, middle = np.array(seen["points"]), mesh.vertices.mean(axis=0)
    assert seen["faces"] == mesh.faces.tolist()
    # a sphere on the origin: moved as a whole, with its lowest point at 0
    assert points - points.mean(axis=0) == pytest.approx(mesh.vertices - middle, abs=1e-5)
    low, high = points.min(axis=0), points.max(axis=0)
    assert [*(low + high)[:2], low[2]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)
    corners = mesh.uvs[mesh.uv_faces].reshape(-1, 2)
    assert np.array(seen["uvs"]) == pytest.approx(corners, abs=1e-6)
    normals = mesh.normals[mesh.faces].reshape(-1, 3)
    assert np.array(seen["normals"]) == pytest.approx(normals, abs=2e-2)
    for name, file, space in (
        ("Base Color", "albedo", "sRGB"), ("Roughness", "roughness", "Non-Color"),
    ):  # fmt: skip
        path, found, size = seen["images"][name]
        assert Path(path).samefile(result.textures / f"{file}.png")
        assert (found, min(size) > 0) == (space, True)
    assert seen["images"]["Metallic"] == 0.0  # nothing is metal
    assert seen["ior"] == pytest.approx(1.5)


def test_no_path_of_this_machine_is_in_the_file_but_its_author_is(result):
    made(result, author='Ann "A" Smith', licence="CC0-1.0")
    text = result.usd.read_text(encoding="utf-8")
    assert str(result.root.parent) not in text
    assert 'string author = "Ann \\"A\\" Smith"; string licence = "CC0-1.0"' in text
    assert 'def Xform "_2_balls"' in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('formats = ["fbx"]', "choose one of 'blend', 'usd'"),
        (f"author = '{'x' * 200_000}'", "no line of up to 1000 letters"),
        ('licence = "a\\u0000b"', "no line of up to 1000 letters"),
        (f"tags = {['a'] * 101}", "101 tags are more than 100"),
    ],
    ids=("format", "long", "zero", "tags"),
)
def test_facts_that_cannot_be_are_named(tmp_path, text, words):
    (tmp_path / "about.toml").write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_facts(tmp_path / "about.toml")
