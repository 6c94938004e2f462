# SPDX-License-Identifier: Apache-2.0
"""Where it is lost: held-out photographs re-rendered by each level of the chain.

From the photographs warped over the visual hull to Blender's rendering of the asset, every level
is scored against the same held-out photographs over the same pixels, so that what one of them
loses against the one before is the doing of what lies between. No truth is needed.

The pixels are those that are wholly object by the photograph's mask and where the final mesh is
met at a point that some training photograph shows. PSNR over the whole mask is given as well;
there, what a level lacks is black.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.arrays import PICTURES, stored_arrays
from robir.capture.capture import Capture, View
from robir.capture.images.loading import resize_view
from robir.capture.store import load_settled
from robir.errors import RobirError
from robir.evaluation import metrics
from robir.evaluation.layers import TONE_CURVE, shaded_mesh, stored_exposure, stored_facts
from robir.evaluation.photos import Exposures, cut, over_grey, read_picture, save_sheet, window
from robir.evaluation.surfaces import warped_views
from robir.geometry.config import GeometryConfig
from robir.geometry.hull import carve, hull_of
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import reduce_view
from robir.jobs.paths import JobPaths
from robir.transport.baked import RAY_OFFSET
from robir.transport.observe import MASK_INSIDE, spread_views

Picture = NDArray[np.uint8]
Pictures = dict[str, Picture]  # RGBA codes by the view's name
SIDE = 400  # longer side, pixels, that all is scored at, whatever size photographs are stored in
STRIP_VIEWS = 3  # held-out photographs that are shown
NOTEWORTHY = 0.1  # loss below which no stage is named, dB


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """One level of the chain."""

    name: str  # key in levels.json
    letter: str  # in tables
    title: str  # what is shown
    stage: str  # what is at fault where it loses against the level before
    reason: str  # how it loses


# the chain, in order
LEVELS = (
    Level(
        name="hull", letter="a", title="nearest photographs on the visual hull", stage="", reason=""
    ),
    Level(
        name="field",
        letter="b",
        title="the geometry's field itself",
        stage="the fit of the surface",
        reason="its field repeats them worse than photographs on the hull do",
    ),
    Level(
        name="mesh",
        letter="c",
        title="nearest photographs on the mesh",
        stage="the mesh",
        reason="photographs from near directions meet worse on it",
    ),
    Level(
        name="mean",
        letter="c'",
        title="mean of all photographs on the mesh",
        stage="one value a point",
        reason="photographs of a point differ: they do not meet on the surface, or gloss and "
        "exposure change",
    ),
    Level(
        name="diffuse",
        letter="d",
        title="diffuse texture under the recovered light",
        stage="texture and light",
        reason="their product repeats the photographs worse than the plain mean",
    ),
    Level(
        name="material",
        letter="e",
        title="the whole material, our renderer",
        stage="the material",
        reason="highlights and metal take more than they give",
    ),
    Level(
        name="cycles",
        letter="f",
        title="Cycles",
        stage="the export",
        reason="Blender shows the asset otherwise than our own renderer",
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A held-out photograph and where levels are compared with it."""

    view: View  # at the size that is scored
    whole: NDArray[np.bool_]  # (H, W) pixels that are wholly object
    seen: NDArray[np.bool_]  # (H, W) those where some photograph shows the mesh


def level_scores(paths: JobPaths, strip: Path | None = None) -> dict[str, Any]:
    """Score every level that a finished result can show, as plain JSON values.

    "views", "seen_share" (of the mask's pixels those that are compared); "chain", by the names of
    `LEVELS`: "letter", "title", "views", "psnr", "ssim", "sharpness", "psnr_whole_mask", and "loss"
    in dB against the level "against"; None what is not measured. "verdict" is a sentence. Pictures
    of a few views are written to `strip`, a PNG.
    """
    exposure, tone_curve = _camera_facts(paths)
    capture = load_settled(paths).without(exposure["other_light"]).normalised()
    if not capture.held_out:
        return _table([], {}, "No photograph was held out: there is nothing to judge by.")
    mesh = shaded_mesh(paths)
    exposures = Exposures.of(exposure, tone_curve, mesh)
    views = [resize_view(view, SIDE) for view in capture.held_out]
    pictures = level_pictures(paths, (mesh, exposures), capture, views)
    judged = []
    for view in views:
        whole, on_mesh = view.mask > MASK_INSIDE, pictures["mesh"][view.name][..., 3] > 0
        judged.append(Judged(view=view, whole=whole, seen=whole & on_mesh))
    if strip is not None:
        save_sheet(strip, strip_rows(judged, pictures))
    return _table(judged, pictures)


