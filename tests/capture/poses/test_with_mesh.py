# SPDX-License-Identifier: Apache-2.0
"""Photographs alone and a mesh of what they show, through the first two stages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from addon.tiny_engine import QUICK_TO_PLACE
from capture.poses.room import RADIUS, Registered, Walk
from geometry.given.test_surface import Quiet

from robir.capture.config import CaptureConfig
from robir.capture.recognise import Workshop, read_capture
from robir.capture.store import load_settled, save_capture
from robir.constants import changed
from robir.geometry import stage
from robir.geometry.config import GeometryConfig
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths, read_json

pytestmark = [pytest.mark.pycolmap, pytest.mark.slow]


class Listener(Quiet):
    """Keeps what is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def warn(self, message: str) -> None:
        self.told.append(message)


# of the mesh's frame, in which the floor's normal is the second axis
SCALE, CENTRE = 250.0, np.array([4e3, -1e3, 7e3])


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The half of the boulder above the floor, as the user has it."""
    up = np.linspace(0.0, np.pi / 2, 25)
    arc = RADIUS * np.stack([np.cos(up), np.sin(up)], axis=1)
    half = trimesh.creation.revolve([(0.0, 0.0), *arc[:-1], (0.0, RADIUS)], sections=64)
    half.vertices = SCALE * half.vertices[:, [1, 2, 0]] + CENTRE
    path = tmp_path_factory.mktemp("mesh") / "boulder.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(half))
    return path


def test_cameras_of_photographs_alone_come_to_the_mesh(
    walk: Walk, registered: Registered, mesh: Path, tmp_path: Path
):
    workshop = Workshop(folder=registered.work, seed=0)
    capture = read_capture(walk.folder, None, CaptureConfig(), workshop=workshop, mesh=mesh)
    paths, listener = JobPaths(tmp_path), Listener()
    save_capture(paths.stage("capture"), capture)
    context = StageContext(
        paths=paths,
        config=GeometryConfig(),
        source=walk.folder,
        masks=None,
        seed=0,
        device="cpu",
        reporter=listener,
        mesh=mesh,
    )
    with changed(QUICK_TO_PLACE):
        metrics = stage.run(context)
    assert metrics["outline_agreement"] > 0.95
    assert any("brought to the mesh" in text for text in listener.told)
    assert paths.mesh_fit.exists()
    # the boulder is round, so heights above the floor and distances are all that can be known
    known = {f"p{i:02d}": camera for i, camera in enumerate(walk.cameras)}
    settled = load_settled(paths)
    away = [known[view.name].position for view in settled.views]
    found = np.stack([view.camera.position - CENTRE for view in settled.views]) / SCALE
    assert found[:, 1] == pytest.approx(np.array(away)[:, 2], abs=0.06)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.linalg.norm(away, axis=1), abs=0.06)
    across = np.array(away)[:, [1, 0]]
    turned = np.arctan2(found[:, 2], found[:, 0]) - np.arctan2(across[:, 1], across[:, 0])
    assert np.abs(np.exp(1j * turned).mean()) > 0.999
    # and the result folder says all of it
    assert read_json(paths.frame)["bounds"]["radius"] == pytest.approx(SCALE * RADIUS, rel=0.1)
