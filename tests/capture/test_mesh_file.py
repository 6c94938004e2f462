# SPDX-License-Identifier: Apache-2.0
"""Meshes of every kind of file, read to the same triangles; and files that hold none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from evaluation import sphere_run

from robir.capture.mesh_file import read_mesh
from robir.errors import CaptureError
from robir.export.gltf import write_glb
from robir.export.textures import finished_textures

CORNERS = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


NO_FACES = (
    b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"
)


def triangles(given) -> np.ndarray:
    """Corner positions (F, 3, 3) in an order of their own."""
    corners = given.vertices[given.faces].reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


def write(path: Path, vertices=CORNERS, faces=FACES) -> Path:
    suffix = path.suffix[1:]
    solid = trimesh.Trimesh(vertices, faces, process=False)
    content = solid.export(file_type=suffix)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off"])
def test_formats_without_axes_stand_as_they_are(tmp_path, suffix):
    given = read_mesh(write(tmp_path / f"scan{suffix}"))
    expected = CORNERS[FACES].reshape(-1, 9)
    assert triangles(given) == pytest.approx(expected[np.lexsort(expected.T)], abs=1e-6)


def test_our_own_asset_comes_back_with_its_layout(tmp_path):
    """glTF is y-up and counts v from the top: both are undone."""
    mesh = sphere_run.world_mesh()
    textures = finished_textures(sphere_run.sphere_textures(), 12)
    write_glb(tmp_path / "asset.glb", sphere_run.parts(textures), "sphere")
    given = read_mesh(tmp_path / "asset.glb")
    assert given.vertices[given.faces] == pytest.approx(mesh.vertices[mesh.faces], abs=1e-6)
    assert given.uvs[given.faces] == pytest.approx(mesh.uvs[mesh.uv_faces], abs=1e-6)


def test_objects_are_taken_together_at_their_places(tmp_path):
    scene = trimesh.Scene()
    box = trimesh.creation.box()
    scene.add_geometry(box)
    mirror = np.diag([-2.0, 1, 1, 1])
    mirror[0, 3] = 5.0
    scene.add_geometry(box, transform=mirror)
    (tmp_path / "two.glb").write_bytes(scene.export(file_type="glb"))
    given = read_mesh(tmp_path / "two.glb")
    assert len(given.faces) == 24
    solid = trimesh.Trimesh(given.vertices, given.faces)
    assert solid.volume == pytest.approx(1.0 + 2.0)  # a mirrored part is not inside out


def test_gltf_reads_its_buffers_and_no_picture(tmp_path):
    parts = trimesh.Trimesh(CORNERS, FACES, process=False).export(file_type="gltf")
    for name, content in parts.items():
        (tmp_path / name).write_bytes(content)
    document = json.loads((tmp_path / "model.gltf").read_text())
    document |= {"images": [{"uri": "missing.eps"}], "textures": [{"source": 0}]}
    (tmp_path / "model.gltf").write_text(json.dumps(document))
    assert len(read_mesh(tmp_path / "model.gltf").faces) == 4
    document["buffers"][0]["uri"] = "../../secret.bin"
    (tmp_path / "model.gltf").write_text(json.dumps(document))
    with pytest.raises(CaptureError, match="outside its folder"):
        read_mesh(tmp_path / "model.gltf")


def test_faces_without_numbers_are_left_out_and_told(tmp_path):
    given = read_mesh(write(tmp_path / "scan.ply", np.where(CORNERS == 5, np.nan, CORNERS)))
    assert len(given.faces) == 1
    assert given.notes == (
        "3 of 4 faces of the mesh have corners that are no numbers; they were left out.",
    )


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("scan.ply", b"", "cannot be read"),
        ("scan.ply", b"no mesh at all", "cannot be read"),
        ("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("scan.obj", b"# nothing\n", "no faces"),
        ("scan.ply", NO_FACES, "no faces"),
        ("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read"),
        ("scan.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face .* has an area"),
        ("scan.obj", b"v nan 0 0\nv 1 0 0\nv 2 0 1\nf 1 2 3\n", "no corner that is a number"),
        ("scan.glb", b"glTF\2\0\0\0", "cannot be read"),
        ("scan.gltf", b"[1]", "cannot be read"),
        ("scan.3mf", b"PK", "no mesh that can be read"),
        ("scan.fbx", b"Kaydara FBX Binary", "robir_addon.headless mesh .* scan.glb`"),
        ("scan.USDZ", b"PK", "can be read by Blender only; .* --mesh scan.glb"),
    ],
)
def test_what_holds_no_surface_is_refused_in_a_sentence(tmp_path, name, content, sentence):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CaptureError, match=sentence) as refused:
        read_mesh(tmp_path / name)
    assert name in str(refused.value)


def test_a_missing_layout_is_no_number(tmp_path):
    given = read_mesh(write(tmp_path / "scan.ply"))
    assert np.isnan(given.uvs).all()


def test_layouts_are_read_without_the_pictures_they_name(tmp_path):
    """As scanning programs write them; materials may be missing and corners differ at seams."""
    (tmp_path / "scan.obj").write_text(
        "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n"
        "vt .1 .1\nvt .9 .1\nvt .1 .9\nvt .9 .9\nvt .1 .8\n"
        "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 2/2 4/4 3/5\n"
    )
    corners = ["0 1 2 6 .1 .1 .9 .1 .1 .9", "1 3 2 6 .9 .1 .9 .9 .1 .8"]
    lines = [
        "ply", "format ascii 1.0", "comment TextureFile gone.png", "element vertex 4",
        "property float x", "property float y", "property float z", "element face 2",
        "property list uchar int vertex_indices", "property list uchar float texcoord",
        "end_header", "0 0 0", "1 0 0", "0 1 0", "1 1 0", *(f"3 {line}" for line in corners), "",
    ]  # fmt: skip
    (tmp_path / "scan.ply").write_text("\n".join(lines))
    places = {(0, 0): [0.1, 0.1], (1, 0): [0.9, 0.1], (1, 1): [0.9, 0.9]}
    for name in ("scan.obj", "scan.ply"):
        given = read_mesh(tmp_path / name)
        assert len(given.faces) == 2
        seam = []
        for corner in given.faces.ravel():
            x, y, _ = given.vertices[corner]
            if (x, y) == (0, 1):
                seam.append(round(float(given.uvs[corner][1]), 3))
            else:
                assert given.uvs[corner] == pytest.approx(places[x, y])
        assert sorted(seam) == [0.8, 0.9]
