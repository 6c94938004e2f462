# SPDX-License-Identifier: Apache-2.0
"""The published methods as the stages of a result folder.

`geometry` holds NeuS, `transport` Norm and Vis, `appearance` PBR and CESR. Mesh cleaning, atlas
and file formats are the whole project's own, so that all methods are judged by one program.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from robir.capture.capture import Capture
from robir.capture.images.loading import resize_view
from robir.geometry.config import GeometryConfig
from robir.geometry.lattice import Sampled
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.geometry.pipeline import post_processed
from robir.geometry.selection import Dense, smooth_surface
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.steps import Pipeline
from robir.transport.observe import observe
from robir.transport.surfels import interpolate
from robir_bench.paper.appearance import Fitter, Model, render_display
from robir_bench.paper.config import PaperConfig, Variant
from robir_bench.paper.neus import Neus, PhotoRays, fit_neus
from robir_bench.paper.tone import make_tone
from robir_bench.paper.tracer import FieldTracer, on_lattice
from robir_bench.paper.transport import (
    TransportNetworks,
    fit_normals,
    fit_visibility,
    random_hits,
    surface_hits,
)

SHARP = 10.0  # sharpness from which a lobe counts as a lamp, for the score of the sun's direction

HELD_OUT_SIDE = 80  # longest side of re-rendered held-out views, pixels

_NETWORKS = "networks.npz"
_CHUNK = 1 << 14
_RAY_OFFSET = 0.004


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperRun:
    """What every stage is given."""

    paths: JobPaths  # result folder
    capture: Capture  # in the unit frame
    config: PaperConfig  # the schedule
    variant: Variant  # the method
    seed: int  # of every random choice

    def begin(self) -> torch.Generator:
        """Seed torch, whose own generator starts the networks, and give another for all else."""
        torch.manual_seed(self.seed)
        return torch.Generator().manual_seed(self.seed)

    def pixels(self) -> PhotoRays:
        """Of the training photographs."""
        return PhotoRays(self.capture.train, self.config.neus.image_side)


def run_geometry(job: PaperRun, config: GeometryConfig) -> None:
    """Fit the field; write it and its mesh.

    Args:
        job: What to do.
        config: For the size of the mesh and the patience of the unwrapping.
    """
    generator = job.begin()
    field = fit_neus(job.pixels(), job.config.neus, generator)
    lattice, values = on_lattice(field.sdf, job.config.neus.cells)
    surface = smooth_surface(Sampled(lattice, values))
    dense = Dense(surface, (lattice.cell,), config.face_budget)
    mesh = post_processed(dense, config, lambda _: None, Pipeline())
    folder = _folder(job, "geometry")
    mesh.save(folder / "mesh.npz")
    _save_networks(folder / _NETWORKS, field.modules())


def run_transport(job: PaperRun) -> None:
    """Learn normals, visibility and indirect light from the field; write the networks."""
    generator = job.begin()
    networks = TransportNetworks.start(job.config)
    fit_normals(networks.normals, _mesh(job), job.config, job.seed)
    field, tracer = _field(job)
    tone = make_tone(job.variant.has_aces)
    fit_visibility(networks, (field, tracer, job.pixels()), tone, job.config, generator)
    _save_networks(_folder(job, "transport") / _NETWORKS, networks.modules())


def run_appearance(job: PaperRun, texture_size: int) -> None:
    """Learn light, tone curve and material; write textures, light, curve and held-out views.

    Args:
        job: What to do.
        texture_size: Side of the textures, texels.
    """
    generator = job.begin()
    networks = TransportNetworks.start(job.config)
    _load_networks(job.paths.stage("transport") / _NETWORKS, networks.modules())
    _, tracer = _field(job)
    pool = random_hits(job.pixels(), job.config.pool, tracer, networks.normals, generator)
    fitter = Fitter(networks, pool, job.config, generator)
    model = fitter.fit(make_tone(job.variant.has_aces), job.variant.has_rve)
    folder = _folder(job, "appearance")
    _save_arrays(folder / "textures.npz", _textures(job, model, tracer, texture_size))
    _save_arrays(folder / "held_out.npz", _held_out(job, model, networks, fitter, tracer))
    _write_light(folder / "light.json", model)
    curve = model.tone.curve()
    write_json(
        folder / "tone_curve.json",
        {
            "family": curve.name,
            "parameters": curve.parameters,
            "blender_view_transform": curve.blender_view_transform,
            "exposure": 0.0,
        },
    )


@torch.no_grad()
def _textures(
    job: PaperRun, model: Model, tracer: FieldTracer, size: int
) -> dict[str, NDArray[Any]]:
    """Material of every texel of the atlas."""
    mesh = _mesh(job)
    face, barycentric = rasterise_atlas(mesh, size)
    inside = face >= 0
    shares = barycentric[inside].astype(np.float32)
    position, _ = interpolate(mesh, face[inside], shares)
    surface = tracer.onto_surface(torch.from_numpy(position))
    parts = [model.material(part) for part in surface.split(_CHUNK)]
    values = {
        "albedo_linear": torch.cat([albedo for albedo, _ in parts]).numpy(),
        "roughness": torch.cat([roughness for _, roughness in parts]).numpy(),
        "coverage": (_views_of_vertices(job, mesh)[mesh.faces[face[inside]]] * shares).sum(1),
    }
    arrays: dict[str, NDArray[Any]] = {"inside": inside}
    for name, column in values.items():
        arrays[name] = np.zeros((*inside.shape, *column.shape[1:]), np.float32)
        arrays[name][inside] = column
    return arrays


def _views_of_vertices(job: PaperRun, mesh: Mesh) -> NDArray[np.int64]:
    """How many photographs show each vertex of the mesh, (Nv,)."""
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    seen = observe(tracer, mesh.vertices, mesh.normals, job.capture.train, _RAY_OFFSET)
    return (seen.weight > 0).sum(axis=1)


def _held_out(
    job: PaperRun, model: Model, networks: TransportNetworks, fitter: Fitter, tracer: FieldTracer
) -> dict[str, NDArray[np.uint8]]:
    """Held-out views at a small size, RGBA codes by name."""
    images: dict[str, NDArray[np.uint8]] = {}
    for view in job.capture.held_out:
        small = resize_view(view, HELD_OUT_SIDE)
        origins, directions = (
            torch.from_numpy(array.astype(np.float32))
            for array in small.camera.rays(small.camera.pixel_centres())
        )
        shown = torch.from_numpy(small.mask.reshape(-1) > 127)
        codes = torch.from_numpy(small.image_display.reshape(-1, 3)[shown.numpy()] / 255.0)
        rays = (origins[shown], directions[shown])
        hits, met = surface_hits(rays, codes, tracer, networks.normals)
        image = np.zeros((small.mask.size, 4), np.uint8)
        drawn = torch.nonzero(shown)[met, 0].numpy()
        codes = render_display(model, networks, fitter.sky, hits)
        image[drawn, :3] = np.rint(255.0 * codes.numpy())
        image[drawn, 3] = 255
        images[view.name] = image.reshape(*small.mask.shape, 4)
    return images


def _write_light(path: Path, model: Model) -> None:
    lobes = model.light.lobes()
    columns = (lobes.axis.tolist(), lobes.sharpness.tolist(), lobes.amplitude.tolist())
    listed = [
        {
            "axis": axis,
            "sharpness": sharpness,
            "amplitude": amplitude,
            "kind": "sharp" if sharpness >= SHARP else "soft",
        }
        for axis, sharpness, amplitude in zip(*columns, strict=True)
    ]
    unit = "radiance such that the tone curve maps it to display"
    write_json(path, {"lobes": listed, "unit": unit})


def _folder(job: PaperRun, stage: str) -> Path:
    folder = job.paths.stage(stage)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _mesh(job: PaperRun) -> Mesh:
    return Mesh.load(job.paths.stage("geometry") / "mesh.npz")


def _field(job: PaperRun) -> tuple[Neus, FieldTracer]:
    """The fitted field, frozen, and its tracer."""
    field = Neus.start(job.config.neus)
    _load_networks(job.paths.stage("geometry") / _NETWORKS, field.modules())
    for module in field.modules().values():
        module.requires_grad_(False)
    return field, FieldTracer.of(*on_lattice(field.sdf, job.config.neus.cells))


def _save_networks(path: Path, modules: dict[str, nn.Module]) -> None:
    """Weights by network and name."""
    arrays = {
        f"{name}.{key}": value.numpy()
        for name, module in modules.items()
        for key, value in module.state_dict().items()
    }
    _save_arrays(path, arrays)


def _load_networks(path: Path, modules: dict[str, nn.Module]) -> None:
    with np.load(path, allow_pickle=False) as arrays:
        for name, module in modules.items():
            mark = f"{name}."
            names = [key for key in arrays.files if key.startswith(mark)]
            state = {key.removeprefix(mark): torch.from_numpy(arrays[key]) for key in names}
            module.load_state_dict(state)


def _save_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
