# SPDX-License-Identifier: Apache-2.0
"""Lens models that pycolmap evaluates, against their formulas and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from capture import writers
from capture.scene import Shot, cameras, shoot

from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion
from robir.capture.recognise import read_capture

pytestmark = pytest.mark.pycolmap

MODELS = {
    "FOV": (0.7,),
    "SIMPLE_DIVISION": (-0.25,),
    "DIVISION": (-0.25,),
    "EUCM": (0.6, 1.1),
    "THIN_PRISM_FISHEYE": (0.05, -0.02, 0.001, 0.002, 0.01, 0.002, 0.003, -0.002),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.05, -0.02, 0.01, 0, 0, 0, 0.01, 0.02, 0.01, 0, 0.02, 0),
}


def fov(x, y, omega):
    r = np.hypot(x, y)
    scale = np.arctan(2 * r * np.tan(omega / 2)) / omega / r
    return x * scale, y * scale


def eucm(x, y, alpha, beta):
    depth = alpha * np.sqrt(beta * (x**2 + y**2) + 1) + 1 - alpha
    return x / depth, y / depth


def division(x, y, k):
    """The distorted radius solves r = d / (1 + k d^2)."""
    r = np.hypot(x, y)
    d = (1 - np.sqrt(1 - 4 * k * r**2)) / (2 * k * r)
    return x * d / r, y * d / r


@pytest.mark.parametrize("model", [fov, eucm, division])
def test_formulas(model):
    x, y = np.random.default_rng(0).uniform(-0.6, 0.6, (2, 7, 50))
    name = model.__name__.upper()
    found = Distortion(model=name, others=MODELS[name]).apply(x, y)
    np.testing.assert_allclose(found, model(x, y, *MODELS[name]), atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_a_capture_keeps_its_object_in_place(model, tmp_path):
    shots = [shoot(camera, samples=1) for camera in cameras(size=(120, 100))]
    writers.colmap(tmp_path, [bent(shot, model) for shot in shots], binary=False)
    lens = " ".join(map(str, parameters(shots[0], model)))
    (tmp_path / "sparse/0/cameras.txt").write_text(f"3 {model} 120 100 {lens}\n")
    capture = read_capture(tmp_path, None, CaptureConfig(adjust_cameras=False))
    assert "undistorted" in {finding.code for finding in capture.findings}
    for view in capture.views:
        truth, found = shoot(view.camera, samples=1).rgba[:, :, 3] > 0, view.mask >= 128
        assert (truth & found).sum() / (truth | found).sum() > 0.96


def parameters(shot: Shot, model: str) -> list[float]:
    camera = shot.camera
    focals = [camera.fx] if model.startswith("SIMPLE") else [camera.fx, camera.fy]
    return [*focals, camera.cx, camera.cy, *MODELS[model]]


def bent(shot: Shot, model: str) -> Shot:
    """The same shot through a lens, by pycolmap's inverse."""
    import pycolmap

    camera = shot.camera
    lens = pycolmap.Camera(model=model, width=120, height=100, params=parameters(shot, model))
    x, y = lens.cam_from_img(camera.pixel_centres())[:, :2].T
    column = np.clip(x * camera.fx + camera.cx, 0.5, camera.width - 0.5).astype(int)
    row = np.clip(y * camera.fy + camera.cy, 0.5, camera.height - 0.5).astype(int)
    return Shot(camera, shot.rgba[row, column].reshape(shot.rgba.shape))
