# SPDX-License-Identifier: Apache-2.0
"""What is set of the mesh reaches it, the child process of its charts too."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from robir.config import RunConfig, resolve
from robir.geometry.mesh.config import MeshConfig
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.simplify import with_creases
from robir.geometry.mesh.unwrap import unwrap


def test_settings_of_the_mesh_change_its_creases_and_its_charts() -> None:
    words = ["geometry.mesh.simplify.crease=100", "geometry.mesh.charts.gutter=40"]
    config = resolve(RunConfig(), None, words).geometry.mesh
    box = trimesh.creation.box()
    mesh = plain_mesh(np.asarray(box.vertices), np.asarray(box.faces))
    assert len(with_creases(mesh, config.simplify).vertices) == 8
    wide, usual = (unwrap(mesh, 60.0, pytest.fail, one) for one in (config, MeshConfig()))
    sides = [np.abs(np.diff(one.uvs[one.uv_faces], axis=1)).mean() for one in (wide, usual)]
    assert sides[0] < 0.95 * sides[1], "more gutter leaves less room for charts"
