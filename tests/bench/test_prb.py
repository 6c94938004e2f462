# SPDX-License-Identifier: Apache-2.0
"""The peer by Mitsuba: cameras, loss, derivatives, a surface with a known albedo."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from evaluation import sphere_run

from robir import cli
from robir.capture.camera import Camera
from robir.errors import DeviceError
from robir.evaluation.light import load_light
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import read_json, write_json
from robir.maths.tone import families
from robir_bench.peers import prb, prb_scene
from robir_bench.peers.prb_fit import Observed, PrbConfig, PrbFit, photo_loss
from robir_bench.peers.prb_scene import all_pixels

SMALL = PrbConfig(steps=80, light_steps=0, batch=1024, texture_size=16, light_rows=16)


@pytest.fixture(scope="module")
def mi():
    try:
        return prb_scene.load_mitsuba()
    except DeviceError as missing:
        pytest.skip(f"THE PEER IS NOT TESTED: {missing}")


def quad(normal_z: float = 1.0) -> Mesh:
    """The square [-1, 1]^2 at z = 0, its texture's u along x and v along y."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    normals = np.tile(np.float32([0, 0, normal_z]), (4, 1))
    uvs = (corners[:, :2] + 1) / 2
    return Mesh(vertices=corners, faces=faces, normals=normals, uvs=uvs, uv_faces=faces)


def oblique_camera(azimuth: float = 0.7) -> Camera:
    """A camera 4.5 from the origin with an odd lens, looking at it."""
    back = np.array([np.cos(azimuth) * 0.6, np.sin(azimuth) * 0.6, 0.8])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :4] = np.stack([right, np.cross(back, right), back, 4.5 * back], axis=1)
    return Camera(width=48, height=32, fx=60.0, fy=50.0, cx=27.0, cy=13.0, camera_to_world=pose)


def test_rays_of_the_sensor_are_those_of_mitsubas_own_camera(mi):
    camera = oblique_camera()
    turn = camera.camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
    own = mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            "principal_point_offset_x": 0.5 - camera.cx / camera.width,
            "principal_point_offset_y": 0.5 - camera.cy / camera.height,
            "to_world": mi.ScalarTransform4f(turn),
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height,
                     "pixel_format": "rgb"},
        }
    )  # fmt: skip
    square = Camera(**{**{f: getattr(camera, f) for f in camera.__slots__}, "fy": camera.fx})
    sensor = prb_scene.pixel_sensor(mi, [square], 1024)
    pixels = all_pixels([square]).chosen(np.arange(1024))
    sensor.look_at(pixels)
    x, y = (pixels.column + 0.5) / camera.width, (pixels.row + 0.5) / camera.height
    theirs, _ = own.sample_ray(0.0, 0.0, mi.Point2f(x, y), 0.0)
    assert np.abs(np.array(theirs.d) - np.array(sensor.centre_rays().d)).max() < 1e-4


@pytest.mark.parametrize("curve", families(), ids=lambda curve: curve.name)
def test_the_loss_is_differentiable_through_the_tone_curve(curve):
    generator = torch.Generator().manual_seed(1)
    linear = 1.5 * torch.rand(40, 3, dtype=torch.float64, generator=generator) + 0.02
    display = torch.rand(40, 3, dtype=torch.float64, generator=generator)
    display[:5] = 1.0
    linear.requires_grad_()
    photo_loss(linear, display, curve).backward()
    step, base = 1e-6, linear.detach()
    for index in range(40):
        nudge = torch.zeros_like(base)
        nudge[index] = step
        rise = photo_loss(base + nudge, display, curve) - photo_loss(base - nudge, display, curve)
        slope = float(linear.grad[index].sum())
        assert slope == pytest.approx(float(rise) / (2 * step), rel=2e-3, abs=2e-6)


def test_light_becomes_lobes_of_its_energy(tmp_path):
    direction = np.array([0.6, 0.0, 0.8])
    radiance = 0.5 + prb_scene.sun_texels(direction, np.full(3, 4.0), 64)
    write_json(tmp_path / "light.json", {"lobes": prb.lobe_table(radiance)})
    light = load_light(tmp_path / "light.json")
    assert light.power().sum() == pytest.approx(2 * np.pi + 4.0, rel=1e-3)
    assert light.strongest_direction() @ direction > np.cos(np.radians(0.5))
    sky = light.environment(32)[8:24]
    assert np.median(sky) == pytest.approx(0.5, rel=0.15)


