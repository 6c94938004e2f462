# SPDX-License-Identifier: Apache-2.0
"""The export stage: the reconstruction's arrays in, the result folder's products out."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

from robir.capture.capture import Capture
from robir.capture.store import load_settled
from robir.errors import CancelledError, RobirError, StorageError
from robir.evaluation.layers import load_textures, result_mesh, stored_exposure, stored_facts
from robir.export.blender import Outcome, run_headless
from robir.export.config import ExportConfig
from robir.export.exchange import export_cameras, export_light, export_tone_curve
from robir.export.gltf import write_glb
from robir.export.report.numbers import Products, Rendering
from robir.export.report.write import write_report
from robir.export.textures import parts_of, tile_textures, write_tiles
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths
from robir.transport.observe import spread_views

REVISION = 16

RELIGHT_ENVIRONMENT = "city"  # a map of Blender's with a hard sun, which lit no capture of ours
RELIT_VIEWS = 2  # most views that are rendered under it
_RERENDER = "rerender_"
_RELIT = f"relit_{RELIGHT_ENVIRONMENT}_"
_LIGHTS = "light_"
_ASSET_SHARE = 0.2
_RENDER_SHARE = 0.95
_CHOICES = [{
    "choice": str, "chosen": (str, float), "alternatives": [(str, float)], "why": str,
    "held_out_error": (None, float), "cost_seconds": (None, float),
}]  # fmt: skip
_LAST_WORD = {"worst_loss": float, "unexplained": float}
_EVIDENCE = [{"of": str, "by": str, "value": float, "deviation": float}]


def run(context: StageContext[ExportConfig]) -> dict[str, Any]:
    """Write export/, renders/ and report/; counts and scores for the manifest."""
    cpu, wall = time.process_time(), time.monotonic()
    paths, report = context.paths, context.reporter
    report.progress(0.0, "reading the reconstruction")
    capture = load_settled(paths)
    exposure = stored_exposure(paths.stage("appearance") / "exposure.json")
    judged = capture.without(exposure["other_light"])
    mesh = result_mesh(paths, capture.bounds)
    arrays = load_textures(paths, "metallic", "coverage", "uncertainty")
    report.progress(0.05, "writing textures and the asset")
    textures = tile_textures(arrays, mesh.tiles, len(judged.train), paths.normal_map)
    write_tiles(textures, mesh.tiles, paths.textures)
    parts = tuple(parts_of(mesh, textures))
    write_glb(paths.asset, parts, asset_name(capture))
    report.progress(0.12, "writing light, tone curve and cameras")
    light = export_light(paths, capture.bounds.radius)
    tone_curve = export_tone_curve(paths)
    export_cameras(paths, capture, mesh.vertices)
    own = {"cpu": time.process_time() - cpu, "wall": time.monotonic() - wall}
    rendering = _render(context, judged, tone_curve)
    cpu, wall = time.process_time(), time.monotonic()
    report.progress(_RENDER_SHARE, "writing the report")
    of_stages = (_facts(paths, s, "choices", _CHOICES, []) for s in ("geometry", "appearance"))
    choices = [row for rows in of_stages for row in rows]
    numbers = write_report(
        paths,
        Products(
            capture=judged,
            mesh=mesh,
            parts=parts,
            arrays=arrays,
            light=light,
            tone_curve=tone_curve,
            choices=choices,
            evidence=_facts(paths, "appearance", "evidence", _EVIDENCE, []),
            last_word=_facts(paths, "appearance", "last_word", _LAST_WORD, None),
            exposure=exposure,
            rendering=rendering,
            seconds=lambda: {
                "cpu": own["cpu"] + time.process_time() - cpu,
                "wall": own["wall"] + time.monotonic() - wall,
            },
        ),
    )
    for doubt in numbers["trust"]["doubts"]:
        report.warn(f"the result is not to be trusted: {doubt}")
    report.progress(1.0, "exported")
    return _manifest_metrics(mesh, rendering, numbers)


def _facts(paths: JobPaths, stage: str, name: str, form: Any, default: Any) -> Any:
    """Contents of a stage's file that not every method writes, or a default."""
    file = paths.stage(stage) / f"{name}.json"
    return stored_facts(file, form) if file.is_file() else default


