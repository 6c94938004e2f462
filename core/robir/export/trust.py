# SPDX-License-Identifier: Apache-2.0
"""The program's own quality check: whether a result is to be trusted, without knowing the truth.

Each sign is a number that a sound result keeps on one side of a limit. The limits were set by 23
drawn captures of both halves of the population (docs/lab/population.md), seeds 0 to 11 and 100 to
112, that of `albedo` by fifteen of seeds 1118 to 1127. On sixty others four of the seven worst are
beyond one, and so are nine of 49 that are better (docs/accuracy.md). A sign that is only near its
limit, such as two tone curves that fit alike, says where to look and is no failure. The limits of
`views`, `shown` and `paint` are by reason: see appearance/photograph_check.py for what is shown
worse than by the mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robir.appearance.evidence import BY_ALL, BY_KNOWN_ALBEDO
from robir.capture.capture import Capture, View
from robir.capture.checks.findings import clipped_share
from robir.capture.images.loading import resize_view
from robir.evaluation.surfaces import MeshCaster, intersection_over_union
from robir.geometry.hull import mask_distance
from robir.geometry.mesh.triangles import Mesh
from robir.transport.observe import spread_views

Array = NDArray[np.floating[Any]]

_MAX_VIEWS = 12  # views that are looked at; more say the same
_OUTLINE_SIDE = 400  # longer side of the pictures in which outlines are compared, pixels, at most
_UNSURE = 1.0  # pixels on both sides of a mask's outline that may belong to either
_OBJECT = 127


@dataclass(frozen=True, slots=True, kw_only=True)
class Sign:
    """One number that tells good results from bad."""

    limit: float  # where doubt begins
    near: float  # where a value deserves a look, on the good side of the limit
    reason: str  # what is said to someone who knows no numbers
    message: str  # what is said in doubt; `{value}` is the number
    cure: str  # what the user can do

    @property
    def doubtful(self) -> Literal["below", "above"]:
        """On which side of the limit doubt is."""
        return "below" if self.limit < self.near else "above"

    def is_doubtful(self, value: float) -> bool:
        """Whether the value lies on the wrong side of the limit."""
        return value < self.limit if self.doubtful == "below" else value > self.limit


# what is looked at, by the name in report.json
SIGNS: dict[str, Sign] = {
    "outline": Sign(
        limit=0.97,
        near=0.98,
        reason="the model's outline differs from the masks",
        message="the surface's outline and the masks overlap by only {value:.1%}",
        cure="check the masks for holes and spill, and that poses and photographs belong together",
    ),
    "rerender": Sign(
        limit=18.0,
        near=21.0,
        reason="the model does not look like photographs that it never saw",
        message="the re-render of held-out photographs reaches only {value:.1f} dB",
        cure="look at the report: what differs there the model cannot explain",
    ),
    "albedo": Sign(
        limit=0.16,
        near=0.12,
        reason="the albedo is uncertain",
        message="by its own uncertainty the albedo is {value:.2f} off, where white is 1",
        cure="see where in uncertainty.png; photograph in even light and from more sides, and lock "
        "exposure and white balance",
    ),
    "views": Sign(
        limit=3.0,
        near=5.0,
        reason="few photographs see each spot",
        message="a visible spot is seen by {value:.1f} photographs on average",
        cure="add photographs; 20 around the object are a good start",
    ),
    "clipped": Sign(
        limit=0.1,
        near=0.07,
        reason="parts of the object are burnt out to white",
        message="{value:.0%} of the object is burnt out to white",
        cure="photograph darker; what is clipped has no material to be read",
    ),
    "shown": Sign(
        limit=0.05,
        near=0.035,
        reason="parts of the model look worse than a plain mean of the photographs",
        message="{value:.0%} of the surface is shown worse than by the mean of its photographs",
        cure="look at the report: the light or the surface is wrong there",
    ),
    "rivals": Sign(
        limit=16.0,
        near=24.0,
        reason="the photographs fit two tone curves with different albedo",
        message="photographs fit another tone curve as well, under which albedo is another: "
        "{value:.0f} dB apart",
        cure="tell the tone curve if you know how the photographs were made",
    ),
    "paint": Sign(
        limit=3.0,
        near=2.0,
        reason="the colour that you know contradicts the light",
        message="the paint that you know asks for a light {value:.1f} standard errors from all "
        "else that tells how bright it is",
        cure="pick a matt, bright and evenly lit spot, and check its true colour",
    ),
}


def quality(
    capture: Capture,
    mesh: Mesh,
    arrays: dict[str, Array],
    rerender: float | None,
    left_open: dict[str, float],
) -> dict[str, Any]:
    """Whether the result is to be trusted, by the mesh and photographs in the capture frame.

    `rerender` is the PSNR of our own re-render of held-out photographs in dB, None without;
    `left_open` holds what `rivals`, `paint` and `shown` say. "is_trusted"; "signs" by name, each
    "value", "limit", "doubtful" ("below" or "above"); "doubts": sentences, empty for a trusted
    result; "verdict" as of `verdict`.
    """
    values = signs(capture, mesh, arrays, rerender) | left_open
    doubts = [
        f"{SIGNS[name].message.format(value=value)}; {SIGNS[name].cure}"
        for name, value in values.items()
        if SIGNS[name].is_doubtful(value)
    ]
    found = {
        name: {"value": value, "limit": SIGNS[name].limit, "doubtful": SIGNS[name].doubtful}
        for name, value in values.items()
    }
    whole = {"is_trusted": not doubts, "doubts": doubts}
    return whole | {"verdict": verdict(values), "signs": found}


def verdict(values: dict[str, float]) -> dict[str, str]:
    """The result in one word, "Good", "Check this" or "Doubtful", and its worst sign."""
    way = {
        name: (value - SIGNS[name].near) / (SIGNS[name].limit - SIGNS[name].near)
        for name, value in values.items()
    }
    worst = max(way, key=way.__getitem__)
    if way[worst] <= 0.0:
        return {"word": "Good", "reason": "", "remedy": ""}
    sign = SIGNS[worst]
    is_doubtful = any(SIGNS[name].is_doubtful(value) for name, value in values.items())
    word = "Doubtful" if is_doubtful else "Check this"
    return {"word": word, "reason": sign.reason, "remedy": sign.cure}


def signs(
    capture: Capture, mesh: Mesh, arrays: dict[str, Array], rerender: float | None
) -> dict[str, float]:
    """The numbers of `SIGNS` that could be taken; arguments as for `quality`."""
    views = spread_views(capture.train, _MAX_VIEWS)
    inside = arrays["inside"].astype(bool)
    seen = inside & (arrays["coverage"] > 0)
    values = {"outline": _outline(mesh, views)}
    if rerender is not None:
        values["rerender"] = rerender
    if seen.any():
        values["albedo"] = _albedo_error(arrays["albedo_linear"][seen], arrays["uncertainty"][seen])
        values["views"] = float(arrays["coverage"][seen].mean())
    values["clipped"] = clipped_share(views)
    return values


def rivals(candidates: list[dict[str, Any]]) -> dict[str, float]:
    """PSNR in dB between albedos under curves that fit alike, the least; empty without such."""
    apart = [row["albedo_apart"] for row in candidates if row["albedo_apart"] is not None]
    return {"rivals": min(apart)} if apart else {}


def paint(evidence: list[dict[str, Any]]) -> dict[str, float]:
    """Standard errors from known paint to all other evidence of the light's level, if there is."""
    rows = {row["by"]: row for row in evidence if row["of"] == "level"}
    if BY_KNOWN_ALBEDO not in rows or BY_ALL not in rows:
        return {}
    known, others = rows[BY_KNOWN_ALBEDO], rows[BY_ALL]
    error = float(np.hypot(known["deviation"], others["deviation"]))
    return {"paint": abs(known["value"] - others["value"]) / error}


def shown(last_word: dict[str, Any] | None) -> dict[str, float]:
    """Share of the surface shown worse than by the mean of its photographs, by last_word.json."""
    return {} if last_word is None else {"shown": float(last_word["unexplained"])}


def _albedo_error(albedo: Array, uncertainty: Array) -> float:
    """Root mean square error of albedo (N, 3) by the standard error (N,) of its logarithm."""
    return float(np.sqrt(((albedo * uncertainty[:, None]) ** 2).mean()))


def _outline(mesh: Mesh, views: tuple[View, ...]) -> float:
    """Overlap of surface and masks in all views, without the pixels along the masks' outlines."""
    caster = MeshCaster(mesh)
    ours, masks = [], []
    for view in views:
        small = resize_view(view, _OUTLINE_SIDE)
        distance = mask_distance((small.mask / 255).astype(np.float32))
        is_sure = np.abs(distance) >= _UNSURE
        ours.append(caster.cast(small.camera).hit[is_sure])
        masks.append(distance[is_sure] < 0)
    return intersection_over_union(np.concatenate(ours), np.concatenate(masks))