def test_derivatives_of_the_light_are_those_of_differences(mi):
    """A light whose leaf the renderer has copied would show a derivative of zero."""
    fit = PrbFit(quad(), [oblique_camera()], SMALL)
    pixels = all_pixels([oblique_camera()])
    pixels = pixels.chosen(fit.hits(pixels))
    observed = Observed(pixels=pixels, display=torch.full((len(pixels), 3), 0.5))
    row, column = 4, 9
    with torch.no_grad():
        fit.material.log_radiance[row, column] = 3.0
    chosen = np.arange(SMALL.batch) % len(pixels)
    curve = families()[0]
    gradient = []
    for seed in range(8):
        fit.material.log_radiance.grad = None
        fit.add_gradient(observed, chosen, curve, seed)
        gradient.append(float(fit.material.log_radiance.grad[row, column].sum()))

    def loss(change: float) -> float:
        with torch.no_grad():
            fit.material.log_radiance[row, column] += change
            value = photo_loss(fit.render(pixels, 5, 512), observed.display, curve)
            fit.material.log_radiance[row, column] -= change
        return float(value)

    slope = (loss(0.1) - loss(-0.1)) / 0.2
    assert abs(slope) > 1e-4
    assert np.mean(gradient) == pytest.approx(slope, rel=0.1)


def test_the_albedo_of_a_square_under_even_light_is_found(mi, monkeypatch):
    """A diffuse surface under radiance 1 from everywhere shows its albedo."""
    true = np.full((16, 16, 3), 0.25)
    true[:8, :, 0] = 0.6  # v > 1/2, y > 0
    true[:, 8:, 2] = 0.7  # u > 1/2, x > 0
    camera = oblique_camera().resized(96, 64)

    def diffuse(base_color, roughness):
        front = {"type": "diffuse", "reflectance": base_color}
        back = {"type": "principled", "roughness": roughness}
        return {"type": "twosided", "front": front, "back": back}

    monkeypatch.setattr(prb_scene, "material", diffuse)
    monkeypatch.setattr(prb_scene, "BASE", "surface.bsdf.brdf_0.reflectance.data")
    monkeypatch.setattr(prb_scene, "ROUGHNESS", "surface.bsdf.brdf_1.roughness.data")
    known = {"light_rate": 0.0, "albedo_smoothness": 0.0, "last_rate": 0.02}
    fit = PrbFit(quad(), [camera], replace(SMALL, **known, batch=512, samples=64))
    pixels = all_pixels([camera])
    pixels = pixels.chosen(fit.hits(pixels))
    origins, directions = camera.rays(np.stack([pixels.column, pixels.row], axis=1) + 0.5)
    x, y, _ = (origins - directions * (origins[:, 2:] / directions[:, 2:])).T
    whole = np.maximum(abs(x), abs(y)) < 0.95  # no pixel that shows its edge
    x, y, pixels = x[whole], y[whole], pixels.chosen(whole)
    seen = true[((1 - y) * 8).astype(int).clip(0, 15), ((1 + x) * 8).astype(int).clip(0, 15)]
    curve = families()[0]
    display = curve.display_from_linear(torch.from_numpy(seen).float())
    for _ in fit.run(Observed(pixels=pixels, display=display), curve, torch.ones(16, 16) > 0, 0):
        pass
    found = fit.material.base.detach().numpy()
    for rows, columns in product([slice(2, 5), slice(11, 14)], repeat=2):  # texels ring at edges
        part = (rows, columns)
        assert found[part].mean(axis=(0, 1)) == pytest.approx(true[part][0, 0], rel=0.02)


def test_a_missing_mitsuba_is_an_error_that_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(DeviceError, match=r"pip install 'robir\[peers\]'.*apt-get install libllvm"):
        prb_scene.load_mitsuba()


def test_a_missing_compiler_ends_the_run_and_nothing_else(tmp_path, monkeypatch):
    pytest.importorskip("mitsuba")
    run = sphere_run.make_run(tmp_path / "run")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    with pytest.raises(DeviceError, match=r"mitsuba: .*finds no LLVM .*apt-get install libllvm"):
        prb.traced_appearance(run, seed=0, truth=None)


def test_the_method_through_the_real_evaluation(mi, tmp_path):
    capture = sphere_run.make_truth(tmp_path / "capture")
    paths = sphere_run.make_run(tmp_path / "run")
    config = replace(SMALL, texture_size=64, light_rows=32)
    prb.fit_and_write(paths, 0, capture, config)
    made = read_json(paths.manifest("appearance"))
    assert made["held_out"]["views"] == 3
    assert made["held_out"]["psnr"] > 18
    assert made["peak_memory_bytes"] > 0
    write_json(paths.manifest("export"), {"stage": "export"})
    assert cli.main(["evaluate", str(paths.root), "--truth", str(capture)]) == 0
    found = read_json(paths.scores)
    albedo = found["albedo"]["psnr_linear"]["per_channel_lsq"]
    assert albedo > 15.0  # few steps and coarse texels; a long fit is no test
    assert found["light"]["strongest_lobe_degrees"] < 5.0