def asset_name(capture: Capture) -> str:
    """Name of the object: the capture's folder, reduced to letters, digits, dot, dash and _."""
    return re.sub(r"[^\w.-]+", "_", capture.source.name, flags=re.ASCII).strip("_") or "asset"


def _render(
    context: StageContext[ExportConfig], capture: Capture, tone_curve: dict[str, Any]
) -> Rendering:
    """Everything that Blender makes; whatever it cannot make is said, never fatal."""
    config, paths = context.config, context.paths
    _remove_old_renders(paths)
    if not config.renders:
        return Rendering(missing=("Blender was not asked for (export.renders = false)",))

    def names(count: int) -> str:
        shown = spread_views(capture.held_out or capture.train, min(count, config.render_views))
        return ",".join(view.name for view in shown)

    quality = ["--samples", str(config.render_samples), "--max-side", str(config.render_max_side)]
    out = str(paths.root)
    environment = ["--environment", RELIGHT_ENVIRONMENT, "--views", names(RELIT_VIEWS)]
    commands = (
        ("scene", ["scene", out]),
        ("rerender", ["render", out, "--views", names(config.render_views), *quality]),
        ("relight", ["relight", out, *environment, *quality]),
    )
    done: dict[str, Outcome] = {}
    missing: list[str] = []
    for index, (name, arguments) in enumerate(commands):

        def follow(fraction: float, message: str, index: int = index) -> None:
            share = (index + fraction) / len(commands)
            context.reporter.progress(
                _ASSET_SHARE + (_RENDER_SHARE - _ASSET_SHARE) * share, message
            )

        try:
            done[name] = run_headless(arguments, follow)
        except (CancelledError, StorageError):
            raise  # what is missing for want of room is made when the run goes on
        except RobirError as error:
            context.reporter.warn(f"no {name} in Cycles: {error}")
            missing.append(f"{name} in Cycles: {error}")
            break
    if not tone_curve["blender_view_transform"]:
        missing.append(
            "a view transform in scene.blend: Blender has none like the recovered curve, its "
            "viewport shows Standard; our renders went through tone_curve.cube"
        )

    def files(name: str, prefix: str) -> dict[str, Path]:
        """Pictures by view: its name follows a prefix in the file's name."""
        made = done[name].files if name in done else ()
        return {file.stem.removeprefix(prefix): file for file in made}

    wall, cpu = sum(one.wall for one in done.values()), sum(one.cpu for one in done.values())
    return Rendering(
        rerenders=files("rerender", _RERENDER),
        relit=files("relight", _RELIT),
        relit_with=RELIGHT_ENVIRONMENT,
        missing=tuple(missing),
        seconds={"wall": wall, "cpu": cpu},
    )


def _remove_old_renders(paths: JobPaths) -> None:
    """Forget what Blender made of an earlier asset; views the user had rendered stay."""
    paths.scene.unlink(missing_ok=True)
    old = (f"{_RERENDER}*.png", f"{_RELIT}*.png", f"{_LIGHTS}*.png", paths.comparison("*").name)
    for pattern in old:
        for file in paths.renders.glob(pattern):
            file.unlink()


def _manifest_metrics(mesh: Mesh, rendering: Rendering, numbers: dict[str, Any]) -> dict[str, Any]:
    metrics: dict[str, Any] = {
        "faces": len(mesh.faces),
        "is_trusted": numbers["trust"]["is_trusted"],
        "rendering_cpu_seconds": round(rendering.seconds["cpu"], 2),
        "rendering_wall_seconds": round(rendering.seconds["wall"], 2),
    }
    for name in ("held_out", "cycles"):
        if numbers[name]["psnr"] is not None:
            metrics[f"{name}_psnr"] = round(numbers[name]["psnr"], 3)
    return metrics
