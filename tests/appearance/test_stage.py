# SPDX-License-Identifier: Apache-2.0
"""The whole stage on a ball with a spot of known paint, two photographs in another light."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from robir.appearance import stage, texturing
from robir.appearance.config import AppearanceConfig
from robir.capture.store import save_capture
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.unwrap import unwrap
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths
from robir.transport.baked import bake
from robir.transport.config import TransportConfig
from tests.appearance.photometry.test_other_light import shaded
from tests.geometry.scenes import ball, capture_of

CONFIG = AppearanceConfig(
    families=("standard",),
    num_soft_lobes=8,
    num_sharp_lobes=0,
    num_solve_surfels=500,
    iterations=20,
    num_materials=1,
    shading_size=64,
    texture_size=64,
)

PAINT = (0.4, 0.35, 0.3)  # albedo of one spot, as a user tells it

DARK = ("view_003", "view_004")


@pytest.mark.slow
def test_photographs_in_another_light_take_no_part_in_the_texture(tmp_path: Path, monkeypatch):
    solid = ball(0.7, (0.0, 0.0, 0.0))
    whole = capture_of(solid, views=24)
    views = tuple(shaded(view) if view.name in DARK else view for view in whole.views)
    capture = replace(whole, views=(*views[:-1], replace(views[-1], split="held_out")))
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), capture)
    mesh = unwrap(plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces)), 20.0, print)
    paths.stage("geometry").mkdir(parents=True)
    mesh.save(paths.stage("geometry") / "mesh.npz")
    spot = mesh.uvs[mesh.uv_faces].mean(1)[np.argmax(mesh.vertices[mesh.faces].mean(1)[:, 2])]
    paths.stage("transport").mkdir(parents=True)
    sizes = TransportConfig(num_surfels=1500, num_directions=64)
    bake(mesh, capture.train, sizes, seed=0).save(paths.stage("transport"))
    paths.stage("appearance").mkdir(parents=True)
    read: list[str] = []
    lit_texels = texturing.LitTexels.of

    def recorded(solved, texels, views, *others):
        read.extend(view.name for view in views)
        return lit_texels(solved, texels, views, *others)

    monkeypatch.setattr(texturing.LitTexels, "of", recorded)
    stage.run(
        StageContext(
            paths=paths,
            config=replace(CONFIG, white_point=(*map(float, spot), *PAINT)),
            source=tmp_path,
            masks=None,
            seed=0,
            device="cpu",
            reporter=Mock(),
        )
    )
    told = json.loads((paths.stage("appearance") / "exposure.json").read_text())
    assert set(told["other_light"]) == set(DARK)
    assert len(read) >= 15 and not set(read) & set(DARK)
    with np.load(paths.stage("appearance") / "textures.npz") as textures:
        side = len(textures["inside"])
        rows, columns = np.indices((side, side)) + 0.5
        near = np.hypot(rows - (1 - spot[1]) * side, columns - spot[0] * side) <= 1.5
        about = textures["albedo_linear"][near & textures["inside"]]
        assert about.mean(0) == pytest.approx(PAINT, rel=0.03)
