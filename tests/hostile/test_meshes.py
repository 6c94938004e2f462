# SPDX-License-Identifier: Apache-2.0
"""Meshes from anybody: what glTF allows is read right, the rest is refused in words of ours."""

from __future__ import annotations

import io
import json
import re
import resource
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robir.capture.mesh_file import read_mesh
from robir.errors import CaptureError

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]], "<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u2")
UVS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], "<f4")

# what a sentence of ours never holds
PYTHON = re.compile(r"Error\b|index out of range|unsupported operand|gufunc|NoneType|KeyError|\(\)")


def packed(document: dict, binary: bytes = b"") -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def tetrahedron(positions=CORNERS, uvs=UVS, **more) -> tuple[dict, bytes]:
    """A document with its binary chunk: accessors 0 places, 1 faces, 2 texture coordinates."""
    arrays = (positions, FACES, uvs)
    kinds = {"f4": 5126, "u2": 5123, "i2": 5122, "u1": 5121, "i1": 5120}
    views, accessors, binary = [], [], b""
    for array, kind in zip(arrays, ("VEC3", "SCALAR", "VEC2"), strict=True):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessor = {
            "bufferView": len(views) - 1,
            "type": kind,
            "count": array.size if kind == "SCALAR" else len(array),
        }
        accessor["componentType"] = kinds[array.dtype.str[1:]]
        if kind != "SCALAR" and array.dtype.kind != "f":
            accessor["normalized"] = True
        accessors.append(accessor)
        binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
    document = {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views, "accessors": accessors, "materials": [{}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1, "material": 0}
        ]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}],
    }  # fmt: skip
    return document | more, binary


def read(tmp_path: Path, document: dict, binary: bytes = b""):
    (tmp_path / "scan.glb").write_bytes(packed(document, binary))
    return read_mesh(tmp_path / "scan.glb")


def y_up(vertices: np.ndarray) -> np.ndarray:
    return np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)


def test_quantised_places_and_coordinates(tmp_path):
    """KHR_mesh_quantization, as gltfpack writes it: a node's scale gives the size back."""
    places = np.round(CORNERS / 5 * 32767).astype("<i2")
    uvs = (UVS * 65535).astype("<u2")
    document, binary = tetrahedron(places, uvs, extensionsRequired=["KHR_mesh_quantization"])
    document["nodes"][0]["scale"] = [5, 5, 5]
    given = read(tmp_path, document, binary)
    assert y_up(given.vertices) == pytest.approx(CORNERS, abs=1e-3)
    assert given.uvs == pytest.approx(np.stack([UVS[:, 0], 1 - UVS[:, 1]], 1), abs=1e-9)


def test_sparse_places(tmp_path):
    document, binary = tetrahedron(np.zeros_like(CORNERS))
    start = len(binary)
    binary += np.array([1, 2, 3], "<u2").tobytes() + b"\0\0" + CORNERS[1:].tobytes()
    document["buffers"][0]["byteLength"] = len(binary)
    document["bufferViews"] += [
        {"buffer": 0, "byteOffset": start, "byteLength": 8},
        {"buffer": 0, "byteOffset": start + 8, "byteLength": 36},
    ]
    sparse = {
        "count": 3,
        "indices": {"bufferView": 3, "componentType": 5123},
        "values": {"bufferView": 4},
    }
    for base in ({"bufferView": 0}, {}):
        document["accessors"][0] = {
            "type": "VEC3",
            "componentType": 5126,
            "count": 4,
            "sparse": sparse,
        } | base
        assert np.array_equal(y_up(read(tmp_path, document, binary).vertices), CORNERS)


def test_a_texture_that_is_laid_on_by_a_transform(tmp_path):
    moved = {"offset": [0.25, 0.5], "scale": [0.5, 0.25], "rotation": np.pi / 2}
    document, binary = tetrahedron()
    texture = {"index": 0, "extensions": {"KHR_texture_transform": moved}}
    document |= {
        "textures": [{}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": texture}}],
    }
    u, v = UVS[:, 0] * 0.5, UVS[:, 1] * 0.25  # the standard's matrices, written out
    expected = np.stack([v + 0.25, -u + 0.5], axis=1)
    found = read(tmp_path, document, binary).uvs
    assert np.stack([found[:, 0], 1 - found[:, 1]], 1) == pytest.approx(expected, abs=1e-7)


def test_strips_and_fans(tmp_path):
    document, binary = tetrahedron()
    primitive = document["meshes"][0]["primitives"][0]
    del primitive["indices"]
    for mode, faces in ((5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])):
        primitive["mode"] = mode
        assert sorted(map(sorted, read(tmp_path, document, binary).faces)) == sorted(
            map(sorted, faces)
        )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("KHR_draco_mesh_compression", "compressed with Draco"),
        ("EXT_meshopt_compression", "compressed with meshopt"),
        ("EXT_mesh_gpu_instancing", "EXT_mesh_gpu_instancing, which is not read"),
    ],
)
def test_extensions_that_are_required_are_heeded(tmp_path, name, words):
    document, binary = tetrahedron(extensionsRequired=[name])
    with pytest.raises(CaptureError, match=f"{words}.*export it without"):
        read(tmp_path, document, binary)


