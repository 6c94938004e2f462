# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a drawn capture of photographs: its fingerprint, its renders, its classes."""

import ast
import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from blender_scenes.format import read_view
from blender_scenes.photographs.recipe import PhotoRecipe
from blender_scenes.photographs.writing import write_photographs
from blender_scenes.request import code_version
from blender_scenes.wheel import wheel_version

SUN_SHARE = 0.25
METAL_SHARE = 0.02
"""As in `population.facts`."""

VARIED = 0.02
"""Spread of the true albedo within a photograph beyond which the thing counts as patterned."""


def fingerprint(recipe: PhotoRecipe) -> str:
    """Hash of everything that decides the capture: recipe, file contents, code, renderer."""
    files = [recipe.light.file, recipe.second_light.file]
    if recipe.thing.file is not None:
        kinds = {".png", ".jpg", ".jpeg", ".bin", ".mtl"}
        beside = sorted(recipe.thing.file.parent.iterdir())
        files += [recipe.thing.file, *(f for f in beside if f.suffix.lower() in kinds)]
    facts = {
        "recipe": as_json(recipe),
        "files": [hashlib.sha256(file.read_bytes()).hexdigest() for file in files],
        "bpy": wheel_version(),
        "shared": code_version(Path(__file__).parents[1], "drawn"),
        "code": _code(Path(__file__).parent),
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:24]


def as_json(recipe: PhotoRecipe) -> dict[str, Any]:
    """The recipe as JSON values, files by their names."""
    return json.loads(json.dumps(asdict(recipe), default=lambda path: path.name))


def _code(folder: Path) -> str:
    """Hash of what makes a capture in a folder's program; comments, layout and docstrings aside."""
    digest = hashlib.sha256()
    for source in sorted(p for p in folder.glob("*.py") if p != Path(__file__)):
        tree = ast.parse(source.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                body[:] = [s for s in body if not _is_text(s)]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def _is_text(statement: ast.AST) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def make(out: Path, renders: Path, recipe: PhotoRecipe, report: Callable[[int, int], None]) -> None:
    """Renders and writes a capture.

    Args:
        out: folder to make.
        renders: where linear renders grow; they are removed once the capture is whole.
        recipe: what is asked for.
        report: called with the number of photographs done and of all, after each.
    """
    key = fingerprint(recipe)
    folder = renders / f"photographs_{key}"
    if not (folder / "scene.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        from blender_scenes.photographs.render import render_missing  # needs Blender

        render_missing(recipe, folder, key, report)
    more = {"classes": classes(recipe, folder), "recipe": as_json(recipe)}
    write_photographs(out, folder, recipe, more)
    shutil.rmtree(folder)


def classes(recipe: PhotoRecipe, rendered: Path) -> dict[str, str]:
    """Name of a class by its kind, as the other half has them, and those of photographs."""
    scene = json.loads((rendered / "scene.json").read_text(encoding="utf-8"))
    views = [read_view(file) for file in sorted((rendered / "test").glob("r_*.exr"))]
    metallic = np.concatenate([view.metallic[view.hit > 0.5] for view in views])
    albedo = np.concatenate([view.albedo[(view.hit > 0.5) & (view.mask > 0.99)] for view in views])
    handover, developing = recipe.handover, recipe.developing
    is_metal = (metallic > 0.5).mean() > METAL_SHARE
    has_sun = scene["sun_share"] >= SUN_SHARE and scene["sun_direction"][2] > 0.08
    return {
        "ground": "ground",
        "paint": "patterned" if albedo.std(axis=0).max() > VARIED else "plain",
        "metal": "metal" if is_metal else "no metal",
        "tone": "camera response",
        "sun": "sun" if has_sun else "no sun",
        "backdrop": "photograph",
        "thing": recipe.thing.kind,
        "cameras": "handheld",
        "table": "plain" if recipe.table.finish.pattern == "plain" else "patterned",
        "lighting": recipe.light.kind,
        "poses": handover.poses,
        "masks": handover.masks,
        "layout": handover.layout,
        "exposures": "jittered" if developing.exposure_jitter > 0.0 else "even",
        "vignetting": "vignetting" if developing.vignetting > 0.0 else "none",
    }
