# SPDX-License-Identifier: Apache-2.0
"""The scores that tables show, and where they stand in what an evaluation returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from robir.evaluation.levels import LEVELS


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """One column."""

    title: str  # heading with the unit
    path: str  # dotted place in the scores; "a - b" is a difference of two
    # which end is good: "high", "low", "one" for ratios that should be 1, "zero" for errors with a
    # sign, or "nine tenths" for shares that should be that
    best: Literal["high", "low", "one", "zero", "nine tenths"]
    digits: int  # decimals shown

    def value(self, scores: Mapping[str, Any]) -> float | None:
        """The score, or None where it could not be measured."""
        parts = [_at(scores, path) for path in self.path.split(" - ")]
        if any(part is None for part in parts):
            return None
        return parts[0] if len(parts) == 1 else parts[0] - parts[1]

    def badness(self, value: float) -> float:
        """Larger is worse."""
        return {
            "high": -value,
            "low": value,
            "one": abs(value - 1.0),
            "zero": abs(value),
            "nine tenths": abs(value - 0.9),
        }[self.best]

    def text(self, value: float | None) -> str:
        """The value as shown."""
        return "-" if value is None else f"{value:.{self.digits}f}"


_ALBEDO = "albedo.psnr_linear"

# scores of one evaluation, as `robir.evaluation.evaluate.evaluate` returns them
SCORES = (
    Score(
        title="albedo, per channel (dB)", path=f"{_ALBEDO}.per_channel_lsq", best="high", digits=1
    ),
    Score(
        title="above the photo (dB)",
        path=f"{_ALBEDO}.per_channel_lsq - photo_as_albedo.psnr_linear.per_channel_lsq",
        best="high",
        digits=1,
    ),
    Score(title="albedo, raw (dB)", path=f"{_ALBEDO}.raw", best="high", digits=1),
    Score(title="shadow ratio", path="shadow.ratio", best="one", digits=2),
    Score(title="sun (degrees)", path="light.strongest_lobe_degrees", best="low", digits=1),
    Score(title="normals (degrees)", path="normals.mean_degrees", best="low", digits=1),
    Score(title="IoU", path="mask_iou", best="high", digits=3),
    Score(title="Chamfer (1e-3 radius)", path="chamfer.chamfer", best="low", digits=1),
    Score(title="roughness RMSE", path="roughness.rmse", best="low", digits=3),
    Score(
        title="over the best constant",
        path="roughness.rmse - roughness.best_constant_rmse",
        best="low",
        digits=3,
    ),
    Score(title="tone curve (stops)", path="tone_curve.stops", best="low", digits=2),
    Score(title="90 % band", path="uncertainty.share_90", best="nine tenths", digits=2),
)
ALBEDO, ABOVE_PHOTO, RAW_ALBEDO, SHADOW, SUN, NORMALS = SCORES[:6]
ROUGHNESS = SCORES[8]

LEVEL = Score(title="light level (ln)", path="light.level_log_error", best="zero", digits=2)
HUE = Score(title="light hue (ln)", path="light.hue_log_error", best="low", digits=3)
RELIT = Score(
    title="relit, per channel (dB)",
    path="relighting.psnr_srgb.per_channel_lsq",
    best="high",
    digits=1,
)
RELIT_RAW = Score(title="relit, raw (dB)", path="relighting.psnr_srgb.raw", best="high", digits=1)

# what the bench records of a run beside the scores: how its own re-render of held-out photographs
# compares with them, and what it cost
COSTS = (
    Score(title="re-render (dB)", path="held_out.psnr", best="high", digits=1),
    Score(title="CPU-s", path="cpu_seconds", best="low", digits=0),
    Score(title="peak GB", path="peak_gigabytes", best="low", digits=2),
)
RERENDER, SECONDS = COSTS[0], COSTS[1]


# scores of the levels, as `robir evaluate --json` prints them
LEVEL_SCORES = (
    *(
        Score(
            title=f"{level.letter} (dB)",
            path=f"levels.chain.{level.name}.psnr",
            best="high",
            digits=1,
        )
        for level in LEVELS
    ),
    *(
        Score(
            title=f"{level.letter} (SSIM)",
            path=f"levels.chain.{level.name}.ssim",
            best="high",
            digits=2,
        )
        for level in LEVELS
        if level.name in ("mean", "diffuse", "material", "cycles")
    ),
    Score(
        title="f, whole mask (dB)",
        path="levels.chain.cycles.psnr_whole_mask",
        best="high",
        digits=1,
    ),
    Score(
        title="e above c' (dB)",
        path="levels.chain.material.psnr - levels.chain.mean.psnr",
        best="high",
        digits=1,
    ),
)


def score_lines(scores: Mapping[str, Any]) -> list[str]:
    """One line a score, for a terminal."""
    width = max(len(score.title) for score in SCORES)
    shown = (*SCORES, LEVEL, HUE, RELIT, RELIT_RAW)
    lines = [f"{score.title:<{width}}  {score.text(score.value(scores))}" for score in shown]
    tone = scores["tone_curve"]
    families = f"{tone['family']} (true: {tone['true_view_transform']})"
    return [*lines, f"{'tone curve':<{width}}  {families}"]


def _at(scores: Mapping[str, Any], path: str) -> Any:
    value: Any = scores
    for key in path.split("."):
        if not isinstance(value, Mapping):
            return None
        value = value.get(key)
    return value