def changed(change):
    document, binary = tetrahedron()
    change(document)
    return packed(document, binary)


def accessor(**values):
    return lambda document: document["accessors"][0].update(values)


FAULTS = {
    "no buffer view": accessor(bufferView=99),
    "a buffer view of -1": accessor(bufferView=-1),
    "an unknown kind": accessor(componentType=5124),
    "another type": accessor(type="MAT4"),
    "a type that is none": accessor(type=3),
    "corners that are no whole numbers": lambda d: d["accessors"][1].update(
        componentType=5126, count=6
    ),
    "a count of -1": accessor(count=-1),
    "a count of a text": accessor(count="4"),
    "a count of 2^29": accessor(count=1 << 29),
    "a count beyond the buffer": accessor(count=400),
    "an offset of -1": accessor(byteOffset=-1),
    "no count": lambda d: d["accessors"][0].pop("count"),
    "zeros of 2^29": lambda d: d.update(
        accessors=[{"type": "VEC3", "componentType": 5126, "count": 1 << 29}] * 3
    ),
    "a buffer of -1": lambda d: d["bufferViews"][0].update(buffer=-1),
    "a stride of 1": lambda d: d["bufferViews"][0].update(byteStride=1),
    "a stride of 2^40": lambda d: d["bufferViews"][0].update(byteStride=1 << 40),
    "a view beyond the buffer": lambda d: d["bufferViews"][0].update(byteLength=1 << 40),
    "a buffer that is cut off": lambda d: d["buffers"][0].update(byteLength=1 << 20),
    "a buffer that is not there": lambda d: d["buffers"][0].update(uri="gone.bin"),
    "a text that is no base64": lambda d: d["buffers"][0].update(uri="data:,%%%"),
    "a node of itself": lambda d: d["nodes"][0].update(children=[0]),
    "a child that is not there": lambda d: d["nodes"][0].update(children=[7]),
    "a mesh that is not there": lambda d: d["nodes"][0].update(mesh=7),
    "a matrix of three": lambda d: d["nodes"][0].update(matrix=[1, 2, 3]),
    "a rotation of none": lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 0]),
    "a scale of 1e200": lambda d: d["nodes"][0].update(scale=[1e200, 1, 1]),
    "a scene that is not there": lambda d: d.update(scene=4),
    "meshes that are a text": lambda d: d.update(meshes="all"),
    "primitives without attributes": lambda d: d["meshes"][0].update(primitives=[{}]),
    "another number of coordinates": accessor(count=2),
    "a corner that is not there": lambda d: [d["accessors"][n].update(count=2) for n in (0, 2)],
    "more faces than are read": lambda d: [
        d["accessors"][1].update(count=9_000_000),
        d["meshes"][0].update(primitives=2 * d["meshes"][0]["primitives"]),
    ],
    "another version": lambda d: d.update(asset={"version": "1.0"}),
    "no asset": lambda d: d.pop("asset"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_words_of_ours(tmp_path, fault):
    (tmp_path / "scan.glb").write_bytes(changed(FAULTS[fault]))
    with pytest.raises(CaptureError) as refused:
        read_mesh(tmp_path / "scan.glb")
    assert not PYTHON.search(str(refused.value)), refused.value
    assert "check the file" in str(refused.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"),
        ("scan.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("scan.obj", b"v 0\nv 1\nv 2\nf 1 2 3\n"),
        (
            "scan.ply",
            b"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
        ),
        ("scan.off", b"OFF\n4000000000 1 0\n0 0 0\n"),
        ("scan.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000)),
        ("scan.glb", struct.pack("<4sII", b"glTF", 99, 20) + b"\0" * 8),
        ("scan.glb", packed({"asset": {"version": "2.0"}})[:-20]),
        ("scan.gltf", b'{"asset": {"version": "2.0"}, "nodes": [{"scale": [NaN, 1, 1]}]}'),
        ("scan.gltf", b"[" * 100_000),
    ],
)
def test_files_that_are_none(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CaptureError) as refused:
        read_mesh(tmp_path / name)
    assert not PYTHON.search(str(refused.value)), refused.value


def test_numbers_that_are_none_are_told_and_nothing_else(tmp_path):
    """A NaN that signals makes NumPy warn where it is widened."""
    document, binary = tetrahedron()
    binary = b"\x01\x00\xa0\x7f" + binary[4:]
    assert "corners that are no numbers" in read(tmp_path, document, binary).notes[0]


def test_small_files_take_little(tmp_path):
    """Instances, tables and holes are counted before anything is made of them."""
    document, binary = tetrahedron()
    begin, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    many = [{"mesh": 0}] * 3_000
    document |= {"nodes": many, "scenes": [{"nodes": list(range(len(many)))}]}
    document["accessors"][1].update(count=12)
    given = read(tmp_path, document, binary)
    assert len(given.faces) == 4 * len(many)
    document["nodes"] = many * 20
    with pytest.raises(CaptureError, match="nodes"):
        read(tmp_path, document, binary)
    big = b'{"a":[' + b"{}," * 3_000_000 + b'{}],"asset":{"version":"2.0"}}'
    (tmp_path / "scan.gltf").write_bytes(big)
    with pytest.raises(CaptureError, match="too many entries"):
        read_mesh(tmp_path / "scan.gltf")
    for suffix in (".glb", ".obj", ".stl"):
        with (tmp_path / f"hole{suffix}").open("wb") as hole:
            hole.truncate(1_900_000_000)
        with pytest.raises(CaptureError, match="bytes"):
            read_mesh(tmp_path / f"hole{suffix}")
    assert time.process_time() - begin < 15
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000  # KiB


def test_objects_of_many_materials_take_no_longer(tmp_path):
    lines = "".join(f"usemtl m{n}\nf 1 2 3\n" for n in range(100_000))
    (tmp_path / "scan.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + lines)
    begin = time.process_time()
    assert len(read_mesh(tmp_path / "scan.obj").faces) == 100_000
    assert time.process_time() - begin < 5


@pytest.mark.parametrize("kind", ["wide", "passes", "large"])
def test_pictures_of_normals_pass_the_door_for_photographs(tmp_path, kind):
    document, binary = tetrahedron()
    file = io.BytesIO()
    if kind == "passes":
        Image.new("RGB", (1000, 1000)).save(file, "JPEG", progressive=True)
        content = file.getvalue()
        scan = content[content.index(b"\xff\xda") : content.rindex(b"\xff\xda")]
        content = content[:-2] + scan * 400 + content[-2:]
    else:
        size = (70_000, 2) if kind == "wide" else (12_000, 9_000)
        Image.new("1", size).save(file, "PNG")
        content = file.getvalue()
    (tmp_path / "normal.bin").write_bytes(content)
    document |= {
        "materials": [{"normalTexture": {"index": 0}}], "textures": [{"source": 0}],
        "images": [{"bufferView": len(document["bufferViews"])}],
    }  # fmt: skip
    document["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)}
    )
    given = read(tmp_path, document, binary + content)
    assert given.detail is None
    assert re.search("megapixels|passes", given.notes[0])


def test_pictures_of_normals_are_counted_together(tmp_path, monkeypatch):
    """Four of 90 megapixels take 2.9 GB."""
    monkeypatch.setattr("robir.capture.gltf_file.MAX_PIXELS", 100)
    document, binary = tetrahedron()
    for number in range(2):
        file = io.BytesIO()
        Image.new("RGB", (8, 8), (128, 128, 255 - number)).save(file, "PNG")
        document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(binary), "byteLength": len(file.getvalue())}
        )
        binary += file.getvalue()
    primitive = document["meshes"][0]["primitives"][0]
    document["meshes"][0]["primitives"] = [primitive | {"material": n} for n in range(2)]
    document |= {
        "materials": [{"normalTexture": {"index": n}} for n in range(2)],
        "textures": [{"source": n} for n in range(2)],
        "images": [{"bufferView": 3 + n, "mimeType": "image/png"} for n in range(2)],
    }
    document["buffers"][0]["byteLength"] = len(binary)
    assert "with the others it has too many pixels" in read(tmp_path, document, binary).notes[0]
