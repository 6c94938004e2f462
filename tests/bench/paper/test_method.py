# SPDX-License-Identifier: Apache-2.0
"""The whole method, much shortened, through the project's own evaluation."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from evaluation import sphere_run

from robir import cli
from robir.config import resolve
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths.spherical_gaussian import SphericalGaussians
from robir.maths.vectors import fibonacci_sphere
from robir.presets import PRESETS
from robir_bench.paper.appearance import Fitter, Sky
from robir_bench.paper.config import (
    NeusConfig,
    NormalsConfig,
    PaperConfig,
    VisibilityConfig,
    shrunken,
)
from robir_bench.paper.method import reconstruct_published
from robir_bench.paper.networks import NormalNetwork
from robir_bench.paper.tone import SrgbTone
from robir_bench.paper.transport import Hits, TransportNetworks, fit_normals, incident


def tiny() -> PaperConfig:
    """Seconds of everything."""
    base = shrunken()
    return replace(
        base,
        neus=NeusConfig(
            iterations=60,
            rays=128,
            coarse_samples=16,
            fine_samples=16,
            rounds=2,
            depth=3,
            width=48,
            octaves=4,
            colour_depth=1,
            colour_width=32,
            learning_rate=5e-3,
            warm_up=5,
            image_side=64,
            cells=40,
        ),
        normals=NormalsConfig(iterations=20, smooth_after=5, points=256, width=32),
        visibility=VisibilityConfig(
            iterations=20, pixels=32, directions=32, width=32, indirect_width=32
        ),
        material=replace(base.material, iterations=60, pixels=64, width=64),
        refinement=replace(
            base.refinement, iterations=60, warm_up=10, pixels=64, depth=2, width=32
        ),
        pool=400,
        ratio_directions=64,
    )


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    return sphere_run.make_truth(tmp_path_factory.mktemp("paper") / "sphere")


def test_a_sphere_goes_through_all_stages_and_the_evaluation(tmp_path, truth):
    whole = sphere_run.make_run(tmp_path / "whole")
    paths = JobPaths(tmp_path / "paper")
    shutil.copytree(whole.stage("capture"), paths.stage("capture"))
    write_json(paths.run, {"seconds": {"capture": {"cpu": 1.0}}, "peak_memory_bytes": {}})
    changes = ["appearance.texture_size=64", "geometry.face_budget=800"]
    config = resolve(PRESETS["draft"](), None, changes)
    held_out = reconstruct_published(paths, config, "paper", tiny())
    assert held_out["views"] == 3
    assert held_out["psnr"] > 10.0
    about = read_json(paths.run)
    assert set(about["seconds"]) == {"capture", "geometry", "transport", "appearance"}
    assert cli.main(["evaluate", str(paths.root), "--truth", str(truth)]) == 0
    found = read_json(paths.scores)
    assert found["mask_iou"] > 0.8
    assert found["normals"]["mean_degrees"] < 30.0
    assert found["tone_curve"]["family"] == "robir_aces"
    curve = read_json(paths.stage("appearance") / "tone_curve.json")
    assert 0.0 < curve["parameters"]["tone_gamma"] < 1.0
    light = read_json(paths.stage("appearance") / "light.json")["lobes"]
    assert len(light) == 128
    # Without ACES, all before the indirect light is taken over.
    other = JobPaths(tmp_path / "other")
    for stage in ("capture", "geometry", "transport"):
        shutil.copytree(paths.stage(stage), other.stage(stage))
    write_json(other.run, {"seconds": {}, "peak_memory_bytes": {}})
    reconstruct_published(other, config, "invrender", tiny())
    assert set(read_json(other.run)["seconds"]) == {"appearance"}
    family = read_json(other.stage("appearance") / "tone_curve.json")["family"]
    assert family == "standard"


def test_normals_are_learnt_from_a_mesh():
    sphere: Mesh = sphere_run.sphere_mesh()
    config = replace(
        shrunken(), normals=NormalsConfig(iterations=200, smooth_after=20, points=256, width=128)
    )
    torch.manual_seed(0)
    network = NormalNetwork(128, 32)
    fit_normals(network, sphere, config, 0)
    points = fibonacci_sphere(300)
    with torch.no_grad():
        cosine = (network(sphere_run.SPHERE * points) * points).sum(dim=1)
    assert np.degrees(np.arccos(cosine.clamp(max=1.0).numpy())).mean() < 8.0


def test_lobes_of_points_light_their_own_directions():
    lobes = SphericalGaussians(
        torch.nn.functional.normalize(torch.randn(3, 24, 3), dim=-1),
        10.0 * torch.rand(3, 24),
        torch.rand(3, 24, 3),
    )
    directions = torch.nn.functional.normalize(torch.randn(3, 5, 3), dim=-1)
    found = incident(lobes, directions)
    cosine = (lobes.axis[1] * directions[1, 4]).sum(dim=1)
    shape = torch.exp(lobes.sharpness[1] * (cosine - 1.0))
    assert torch.allclose(found[1, 4], (shape[:, None] * lobes.amplitude[1]).sum(0), atol=1e-5)


class OpenSky(torch.nn.Module):
    """Sees everything."""

    def forward(self, points, directions):
        return torch.ones(len(points), len(directions))


def test_the_sky_ends_at_the_horizon():
    normals = fibonacci_sphere(50)
    hits = Hits(points=normals, normals=normals, to_camera=normals, display=normals)
    sky = Sky.spread(500)
    visible = sky.visibility(OpenSky(), hits)
    expected = (normals @ sky.directions.T > 1e-6).half()
    assert torch.equal(visible, expected)


def test_light_and_material_explain_a_lit_sphere():
    """Grey sphere, no occluders: the fit's image loss falls far below that of the start."""
    config = tiny()
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    networks = TransportNetworks.start(config)
    networks.visibility.forward = OpenSky()
    with torch.no_grad():
        networks.indirect._net[-1].weight.zero_()
        networks.indirect._net[-1].bias.zero_()
    normals = fibonacci_sphere(400)
    sun = torch.nn.functional.normalize(torch.tensor([1.0, 0.5, 1.0]), dim=0)
    radiance = 0.15 + 0.5 * (normals @ sun).clamp_min(0.0)
    display = SrgbTone().curve().display_from_linear(radiance[:, None].expand(-1, 3))
    pool = Hits(points=0.7 * normals, normals=normals, to_camera=normals, display=display)
    fitter = Fitter(networks, pool, config, generator)
    errors = []
    losses = fitter._losses

    def note(*inputs):
        loss = losses(*inputs)
        errors.append(loss.item())
        return loss

    fitter._losses = note
    fitter.fit(SrgbTone(), has_ratio=True)
    assert np.mean(errors[-10:]) < 0.35 * np.mean(errors[:5])
