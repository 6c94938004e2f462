# SPDX-License-Identifier: Apache-2.0
"""The surface that grows inside the capture's bounds while it is fitted."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from addon.blenders import run, sessions
from addon.test_capture_operators import ENGINE
from PIL import Image

pytestmark = pytest.mark.blender

WORDS = sessions("capture_session", "growing_session")
NOTHING = {"objects": 0, "meshes": 0}

BALL = trimesh.creation.icosphere(subdivisions=2, radius=120.0)
MIDDLE = np.array([795.0, 800.0, 0.0])
VERTICES = (BALL.vertices + MIDDLE).astype(np.float32)
FACES = BALL.faces.astype(np.int32)


@pytest.fixture
def session(extension_zip, tmp_path):
    def part(blender, name, *arguments):
        words = [str(word) for word in arguments]
        user = tmp_path / "user"
        return run(blender, WORDS, name, str(extension_zip), ENGINE, *words, user=user)

    return part


def stored(vertices=VERTICES, faces=FACES, save=np.savez, **others) -> bytes:
    file = io.BytesIO()
    arrays = {"vertices": vertices, "faces": faces, **others}
    save(file, **{name: array for name, array in arrays.items() if array is not None})
    return file.getvalue()


def with_one(array, index, value):
    array = array.copy()
    array[index] = value
    return array


def with_head(old: bytes, new: bytes) -> bytes:
    """The good file with other words before the numbers, all sums right."""
    file, whole = io.BytesIO(), zipfile.ZipFile(io.BytesIO(stored()))
    with zipfile.ZipFile(file, "w") as archive:
        for name in whole.namelist():
            archive.writestr(name, whole.read(name).replace(old, new, 1))
    return file.getvalue()


SHAPE = f"({len(VERTICES)}, 3)".encode()
SPOILT = {
    "empty": b"",
    "half": stored()[: len(stored()) // 2],
    "text": b"a mesh",
    "no faces": stored(faces=None),
    "none at all": stored(faces=FACES[:0]),
    "no vertices": stored(vertices=VERTICES[:0]),
    "doubles": stored(vertices=VERTICES.astype(np.float64)),
    "long": stored(faces=FACES.astype(np.int64)),
    "flat": stored(vertices=VERTICES[:, :2]),
    "quads": stored(faces=np.zeros((5, 4), np.int32)),
    "nan": stored(vertices=with_one(VERTICES, 3, np.nan)),
    "infinite": stored(vertices=with_one(VERTICES, 3, np.inf)),
    "beyond": stored(faces=with_one(FACES, (7, 1), len(VERTICES))),
    "below": stored(faces=with_one(FACES, (7, 1), -1)),
    "packed": stored(save=np.savez_compressed),
    "bomb": stored(vertices=np.zeros((1 << 22, 3), np.float32), save=np.savez_compressed),
    "large": stored(vertices=np.zeros((1 << 18, 3), np.float32)),
    "objects": stored(vertices=np.array([[{}, {}, {}]], object)),
    "more than there is": with_head(SHAPE, SHAPE.replace(b"(", b"(9")),
    "less than there is": with_head(SHAPE, b"(1, 3)".ljust(len(SHAPE))),
    "no shape": with_head(b"'shape'", b"'shame'"),
    "flipped": stored()[:900] + bytes([stored()[900] ^ 1]) + stored()[901:],
}


def test_only_whole_files_are_shown_and_nothing_is_left_behind(newest, session, tmp_path):
    photo, root = tmp_path / "photo.png", tmp_path / "out"
    Image.new("RGB", (48, 48)).save(photo)
    root.mkdir()
    raised = VERTICES + np.array([0, 0, 60], np.float32)
    for name, content in {"good": stored(), "other": stored(raised, FACES[::2]), **SPOILT}.items():
        (tmp_path / name).write_bytes(content)
    good, other = tmp_path / "good", tmp_path / "other"
    spoilt = "\n".join(str(tmp_path / name) for name in SPOILT)
    answer = session(newest, "files", photo, root, good, other, spoilt)
    assert answer["without a capture"] == NOTHING
    shown = answer["before"]
    assert (shown["objects"], shown["meshes"], shown["faces"]) == (1, 1, len(FACES))
    # 240 mm are shown as one unit about (0, 0, 1), and so is the ball of half of that
    np.testing.assert_allclose(shown["low"], [-0.5, -0.5, 0.5], atol=0.01)
    np.testing.assert_allclose(shown["high"], [0.5, 0.5, 1.5], atol=0.01)
    assert shown["collections"] == ["RobIR capture"] and shown["hidden"] == [True, True]
    later = answer["other"]
    assert (later["objects"], later["meshes"], later["faces"]) == (1, 1, len(FACES[::2]))
    np.testing.assert_allclose(later["high"][2], 1.75, atol=0.01)
    assert answer["is_same_mesh"]
    assert {Path(name).name for name in answer["spoilt"]} == set(SPOILT)
    for name, what in answer["spoilt"].items():
        assert what == later, name
    assert answer["again"] == answer["undone at work"] == shown
    for name in ("gone", "undone later", "opened later", "put away"):
        assert answer[name] == NOTHING, name