def _camera_facts(paths: JobPaths) -> tuple[dict[str, Any], dict[str, Any]]:
    """Contents of exposure.json, which not every method writes, and of tone_curve.json."""
    folder = paths.stage("appearance")
    exposure = {"steps": {}, "corner_steps": 0.0, "slope_steps": {}, "other_light": []}
    if (folder / "exposure.json").is_file():
        exposure = stored_exposure(folder / "exposure.json")
    return exposure, stored_facts(folder / "tone_curve.json", TONE_CURVE)


def level_pictures(
    paths: JobPaths, known: tuple[Mesh, Exposures], capture: Capture, views: Sequence[View]
) -> dict[str, Pictures]:
    """What each level shows of held-out views, at their size and exposure, in the unit frame."""
    mesh, exposures = known
    photographs = [exposures.evened(resize_view(view, SIDE)) for view in capture.train]
    nearest, mean = _warped(mesh, photographs, views)
    stored = {
        "field": paths.stage("geometry") / "field_held_out.npz",
        "diffuse": paths.stage("appearance") / "held_out_diffuse.npz",
        "material": paths.stage("appearance") / "held_out.npz",
    }
    made: dict[str, Pictures] = {
        name: stored_arrays(file, PICTURES) if file.is_file() else {}
        for name, file in stored.items()
    }
    made |= {"hull": _on_hull(photographs, views), "mesh": nearest, "mean": mean}
    made["cycles"] = {
        view.name: read_picture(file)
        for view in views
        if (file := paths.rerender(view.name)).is_file()
    }
    # our own renderer alone knows how each photograph was exposed
    common = set(made) - {"diffuse", "material"}
    shown: dict[str, Pictures] = {name: {} for name in made}
    for name, level in made.items():
        for view in views:
            if view.name in level:
                picture = _sized(level[view.name], view)
                if name in common:
                    picture = exposures.as_photographed(picture, view)
                shown[name][view.name] = picture
    return shown


def _warped(
    mesh: Mesh, photographs: Sequence[View], views: Sequence[View]
) -> tuple[Pictures, Pictures]:
    """The nearest photographs and the mean of all on a surface, by view."""
    cameras = [view.camera for view in views]
    made = list(warped_views(mesh, photographs, cameras, RAY_OFFSET))
    by_name = dict(zip((view.name for view in views), made, strict=True))
    nearest = {name: one.nearest for name, one in by_name.items()}
    return nearest, {name: one.mean for name, one in by_name.items()}


def _on_hull(photographs: Sequence[View], views: Sequence[View]) -> Pictures:
    """The nearest photographs on the visual hull of the default settings by view, or none."""
    config = GeometryConfig()
    photos = [reduce_view(view, config.image_side) for view in photographs]
    try:
        surface = extract(*carve(hull_of(photos), config.hull_cells))
    except RobirError:
        return {}
    return _warped(surface, photographs, views)[0]


def _sized(picture: Picture, view: View) -> Picture:
    """A picture at a view's size, RGBA; area means, of the colour over black."""
    image = Image.fromarray(picture)
    size = (view.camera.width, view.camera.height)
    if image.mode == "RGBA" and image.size != size:
        image = image.convert("RGBa").resize(size, Image.Resampling.BOX).convert("RGBA")
    elif image.size != size:
        image = image.resize(size, Image.Resampling.BOX)
    return np.asarray(image.convert("RGBA"))


def _table(
    judged: Sequence[Judged], pictures: Mapping[str, Pictures], verdict: str | None = None
) -> dict[str, Any]:
    chain: dict[str, dict[str, Any]] = {}
    before: tuple[str, dict[str, Any]] | None = None
    for level in LEVELS:
        shown = pictures.get(level.name, {})
        scores = {
            one.view.name: view_scores(one, shown[one.view.name])
            for one in judged
            if one.view.name in shown and one.seen.any()
        }
        row: dict[str, Any] = {"letter": level.letter, "title": level.title, "views": len(scores)}
        for kind in ("psnr", "ssim", "sharpness", "psnr_whole_mask"):
            row[kind] = _mean([one[kind] for one in scores.values()])
        row |= {"loss": None, "against": None}
        if before is not None and scores:
            common = [name for name in scores if name in before[1]]
            lost = [before[1][name]["psnr"] - scores[name]["psnr"] for name in common]
            row |= {"loss": _mean(lost), "against": before[0] if common else None}
        if scores:
            before = (level.letter, scores)
        chain[level.name] = row
    whole = sum(int(one.whole.sum()) for one in judged)
    seen = sum(int(one.seen.sum()) for one in judged)
    return {
        "views": len(judged),
        "seen_share": seen / whole if whole else None,
        "chain": chain,
        "verdict": verdict or fault(chain),
    }


