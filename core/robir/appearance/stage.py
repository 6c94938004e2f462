# SPDX-License-Identifier: Apache-2.0
"""The appearance stage: baked transport and photographs in, textures and light out."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from robir.appearance.config import AppearanceConfig
from robir.appearance.held_out_suns import with_tested_suns
from robir.appearance.light.known_albedo import KnownAlbedo
from robir.appearance.light.lobes import lobes_of
from robir.appearance.light.problem import Problem, Scene, make_scene
from robir.appearance.light.solver import Light, fit, no_suns
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.photograph_check import CheckResult
from robir.appearance.photometry.comparison import COMPARISON, PhotoComparison
from robir.appearance.reasons import camera_choices, light_choices
from robir.appearance.render import AtlasLookup, TexturedSurface, render_views
from robir.appearance.smooth_normals import SURFACE, LitSurface
from robir.appearance.solution import SOLUTION, Solution, solve
from robir.appearance.texture.albedo import ALBEDO
from robir.appearance.texture.texels import TexelAlbedo
from robir.appearance.texturing import TEXTURE, Texture
from robir.appearance.tone.choose import SEARCH, ToneChoice, choose_tone_curve
from robir.appearance.tone.ranking import PLAIN, albedo_apart, fits_alike
from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.capture import Capture
from robir.capture.images.loading import resize_view, save_preview
from robir.capture.refusal import describe, warning
from robir.capture.store import load_settled
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh, mesh_for_light
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.steps import Pipeline, Step, check_left_out
from robir.transport.baked import Transport
from robir.transport.observe import MASK_INSIDE
from robir.workers import meanwhile

REVISION = 103


# all steps of the stage, in their order
STEPS: tuple[Step[Any], ...] = (*COMPARISON, *SURFACE, *SEARCH, *SOLUTION, *ALBEDO, *TEXTURE)

_HELD_OUT_SIDE = 400  # longer side of the held-out views at most (pixels)


def run(context: StageContext[AppearanceConfig]) -> dict[str, Any]:
    """Choose the tone curve, solve light and materials, bake the textures; figures of it."""
    config, reporter, folder = context.config, context.reporter, context.paths.stage("appearance")
    check_left_out(STEPS, config.without, "appearance.without")
    pipeline = Pipeline(config.without)
    capture = load_settled(context.paths).normalised()
    config, (mesh, tracer, own_tracer) = with_known_curve(config, capture), _surface(context)
    transport = Transport.load(context.paths.stage("transport"))
    started = time.process_time()
    compared = PhotoComparison.of(transport, tracer, capture, context.seed)
    compared = pipeline.run(COMPARISON, compared)
    seconds = {"exposure": time.process_time() - started}
    if other := compared.other_light:
        reporter.warn(_other_light_warning(other, capture))
    common = transport.without_views(other)
    lit = LitSurface(mesh=mesh, transport=common)
    lit = pipeline.run(SURFACE, lit)
    scene = _scene(context, lit, tracer, compared)
    started = time.process_time()
    reporter.progress(0.05, "finding the sun and the tone curve")
    tone = choose_tone_curve(scene, config, context.seed, pipeline)
    seconds |= {"tone_curve": time.process_time() - started}
    reporter.progress(0.5, f"solving the light under {tone.candidates[0].curve.name}")
    solution = _solved(tone, config, context.seed, pipeline)
    problem, light, specular = solution.matte, solution.light, solution.material
    seconds["light"] = time.process_time() - started - seconds["tone_curve"]
    reporter.progress(0.7, "reading the textures from the photographs")
    solved, shape, seen = (problem, light, specular), (lit.mesh, tracer), capture.without(other)
    texture = pipeline.run(TEXTURE, Texture.of(solved, shape, seen, config, pipeline))
    light, specular, inside = texture.light, texture.specular, texture.inside
    values = texture.values
    reporter.progress(0.9, "rendering held-out views")
    surface = TexturedSurface(lit.mesh, own_tracer, AtlasLookup(mesh, inside), values)
    psnr = _held_out(folder, problem, light, specular, capture, other, surface)
    _show(context.paths, capture)
    _write_textures(folder, inside, values, specular)
    _write_normals(folder, lit.mesh.normals)
    _write_light(folder, light, problem.scene.light_distance)
    _write_tone_curve(folder, tone)
    _write_check(folder, texture.checked)
    write_json(folder / "exposure.json", problem.gains.plain() | {"other_light": sorted(other)})
    choices = (
        *light_choices(tone, light, seconds),
        *specular.choices,
        *solution.choices,
        *(() if texture.checked is None else (texture.checked.choice,)),
        *camera_choices(problem.gains, other, seconds),
    )
    write_json(folder / "choices.json", [choice.plain() for choice in choices])
    write_json(folder / "evidence.json", [estimate.plain() for estimate in solution.estimates])
    write_json(context.paths.steps("appearance"), pipeline.plain(STEPS))
    return {
        "tone_curve": tone.candidates[0].curve.name,
        "sharp_lobes": len(light.axes),
        "neighbour_loss": round(light.loss, 4),
        "held_out_psnr": psnr,
    }


def _solved(tone: ToneChoice, config: AppearanceConfig, seed: int, pipeline: Pipeline) -> Solution:
    """Light and material under the curve that was chosen."""
    first = tone.candidates[0]
    if not len(first.light.axes) or tone.scene.sun is not None:  # no sun, or a sun that is told
        return solve(first.problem, first.light, config, seed, pipeline)
    with meanwhile(lambda: fit(first.problem, *no_suns(), config.iterations)) as sky:
        found = solve(first.problem, first.light, config, seed, pipeline)
    return with_tested_suns(tone, found, sky(), pipeline)


def with_known_curve(config: AppearanceConfig, capture: Capture) -> AppearanceConfig:
    """The settings, with the one curve that linear photographs can have gone through."""
    is_open = capture.is_linear and len(config.families) > 1
    return replace(config, families=(PLAIN,)) if is_open else config


def _scene(
    context: StageContext[AppearanceConfig],
    lit: LitSurface,
    tracer: EmbreeTracer,
    compared: PhotoComparison,
) -> Scene:
    """The scene whose light is sought, with what the user tells of it."""
    config, visibility = context.config, lit.transport.visibility
    scene = make_scene(
        lit.transport,
        tracer if visibility.is_traced else None,
        visibility.offset,
        (config.num_solve_surfels, config.num_soft_lobes),
        np.random.default_rng(context.seed),
    )
    return replace(
        scene,
        exposures=compared.exposures,
        known_albedo=KnownAlbedo.of(lit.mesh, config.white_point),
        sun=_direction(config.sun),
    )


def _direction(vector: tuple[float, ...]) -> np.ndarray | None:
    """Unit vector (3,) of a setting; None of an empty one."""
    if not vector:
        return None
    return (np.asarray(vector) / np.linalg.norm(vector)).astype(np.float32)


def _surface(
    context: StageContext[AppearanceConfig],
) -> tuple[Mesh, EmbreeTracer, EmbreeTracer]:
    """The textured mesh, the tracer of the mesh for light, and its own tracer."""
    folder = context.paths.stage("geometry")
    mesh, solid = Mesh.load(folder / "mesh.npz"), mesh_for_light(folder)
    tracer = EmbreeTracer(solid.vertices, solid.faces)
    if np.array_equal(mesh.faces, solid.faces):
        return mesh, tracer, tracer
    return mesh, tracer, EmbreeTracer(mesh.vertices, mesh.faces)


def _other_light_warning(other: frozenset[str], capture: Capture) -> str:
    """The warning about photographs under another light."""
    names = [view.name for view in capture.views if view.name in other]
    return describe(
        warning(
            "other-light",
            f"{len(names)} of {len(capture.views)} photographs show the object in another light "
            "than the rest; the surface is fitted to them, albedo and light are not",
            "Let nothing stand between lamps and object, and change no light, while photographing.",
            *names,
        )
    )


def _held_out(
    folder: Path,
    problem: Problem,
    light: Light,
    specular: SpecularMaterial,
    capture: Capture,
    other_light: frozenset[str],
    surface: TexturedSurface,
) -> float | None:
    """Render and store the held-out views; PSNR of those in the common light."""
    images, diffuse, squared, count = {}, {}, 0.0, 0
    views = [resize_view(view, _HELD_OUT_SIDE) for view in capture.held_out]
    pictures = render_views(problem, light, specular, views, surface)
    for view, shown in zip(views, pictures, strict=True):
        image, alpha = shown.image, shown.alpha
        images[view.name] = np.dstack([image, alpha])
        diffuse[view.name] = np.dstack([shown.diffuse, alpha])
        if view.name in other_light:
            continue
        chosen = (alpha > 0) & (view.mask > MASK_INSIDE)
        difference = (image[chosen].astype(float) - view.image_display[chosen]) / 255
        squared += float((difference**2).sum())
        count += difference.size
    for name, views in (("held_out.npz", images), ("held_out_diffuse.npz", diffuse)):
        with replacing(folder / name) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **views)
    return round(-10 * np.log10(max(squared / count, 1e-10)), 3) if count else None


def _show(paths: JobPaths, capture: Capture) -> None:
    """Replace the picture by which the user follows the run."""
    if capture.held_out:
        view = resize_view(capture.held_out[0], _HELD_OUT_SIDE)
        rendering = stored_arrays(paths.stage("appearance") / "held_out.npz", PICTURES)[view.name]
        save_preview(paths.preview, np.dstack([view.image_display, view.mask]), rendering)


def _write_textures(
    folder: Path, inside: np.ndarray, values: TexelAlbedo, specular: SpecularMaterial
) -> None:
    """Store the texel values as square arrays."""

    def square(column: np.ndarray) -> np.ndarray:
        full = np.zeros((*inside.shape, *column.shape[1:]), np.float32)
        full[inside] = column
        return full

    with replacing(folder / "textures.npz") as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            albedo_linear=square(values.albedo),
            roughness=square(values.roughness),
            metallic=square(values.metallic),
            coverage=square(values.coverage),
            uncertainty=square(values.uncertainty),
            inside=inside,
            specular=np.float32(specular.has_highlights),
        )


def _write_normals(folder: Path, normals: np.ndarray) -> None:
    """Store the normals (V, 3) that the mesh is to be rendered with."""
    with replacing(folder / "normals.npz") as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, normals=normals)


def _write_light(folder: Path, light: Light, distance: float) -> None:
    """Store the lobes, and how far away they are, if not infinitely: unit frame."""
    lobes = lobes_of(light.amplitudes, light.axes, light.sharpness)
    num_soft = len(lobes.axis) - len(light.axes)
    listed = [
        {
            "axis": [float(value) for value in lobes.axis[index]],
            "sharpness": float(lobes.sharpness[index]),
            "amplitude": [float(value) for value in lobes.amplitude[index]],
            "kind": "soft" if index < num_soft else "sharp",
        }
        for index in range(len(lobes.axis))
    ]
    told = {"lobes": listed, "unit": "radiance such that the tone curve maps it to display"}
    if np.isfinite(distance):
        told["distance_radii"] = distance
    write_json(folder / "light.json", told)


def _write_check(folder: Path, checked: CheckResult | None) -> None:
    """Store what photographs took back, if they were heard; what a run before left goes."""
    file = folder / "last_word.json"
    if checked is None:
        file.unlink(missing_ok=True)
    else:
        write_json(file, checked.plain)


def _write_tone_curve(folder: Path, tone: ToneChoice) -> None:
    """Store the chosen curve and what it was chosen against."""
    first, *others = tone.candidates
    chosen = first.curve
    apart = {
        other.curve.name: albedo_apart(first, other) for other in others if fits_alike(first, other)
    }
    write_json(
        folder / "tone_curve.json",
        {
            "family": chosen.name,
            "parameters": chosen.parameters,
            "candidates": [
                {
                    "family": candidate.curve.name,
                    "score": candidate.score,
                    "standard_error": candidate.standard_error
                    if np.isfinite(candidate.standard_error)
                    else None,
                    "albedo_apart": apart.get(candidate.curve.name),
                }
                for candidate in tone.candidates
            ],
            "clipped_share": tone.evidence.clipped_share,
            "blender_view_transform": chosen.blender_view_transform,
            "blender_gamma": chosen.blender_gamma,
            "exposure": 0.0,
        },
    )
