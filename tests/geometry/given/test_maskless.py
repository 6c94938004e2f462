# SPDX-License-Identifier: Apache-2.0
"""Photographs from which no mask can be guessed, and the mesh that says where the object is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from capture.masks import scene
from geometry.given.test_surface import Quiet

from robir.capture import recognise
from robir.capture.config import CaptureConfig
from robir.capture.recognise import read_capture
from robir.capture.refusal import CaptureRefusedError
from robir.geometry.config import GeometryConfig
from robir.geometry.given.surface import hand_in


def test_outlines_come_from_the_mesh_where_object_and_background_look_alike(tmp_path):
    shots = scene.photographs(12, has_camouflage=True)
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=scene.RADIUS)
    ball.apply_translation(scene.BALL)
    box = trimesh.creation.box(bounds=[scene.BOX_LOW, scene.BOX_HIGH])
    path = tmp_path / "scan.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(trimesh.util.concatenate([ball, box])))
    config = CaptureConfig(max_side=160)
    capture = read_capture(source, None, config, guesses=tmp_path / "masks", mesh=path)
    about = [finding for finding in capture.findings if finding.code == "mesh-masks"]
    assert len(about) == 1
    assert "none could be guessed" in about[0].message
    assert len(capture.views) == len(shots)
    assert not (tmp_path / "masks").exists()
    handed = hand_in(
        path, (capture, capture.normalised()), GeometryConfig(), tmp_path / "fit.png", Quiet()
    )
    assert handed.views is not None
    for rough, view, shot in zip(capture.views, handed.views, shots, strict=True):
        height, width = view.mask.shape
        whole = np.zeros(shot.truth.shape, bool)
        x, y = (round(-edge) for edge in view.camera.edges[:2])
        whole[y : y + height, x : x + width] = view.mask > 127
        assert scene.overlap(whole, shot.truth) > 0.96
        assert (rough.mask > 127).sum() > (view.mask > 127).sum()


def test_a_mesh_cannot_say_where_the_object_is_if_the_cameras_have_a_frame_of_ours(
    tmp_path, monkeypatch
):
    shots = scene.photographs(12, has_camouflage=True)
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    frames = replace(recognise.read_frames(source), format="photos")
    monkeypatch.setattr(recognise, "read_frames", lambda *_: frames)
    path = tmp_path / "scan.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(trimesh.creation.icosphere(2, scene.RADIUS)))
    config = CaptureConfig(max_side=160)
    with pytest.raises(CaptureRefusedError, match="the mesh cannot say, for masks tell where"):
        recognise.read_capture(source, None, config, mesh=path)