def view_scores(judged: Judged, picture: Picture) -> dict[str, Any]:
    """Scores of one level's picture (H, W, 4), codes, of one view of that size."""
    ours = picture[..., :3] / 255.0 * (picture[..., 3:] > 0)
    photo = judged.view.image_display / 255.0
    return {
        "psnr": metrics.psnr(ours[judged.seen], photo[judged.seen]),
        "ssim": metrics.masked_ssim(ours, photo, judged.seen),
        "sharpness": metrics.sharpness(ours, photo, judged.seen),
        "psnr_whole_mask": metrics.psnr(ours[judged.whole], photo[judged.whole]),
    }


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def fault(chain: Mapping[str, Mapping[str, Any]]) -> str:
    """One sentence that names the stage which loses most, by the chain of `level_scores`."""
    losses = {name: row["loss"] or 0.0 for name, row in chain.items()}
    worst = max(losses, key=lambda name: losses[name])
    if losses[worst] < NOTEWORTHY:
        return f"No level loses as much as {NOTEWORTHY:g} dB against the one before."
    row = chain[worst]
    last = next(k for k, level in enumerate(LEVELS) if level.name == worst)
    first = next(k for k, level in enumerate(LEVELS) if level.letter == row["against"])
    between = LEVELS[first + 1 : last + 1]  # those that were not measured may be at fault too
    stages = " or ".join(level.stage for level in between)
    reason = f": {between[0].reason}" if len(between) == 1 else ""
    return (
        f"{stages[0].upper()}{stages[1:]} loses {row['loss']:.1f} dB "
        f"({row['against']} to {row['letter']}){reason}."
    )


def strip_rows(judged: Sequence[Judged], pictures: Mapping[str, Pictures]) -> list[Pictures]:
    """Rows of labelled pictures of up to STRIP_VIEWS held-out views, those of Cycles first."""
    views = tuple(one.view for one in judged)
    rendered = tuple(view for view in views if view.name in pictures["cycles"])
    rows = []
    for view in spread_views(rendered or views, min(STRIP_VIEWS, len(rendered or views))):
        shown = {"photograph": np.dstack([view.image_display, view.mask])}
        for level in LEVELS:
            if pictures[level.name]:
                nothing = np.zeros((*view.mask.shape, 4), np.uint8)
                picture = pictures[level.name].get(view.name, nothing)
                alpha = np.minimum(picture[..., 3], view.mask)
                shown[f"{level.letter}  {level.name}"] = np.dstack([picture[..., :3], alpha])
        frame = window(view.mask)
        rows.append({label: over_grey(cut(picture, frame)) for label, picture in shown.items()})
    return rows


# titles of the columns of `level_cells`
LEVEL_HEAD = ("level", "", "dB", "SSIM", "sharpness", "dB, whole mask", "loss, dB")


def level_cells(levels: Mapping[str, Any]) -> list[list[str]]:
    """The table of `level_scores` as it is shown, a row a level."""

    def text(value: float | None, digits: int, sign: str) -> str:
        return "-" if value is None else f"{value:{sign}.{digits}f}"

    kinds = {"psnr": (1, ""), "ssim": (3, ""), "sharpness": (2, ""), "psnr_whole_mask": (1, "")}
    kinds["loss"] = (1, "+")
    return [
        [row["letter"], row["title"], *(text(row[kind], *how) for kind, how in kinds.items())]
        for row in levels["chain"].values()
    ]


def level_notes(levels: Mapping[str, Any]) -> list[str]:
    """Sentences below the table: what was compared, and which stage is at fault."""
    share, chain = levels["seen_share"], levels["chain"]
    if share is None:
        return [levels["verdict"]]
    notes = [
        f"{levels['views']} held-out photographs, the same pixels for all: {share:.0%} of the "
        "masks, where the mesh is met and some photograph shows the point.",
        levels["verdict"],
    ]
    asset, mean = (chain[name]["psnr"] for name in ("material", "mean"))
    if asset is not None and mean is not None:
        side = "above" if asset > mean else "below"
        notes.append(f"The asset (e) lies {abs(asset - mean):.1f} dB {side} the plain mean (c').")
    return notes


def level_lines(levels: Mapping[str, Any]) -> list[str]:
    """The table and its sentences for a terminal."""
    lines = [list(LEVEL_HEAD), *level_cells(levels)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shown = [
        "  ".join(
            cell.ljust(width) if index < 2 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    return [*shown, *level_notes(levels)]
