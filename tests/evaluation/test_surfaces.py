# SPDX-License-Identifier: Apache-2.0
"""Ray casting, texture look-up and surface distances against closed forms and brute force."""

import numpy as np
import pytest
import trimesh

from robir.capture.camera import Camera
from robir.evaluation.layers import view_layers
from robir.evaluation.surfaces import MeshCaster
from robir.geometry.mesh.tiles import sample_texture
from robir.geometry.mesh.triangles import Mesh, vertex_normals
from robir_bench.truth import surfaces


def mesh_of(solid, uvs=None, uv_faces=None):
    vertices = np.asarray(solid.vertices, np.float32)
    faces = np.asarray(solid.faces, np.int32)
    return Mesh(
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uvs=np.zeros((0, 2), np.float32) if uvs is None else uvs,
        uv_faces=np.zeros((0, 3), np.int32) if uv_faces is None else uv_faces,
    )


def camera_at(distance, size=41):
    pose = np.eye(4)
    pose[2, 3] = distance
    focal = size * 1.2
    return Camera(
        width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2, camera_to_world=pose
    )


def test_a_sphere_is_seen_as_a_sphere():
    seen = MeshCaster(mesh_of(trimesh.creation.icosphere(5))).cast(camera_at(4.0))
    camera = camera_at(4.0)
    _, direction = camera.rays(camera.pixel_centres())
    half = camera.position @ direction.T
    discriminant = half**2 - (16.0 - 1.0)
    expected = (discriminant > 0).reshape(41, 41)
    assert np.mean(seen.hit == expected) > 0.995
    both = seen.hit & expected
    t = -half - np.sqrt(np.maximum(discriminant, 0))
    point = (camera.position + t[:, None] * direction).reshape(41, 41, 3)
    inner = both & (discriminant.reshape(41, 41) > 0.05)
    assert np.abs(seen.position - point)[inner].max() < 2e-3
    assert np.abs(seen.normal - point)[inner].max() < 1e-2


def quad():
    """Facing +z with u to the right and v up, so that a picture shows the texture as stored."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return Mesh(
        vertices=corners,
        faces=faces,
        normals=vertex_normals(corners, faces),
        uvs=uvs,
        uv_faces=faces,
    )


def test_layers_are_means_over_pixels():
    # three columns of pixels, and a texture whose edge runs a third into the middle one
    pose = np.eye(4)
    pose[2, 3] = 10.0
    camera = Camera(width=3, height=3, fx=15, fy=15, cx=1.5, cy=1.5, camera_to_world=pose)
    albedo = np.zeros((900, 900, 3))
    albedo[:, 400:] = 0.6
    textures = {
        "albedo_linear": albedo,
        "roughness": np.full((900, 900), 0.3),
        "inside": np.ones((900, 900), bool),
    }
    (layers,) = view_layers(quad(), textures, [camera])
    assert layers.hit.all()
    assert layers.albedo_linear[:, :, 0] == pytest.approx(np.tile([0.0, 0.4, 0.6], (3, 1)))
    assert layers.roughness == pytest.approx(np.full((3, 3), 0.3))
    centres = np.stack(np.meshgrid([-2 / 3, 0, 2 / 3], [2 / 3, 0, -2 / 3]), axis=-1)
    assert layers.position[..., :2] == pytest.approx(centres, abs=1e-6)
    assert layers.normal == pytest.approx(np.broadcast_to([0.0, 0.0, 1.0], (3, 3, 3)), abs=1e-6)
    pose[0, 3] = 0.2  # the last column reaches beyond the edge: the mean of what is met
    aside = Camera(width=3, height=3, fx=15, fy=15, cx=1.5, cy=1.5, camera_to_world=pose)
    (layers,) = view_layers(quad(), textures, [aside])
    assert layers.hit.all()
    assert layers.albedo_linear[:, 2, 0] == pytest.approx(np.full(3, 0.6))


def test_texture_sampling_is_linear_and_blind_to_empty_texels():
    rows, columns = np.mgrid[:16, :16] + 0.5
    texture = np.stack([columns / 16, 1 - rows / 16], axis=-1)
    uv = np.random.default_rng(1).uniform(0.1, 0.9, (200, 2))
    assert sample_texture(texture, uv) == pytest.approx(uv, abs=1e-9)
    inside = np.ones((16, 16), bool)
    inside[:, 8:] = False
    texture[~inside] = 1e6
    near = np.array([[0.4999, 0.5], [0.48, 0.5]])
    value = sample_texture(texture, near, inside)[:, 0]
    assert value == pytest.approx([7.5 / 16, 7.5 / 16], abs=0.02)


def test_distance_is_the_nearest_triangles():
    rng = np.random.default_rng(2)
    solid = trimesh.creation.torus(1.0, 0.3, 24, 12)
    points = rng.uniform(-1.5, 1.5, (200, 3))
    every = np.stack(
        [
            np.linalg.norm(
                trimesh.triangles.closest_point(solid.triangles, np.tile(p, (len(solid.faces), 1)))
                - p,
                axis=1,
            ).min()
            for p in points
        ]
    )
    found = surfaces.surface_distance(points, solid.vertices, solid.faces)
    assert found == pytest.approx(every, abs=1e-9)


def test_chamfer_of_two_spheres_is_their_gap():
    inner, outer = trimesh.creation.icosphere(5), trimesh.creation.icosphere(5, radius=1.02)
    scores = surfaces.chamfer(
        inner.vertices, outer.vertices, mesh_of(inner), mesh_of(outer), radius=2.0
    )
    for name in ("chamfer", "accuracy", "completeness"):
        assert scores[name] == pytest.approx(10.0, rel=0.02)


def test_normal_scores_count_misses():
    rng = np.random.default_rng(4)
    truth = rng.normal(size=(1000, 3))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    side = np.cross(truth, rng.normal(size=(1000, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    tilt = np.radians(10.0)
    estimate = np.cos(tilt) * truth + np.sin(tilt) * side
    hit = np.arange(1000) >= 250
    scores = surfaces.normal_scores(estimate, truth, hit)
    assert scores["mean_degrees"] == pytest.approx(0.75 * 10 + 0.25 * 90)
    assert scores["median_degrees"] == pytest.approx(10.0)
