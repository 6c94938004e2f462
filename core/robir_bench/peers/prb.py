# SPDX-License-Identifier: Apache-2.0
"""The method `mitsuba`: what differentiable path tracing gives on our surface and cameras.

Mitsuba 3 renders the surface of the whole method with a principled material under an environment
map; Adam fits base colour, roughness and map to the photographs. As a user would do it, the
photographs count as sRGB and nothing is known of the light. A second method is told the true tone
curve, and starts from the true sun. The result has the form of an appearance stage.

A process of its own (`python -m robir_bench.peers.prb`), which ends where its compiler fails.

References:
    [Vicini2021] Path replay backpropagation.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.capture.capture import Capture
from robir.capture.store import load_settled
from robir.errors import DeviceError, RobirError
from robir.evaluation.photos import mean_scores, photo_scores
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.jobs.paths import JobPaths, read_json, replacing, write_json
from robir.maths import spherical_gaussian as sg
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.pipeline.device import peak_memory_bytes
from robir_bench.peers import prb_scene
from robir_bench.peers.prb_fit import WITH_SUN, Observed, PrbConfig, PrbFit
from robir_bench.stability.perturb import curve_of
from robir_bench.truth.files import load_truth

Floats = NDArray[np.floating[Any]]

# irradiance of the sky over that of a given sun, before anything is known of the sky
_SKY_TO_SUN = 0.25

_LOBE_ROWS = 16
_HELD_OUT_SAMPLES = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What the fit need not find out."""

    curve: AbstractToneCurve  # tone curve of the photographs
    sun: Floats | None  # radiance (rows, 2 rows, 3) of the sun that the light starts from, or None


def traced_appearance(paths: JobPaths, seed: int, truth: Path | None) -> dict[str, Any]:
    """Write an appearance stage by Mitsuba, in a process of its own.

    Args:
        paths: Result folder with the capture and geometry stages done.
        seed: Of the choice of pixels and light paths.
        truth: Rendered capture whose tone curve and sun the fit is told, or None.

    Returns:
        Its manifest: "held_out" as `mean_scores` gives them, and "peak_memory_bytes".

    Raises:
        DeviceError: If Mitsuba or LLVM is missing, or the process failed; the message is its last.
    """
    words = [str(paths.root), str(seed), *([] if truth is None else [str(truth)])]
    command = [sys.executable, "-m", "robir_bench.peers.prb", *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        last = (ended.stderr.strip().splitlines() or ["ended without a message"])[-1]
        raise DeviceError(f"mitsuba: {last}")
    return read_json(paths.manifest("appearance"))


def main(words: list[str]) -> int:
    """Entry of the process: result folder, seed and, where it is told, the capture with truth."""
    paths, seed = JobPaths(Path(words[0])), int(words[1])
    torch.set_num_threads(1)
    try:
        if words[2:]:
            fit_and_write(paths, seed, Path(words[2]), WITH_SUN)
        else:
            fit_and_write(paths, seed, None, PrbConfig())
    except RobirError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def fit_and_write(paths: JobPaths, seed: int, truth: Path | None, config: PrbConfig) -> None:
    """Fit, and write the stage; its manifest last.

    Args:
        paths: Result folder with the capture and geometry stages done.
        seed: Of the choice of pixels and light paths.
        truth: Rendered capture whose tone curve and sun the fit is told, or None.
        config: How the fit is done.

    Raises:
        DeviceError: If Mitsuba or LLVM is missing.
    """
    capture = load_settled(paths).normalised()
    mesh = Mesh.load(paths.stage("geometry") / "mesh.npz")
    inside = rasterise_atlas(mesh, config.texture_size)[0] >= 0
    told = _told(truth, config.light_rows)
    fit = PrbFit(mesh, [view.camera for view in (*capture.train, *capture.held_out)], config)
    observed = observed_pixels(capture, fit)
    start_level(fit, observed, told)
    for _step in fit.run(observed, told.curve, torch.from_numpy(inside), seed):
        pass
    again, held_out = _shown_again(capture, fit, told.curve)
    folder = paths.stage("appearance")
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in (("textures", _textures(fit, inside)), ("held_out", again)):
        with replacing(folder / f"{name}.npz") as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **table)
    write_json(folder / "light.json", {"lobes": lobe_table(fit.radiance())})
    family = {"family": told.curve.name, "parameters": told.curve.parameters}
    write_json(folder / "tone_curve.json", family)
    about = {"held_out": held_out, "peak_memory_bytes": peak_memory_bytes()}
    write_json(paths.manifest("appearance"), {"stage": "appearance", **about})


def _told(truth: Path | None, rows: int) -> Known:
    if truth is None:
        return Known(curve=curve_from_name("standard"), sun=None)
    known = load_truth(truth)
    irradiance = np.array(known.scene["sun_irradiance_rgb"])
    sun = prb_scene.sun_texels(known.sun_direction, irradiance, rows)
    return Known(curve=curve_of(known.scene), sun=sun)


