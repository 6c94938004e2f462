# SPDX-License-Identifier: Apache-2.0
"""What a mesh with a normal map brings to the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evaluation.sphere_run import sphere_textures
from geometry.given.test_surface import Quiet
from geometry.scenes import ball, capture_of

from robir.capture.mesh_file import Detail, Given
from robir.capture.store import save_capture
from robir.export.gltf import write_glb
from robir.export.textures import TexturedPart, finished_textures, stored_normal_map
from robir.geometry.config import GeometryConfig
from robir.geometry.given.ready import made_ready
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.stage import run
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths

BUMPS = np.full((8, 8, 3), (128, 128, 255), np.uint8)


def given() -> Given:
    """A ball whose faces each have a place of their own, with normals all a little askew."""
    solid = ball(0.8, (0.0, 0.0, 0.0))
    corners = np.array(solid.triangles).reshape(-1, 3)
    count = len(corners) // 3
    side = int(np.ceil(np.sqrt(count)))
    cell = np.stack(np.divmod(np.arange(count), side), axis=1)[:, None]
    uvs = (cell + np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]])) / side
    normals = corners + np.array([0.0, 0.0, 0.1])
    return Given(
        vertices=corners,
        faces=np.arange(len(corners), dtype=np.int32).reshape(-1, 3),
        uvs=uvs.reshape(-1, 2),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        detail=Detail(maps=(BUMPS,), of_face=np.zeros(count, np.int32)),
    )


@pytest.mark.parametrize("face_budget", [8000, 500])
def test_a_mesh_that_keeps_its_layout_keeps_map_and_normals(face_budget):
    one = given()
    ready = made_ready(one, GeometryConfig(face_budget=face_budget), Quiet().warn)
    assert ready.normal_maps == (BUMPS,)
    mesh = ready.mesh
    assert mesh.is_whole()
    assert mesh.vertices[mesh.faces] == pytest.approx(one.vertices[one.faces], abs=1e-6)
    assert mesh.normals[mesh.faces] == pytest.approx(one.normals[one.faces], abs=1e-6)
    assert mesh.uvs[mesh.uv_faces] == pytest.approx(one.uvs[one.faces], abs=1e-6)
    assert len(mesh.vertices) < len(one.vertices) / 5  # shared again
    assert ready.light is not None
    assert len(ready.light.faces) <= min(len(one.faces), 4 * face_budget)


def two_maps(one: Given) -> Detail:
    """Every other face has another map, and one none."""
    of_face = np.arange(len(one.faces), dtype=np.int32) % 2
    of_face[0] = -1
    return Detail(maps=(BUMPS, BUMPS // 2), of_face=of_face)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"uvs": given().uvs * 1.49}, "coordinates that are not kept"),
        ({"normals": -given().normals}, "point to the inside"),
        ({"detail": two_maps(given())}, "materials have different ones, or"),
    ],
)
def test_a_map_that_does_not_fit_the_result_is_left_out_and_told(change, reason):
    one = replace(given(), **change)
    ready = made_ready(one, GeometryConfig(), Quiet().warn)
    assert not ready.normal_maps
    assert any(reason in note for note in ready.notes)


def test_the_stage_keeps_the_map_for_the_asset(tmp_path):
    solid = ball(0.8, (0.0, 0.0, 0.0))
    capture = capture_of(solid, views=12, side=64, low=-0.6)
    paths = JobPaths(tmp_path / "out")
    save_capture(paths.stage("capture"), capture)
    mesh = plain_mesh(given().vertices, given().faces)
    mesh = replace(mesh, uvs=given().uvs.astype(np.float32), uv_faces=mesh.faces)
    textures = replace(finished_textures(sphere_textures(), 12), normal_map=BUMPS)
    write_glb(
        tmp_path / "scan.glb", [TexturedPart(tile=None, mesh=mesh, textures=textures)], "scan"
    )
    context = StageContext(
        paths=paths, config=GeometryConfig(), source=tmp_path, masks=None, seed=0, device="cpu",
        reporter=Quiet(), mesh=tmp_path / "scan.glb",
    )  # fmt: skip
    assert run(context)["layout"] == "own"
    assert (stored_normal_map(paths.normal_map) == BUMPS).all()
