# SPDX-License-Identifier: Apache-2.0
"""Surface samples are even; a baked transport survives its files."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from transport.shapes import box, looking_at, mesh_of, patch, photograph

from robir.errors import StorageError
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.transport.baked import Transport, bake
from robir.transport.config import TransportConfig
from robir.transport.surfels import Surfels, interpolate, sample_surfels


def uneven_mesh() -> Mesh:
    """Two squares of one area: one of two triangles, one of 1800; and a box."""
    return mesh_of(
        patch((-1, -1, 0), (1, 0, 0), (0, 2, 0)),
        patch((0, -1, 0), (1, 0, 0), (0, 2, 0), 30),
        *box((-0.3, -0.3, 0.2), (0.3, 0.3, 0.6)),
    )


def test_samples_are_even_whatever_the_triangles():
    surfels = sample_surfels(uneven_mesh(), 3000, np.random.default_rng(0))
    x, z = surfels.position[:, 0], surfels.position[:, 2]
    coarse, fine = ((z == 0) & (x < 0)).sum(), ((z == 0) & (x > 0)).sum()
    assert coarse == pytest.approx(fine, rel=0.05)
    area = {"floor": 4.0, "box": 0.36 + 4 * 0.24}
    density = (coarse + fine) / area["floor"]
    assert (z > 0).sum() == pytest.approx(density * area["box"], rel=0.25)


def test_samples_leave_no_gaps_and_do_not_clump():
    mesh = uneven_mesh()
    surfels = sample_surfels(mesh, 3000, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    corners = mesh.vertices[mesh.faces].astype(float)
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    face = rng.choice(len(area), 5000, p=area / area.sum()).astype(np.int32)
    weights = rng.dirichlet(np.ones(3), 5000).astype(np.float32)
    points, _ = interpolate(mesh, face, weights)
    tree = cKDTree(surfels.position)
    assert tree.query(points)[0].max() < 1.5 * surfels.spacing
    nearest = tree.query(surfels.position, k=2)[0][:, 1]
    # Of independent samples, mean nearest distance is half of one over the root of density.
    poisson = 0.5 * np.sqrt(area.sum() / 2 / len(surfels))
    assert nearest.mean() > 1.45 * poisson


def test_normals_keep_the_two_sides_of_a_thin_wall_apart():
    position = np.float32([[0, 0, 0.01], [0, 0, -0.01]])
    normal = np.float32([[0, 0, 1], [0, 0, -1]])
    surfels = Surfels(position=position, normal=normal, spacing=0.05)
    np.testing.assert_array_equal(surfels.nearest(position[::-1], normal), [0, 1])
    many = np.repeat(position[::-1], 50, axis=0), np.repeat(normal, 50, axis=0)
    np.testing.assert_array_equal(surfels.shared_nearest(*many), np.repeat([0, 1], 50))


def test_points_that_crowd_share_a_sample_that_is_hardly_further():
    rng = np.random.default_rng(0)
    place = np.pad(rng.uniform(-1, 1, (30_000, 2)), ((0, 0), (0, 1))).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (len(place), 1))
    surfels = Surfels(position=place[:400], normal=up[:400], spacing=0.1)
    apart = [
        np.linalg.norm(place - place[found], axis=1)
        for found in (surfels.nearest(place, up), surfels.shared_nearest(place, up))
    ]
    assert (apart[1] - apart[0]).max() < 2 * 0.25 * 0.1 * np.sqrt(2)
    assert apart[1].mean() < 1.06 * apart[0].mean()
    assert (apart[1] > apart[0]).mean() > 0.01


@pytest.fixture(scope="module")
def baked() -> tuple[Mesh, tuple, Transport]:
    mesh = mesh_of(
        patch((-0.8, -0.8, 0), (1.6, 0, 0), (0, 1.6, 0), 8),
        *box((-0.25, -0.25, 0), (0.25, 0.25, 0.5)),
    )
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)

    def shade(points, face, view_dir):
        return np.where(points[:, :1] > 0.3, 1.0, 0.4) * np.ones(3)

    views = tuple(
        photograph(tracer, shade, looking_at((2 * np.cos(a), 2 * np.sin(a), 1.5), size=48), str(a))
        for a in (0.3, 2.3, 4.3)
    )
    return mesh, views, bake(mesh, views, config(), 0)


def config(**changes) -> TransportConfig:
    return TransportConfig(num_surfels=600, num_directions=100, **changes)


def test_a_transport_reads_back_as_it_was_written(baked, tmp_path):
    _, _, transport = baked
    transport.save(tmp_path)
    again = Transport.load(tmp_path)
    for part in ("surfels", "visibility", "observations"):
        ours, theirs = getattr(transport, part), getattr(again, part)
        for name in ours.__dataclass_fields__:
            first, second = getattr(ours, name), getattr(theirs, name)
            if name == "bounce":
                assert first.nnz > 0 and (first != second).nnz == 0
            else:
                np.testing.assert_array_equal(first, second, strict=True)
    assert transport.observations.clipped.any()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize(
    ("file", "name", "change"),
    [("bounce", "indices", 10**6), ("surfels", "weight", -2), ("visibility", "bits", None)],
)
def test_a_transport_that_is_none(baked, tmp_path, file, name, change):
    """Of an index out of the matrix C would read whatever lies there."""
    baked[2].save(tmp_path)
    with np.load(tmp_path / f"{file}.npz") as arrays:
        kept = dict(arrays)
    changed = kept[name][:, 1:] if change is None else kept[name] + kept[name].dtype.type(change)
    np.savez(tmp_path / f"{file}.npz", **kept | {name: changed})
    with pytest.raises(StorageError, match="damaged"):
        Transport.load(tmp_path)


def test_the_same_seed_bakes_the_same(baked):
    mesh, views, transport = baked
    again = bake(mesh, views, config(), 0)
    np.testing.assert_array_equal(again.surfels.position, transport.surfels.position)
    np.testing.assert_array_equal(again.visibility.bits, transport.visibility.bits)


def test_most_samples_are_spent_on_what_the_cameras_see(baked):
    _, _, transport = baked
    assert ((transport.observations.weight > 0).sum(1) > 0).mean() > 0.7


def test_ablations_leave_out_shadows_or_bounces(baked):
    mesh, views, transport = baked
    free = bake(mesh, views, config(use_visibility=False), 0).visibility
    above = transport.surfels.normal @ free.directions.T > 0
    np.testing.assert_array_equal(free.unpacked(), above)
    assert free.bounce.nnz == 0 and not free.is_traced
    direct = bake(mesh, views, config(use_indirect=False), 0).visibility
    np.testing.assert_array_equal(direct.bits, transport.visibility.bits)
    assert direct.bounce.nnz == 0 and direct.is_traced