def observed_pixels(capture: Capture, fit: PrbFit) -> Observed:
    """The photographs' pixels that lie wholly inside the mask and show the surface."""
    views = capture.train
    pixels = prb_scene.all_pixels([view.camera for view in views])
    whole = np.concatenate([view.mask.ravel() == 255 for view in views])
    codes = np.concatenate([view.image_display.reshape(-1, 3) for view in views])[whole]
    pixels = pixels.chosen(whole)
    hit = fit.hits(pixels)
    display = torch.from_numpy(codes[hit].astype(np.float32) / 255.0)
    return Observed(pixels=pixels.chosen(hit), display=display)


@torch.no_grad()
def start_level(fit: PrbFit, observed: Observed, told: Known) -> None:
    """Make the first render as bright as the photographs: by the light, or by the albedo.

    A given sun fixes the level of the light; then the albedo takes what remains.
    """
    target = told.curve.linear_from_display(observed.display).mean(dim=0)
    some = np.random.default_rng(0).integers(0, len(observed.pixels), fit.config.batch)
    light = fit.material.log_radiance
    if told.sun is not None:
        sun = torch.from_numpy(told.sun).float()
        solid_angle = torch.from_numpy(prb_scene.light_solid_angles(len(sun)))
        sky = _SKY_TO_SUN * float((sun.mean(dim=2) * solid_angle[:, None]).sum()) / np.pi
        light.copy_(torch.log(sky + sun))
    shown = fit.render(observed.pixels.chosen(some), seed=0, samples=16).mean(dim=0)
    if told.sun is None:
        light += torch.log(target / shown)
    else:
        fit.material.base *= target / shown


def _textures(fit: PrbFit, inside: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Arrays of textures.npz; every texel of the surface counts as covered."""
    zero = np.where(inside[..., None], np.float32(1.0), np.float32(0.0))
    return {
        "albedo_linear": fit.material.base.detach().numpy() * zero,
        "roughness": (fit.material.roughness.detach().numpy() * zero)[..., 0],
        "coverage": zero[..., 0],
        "inside": inside,
    }


def _shown_again(
    capture: Capture, fit: PrbFit, curve: AbstractToneCurve
) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
    """Held-out views as displayed, RGBA codes by name, and their scores."""
    again, scores = {}, []
    for index, view in enumerate(capture.held_out, len(capture.train)):
        pixels = prb_scene.all_pixels([view.camera]).of_view(index)
        hit = fit.hits(pixels)
        linear = fit.render(pixels.chosen(hit), seed=index, samples=_HELD_OUT_SAMPLES)
        codes = np.zeros((len(pixels), 4), np.uint8)
        codes[hit, :3] = np.rint(255 * curve.display_from_linear(linear).clamp(0, 1).numpy())
        codes[hit, 3] = 255
        again[view.name] = codes.reshape(view.camera.height, view.camera.width, 4)
        scores.append(photo_scores(again[view.name], view))
    return again, mean_scores(scores)


def lobe_table(radiance: Floats) -> list[dict[str, Any]]:
    """A light as lobes for light.json: its brightest spot as the sun, the rest as soft lobes.

    Energies are kept; what is finer than the 16 rows of soft lobes is not.

    Args:
        radiance: (rows, 2 rows, 3), rows a multiple of 16, see `prb_scene.light_directions`.
    """
    rows = len(radiance)
    power = radiance * prb_scene.light_solid_angles(rows)[:, None, None]
    direction = prb_scene.light_directions(rows)
    row, column = np.unravel_index(radiance.mean(axis=2).argmax(), radiance.shape[:2])
    near = direction @ direction[row, column] > np.cos(2.0 * np.pi / rows)
    block = (_LOBE_ROWS, rows // _LOBE_ROWS, 2 * _LOBE_ROWS, rows // _LOBE_ROWS, 3)
    soft = np.where(near[..., None], 0.0, power).reshape(block).sum(axis=(1, 3)).reshape(-1, 3)
    axes = direction.reshape(block).mean(axis=(1, 3)).reshape(-1, 3)
    centre = (power[near].mean(axis=1, keepdims=True) * direction[near]).sum(axis=0)
    lobes = [(axis, _LOBE_ROWS, energy, "soft") for axis, energy in zip(axes, soft, strict=True)]
    lobes.append((centre, rows, power[near].sum(axis=0), "sharp"))
    return [_lobe(*lobe) for lobe in lobes]


def _lobe(axis: Floats, rows: int, energy: Floats, kind: str) -> dict[str, Any]:
    """A lobe of an energy that is about as wide as a texel of so many rows."""
    sharpness = (2.0 * rows / np.pi) ** 2
    unit = sg.SphericalGaussians(
        axis=torch.from_numpy(axis / np.linalg.norm(axis)),
        sharpness=torch.tensor(sharpness, dtype=torch.float64),
        amplitude=torch.ones(3, dtype=torch.float64),
    )
    amplitude = energy / sg.integral(unit).numpy()
    listed = {"axis": unit.axis.tolist(), "sharpness": sharpness}
    return {**listed, "amplitude": amplitude.tolist(), "kind": kind}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
