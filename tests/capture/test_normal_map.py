# SPDX-License-Identifier: Apache-2.0
"""Normal maps of glTF files: read as they are, or a sentence that says why not."""

from __future__ import annotations

import base64
import io
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from evaluation import sphere_run
from PIL import Image

from robir.capture.mesh_file import mesh_parts, read_mesh
from robir.export.gltf import write_glb
from robir.export.textures import finished_textures

RNG = np.random.default_rng(0)
BUMPS = np.concatenate(
    [RNG.integers(90, 166, (24, 32, 2)), RNG.integers(230, 256, (24, 32, 1))], axis=-1
).astype(np.uint8)


@pytest.fixture
def glb(tmp_path) -> Path:
    """As our own export writes it."""
    textures = finished_textures(sphere_run.sphere_textures(), 12)
    path = tmp_path / "asset.glb"
    write_glb(path, sphere_run.parts(replace(textures, normal_map=BUMPS)), "sphere")
    return path


def rewrite(path: Path, change) -> Path:
    """The file with another JSON."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    return path


def test_a_map_comes_back_with_the_normals_it_is_made_for(glb):
    given, mesh = read_mesh(glb), sphere_run.world_mesh()
    assert given.notes == ()
    (bumps,) = given.detail.maps
    assert (bumps == BUMPS).all()
    assert not given.detail.of_face.any()
    expected = mesh.normals[mesh.faces]
    assert given.normals[given.faces] == pytest.approx(expected, abs=1e-5)


def test_normals_turn_with_the_object_and_keep_to_squeezed_surfaces(glb):
    """Of a sphere squeezed to a tenth, normals are the gradient of its equation."""

    def squeeze(document):
        document["nodes"][0]["scale"] = [1.0, 0.1, 1.0]
        document["nodes"][0]["translation"] = [5.0, 0.0, 0.0]

    given = read_mesh(rewrite(glb, squeeze))
    stretched = given.vertices - [5 + sphere_run.CENTRE[0], *sphere_run.CENTRE[1:]] * np.array(
        [1, 1, 0.1]
    )
    gradient = stretched / np.array([1, 1, 0.01])
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    used = np.unique(given.faces)
    assert given.normals[used] == pytest.approx(gradient[used], abs=2e-3)


def test_its_strength_is_applied(glb):
    given = read_mesh(rewrite(glb, lambda d: d["materials"][0]["normalTexture"].update(scale=0.5)))
    normal = BUMPS / 127.5 - 1
    normal[..., :2] /= 2
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert given.detail.maps[0] / 127.5 - 1 == pytest.approx(normal, abs=0.005)


def test_a_mesh_without_a_map_has_none(glb):
    given = read_mesh(rewrite(glb, lambda d: d["materials"][0].pop("normalTexture")))
    assert given.detail is None
    assert given.normals is None
    assert given.notes == ()


def more_materials(document):
    """One more with the same map, one with another strength of it, one without, and none at all."""
    first = document["materials"][0]
    steep = first["normalTexture"] | {"scale": 2.0}
    others = [first | {"name": "same"}, first | {"normalTexture": steep}, {"name": "plain"}]
    document["materials"] += others
    (primitive,) = document["meshes"][0]["primitives"]
    bare = {key: value for key, value in primitive.items() if key != "material"}
    named = [primitive | {"material": index} for index in (3, 2, 1)]
    document["meshes"][0]["primitives"] += [*named, bare]


def test_every_face_has_the_map_of_its_material(glb):
    given = read_mesh(rewrite(glb, more_materials))
    faces = len(sphere_run.world_mesh().faces)
    first, second = given.detail.maps
    assert (first == BUMPS).all()
    assert not (second == BUMPS).all()
    of_part = given.detail.of_face.reshape(5, faces)
    assert (of_part == of_part[:, :1]).all()
    assert of_part[:, 0].tolist() == [0, -1, 1, 0, -1]
    assert given.notes == ()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d["materials"][0]["normalTexture"].update(texCoord=1), "coordinates of its own"),
        (lambda d: d["images"][2].update(bufferView=0), "no picture that can be read"),
        (lambda d: d["materials"][0]["normalTexture"].update(index=99), "texture 99, which is not"),
        (lambda d: d["images"].__setitem__(2, {"uri": "gone.png"}), "gone.png is not there"),
    ],
)
def test_what_cannot_be_passed_on_is_told_and_the_mesh_taken(glb, change, reason):
    given = read_mesh(rewrite(glb, change))
    assert given.detail is None
    (note,) = given.notes
    assert "normal map is not passed on" in note
    assert reason in note
    assert len(given.faces) >= len(sphere_run.world_mesh().faces)


@pytest.mark.parametrize("kind", ["file", "data"])
def test_gltf_brings_it_beside_itself_or_within(tmp_path, kind):
    solid = trimesh.creation.box()
    parts = trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(file_type="gltf")
    for name, content in parts.items():
        (tmp_path / name).write_bytes(content)
    stream = io.BytesIO()
    Image.fromarray(BUMPS).save(stream, format="PNG")
    (tmp_path / "bumps.png").write_bytes(stream.getvalue())
    (tmp_path / "paint.png").write_bytes(b"another picture, which nobody asks for")
    within = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
    path = tmp_path / "model.gltf"
    document = json.loads(path.read_text())
    document |= {
        "images": [{"uri": "paint.png"}, {"uri": "bumps.png" if kind == "file" else within}],
        "textures": [{"source": 0}, {"source": 1}],
        "materials": [{"normalTexture": {"index": 1}}],
    }
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    path.write_text(json.dumps(document))
    assert (read_mesh(path).detail.maps[0] == BUMPS).all()
    assert ("bumps.png" in mesh_parts(path)) == (kind == "file")
    assert "paint.png" not in mesh_parts(path)
