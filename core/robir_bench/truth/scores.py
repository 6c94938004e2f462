# SPDX-License-Identifier: Apache-2.0
"""The scores that tables show, and where they stand in what an evaluation returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from robir.evaluation.levels import LEVELS


@dataclass(frozen=True, slots=True)
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
        if self.best in ("high", "low"):
            return -value if self.best == "high" else value
        return abs(value - {"one": 1.0, "zero": 0.0, "nine tenths": 0.9}[self.best])

    def text(self, value: float | None) -> str:
        """The value as shown."""
        return "-" if value is None else f"{value:.{self.digits}f}"


_ALBEDO = "albedo.psnr_linear"

# scores of one evaluation, as `robir.evaluation.evaluate.evaluate` returns them
SCORES = (
    Score("albedo, per channel (dB)", f"{_ALBEDO}.per_channel_lsq", "high", 1),
    Score(
        "above the photo (dB)",
        f"{_ALBEDO}.per_channel_lsq - photo_as_albedo.psnr_linear.per_channel_lsq",
        "high",
        1,
    ),
    Score("albedo, raw (dB)", f"{_ALBEDO}.raw", "high", 1),
    Score("shadow ratio", "shadow.ratio", "one", 2),
    Score("sun (degrees)", "light.strongest_lobe_degrees", "low", 1),
    Score("normals (degrees)", "normals.mean_degrees", "low", 1),
    Score("IoU", "mask_iou", "high", 3),
    Score("Chamfer (1e-3 radius)", "chamfer.chamfer", "low", 1),
    Score("roughness RMSE", "roughness.rmse", "low", 3),
    Score("over the best constant", "roughness.rmse - roughness.best_constant_rmse", "low", 3),
    Score("tone curve (stops)", "tone_curve.stops", "low", 2),
    Score("90 % band", "uncertainty.share_90", "nine tenths", 2),
)
ALBEDO, ABOVE_PHOTO, RAW_ALBEDO, SHADOW, SUN, NORMALS = SCORES[:6]
ROUGHNESS = SCORES[8]

LEVEL = Score("light level (ln)", "light.level_log_error", "zero", 2)
HUE = Score("light hue (ln)", "light.hue_log_error", "low", 3)
RELIT = Score("relit, per channel (dB)", "relighting.psnr_srgb.per_channel_lsq", "high", 1)
RELIT_RAW = Score("relit, raw (dB)", "relighting.psnr_srgb.raw", "high", 1)

# what the bench records of a run beside the scores: how its own re-render of held-out photographs
# compares with them, and what it cost
COSTS = (
    Score("re-render (dB)", "held_out.psnr", "high", 1),
    Score("CPU-s", "cpu_seconds", "low", 0),
    Score("peak GB", "peak_gigabytes", "low", 2),
)
RERENDER, SECONDS = COSTS[0], COSTS[1]


# scores of the levels, as `robir evaluate --json` prints them
LEVEL_SCORES = (
    *(
        Score(f"{level.letter} (dB)", f"levels.chain.{level.name}.psnr", "high", 1)
        for level in LEVELS
    ),
    *(
        Score(f"{level.letter} (SSIM)", f"levels.chain.{level.name}.ssim", "high", 2)
        for level in LEVELS
        if level.name in ("mean", "diffuse", "material", "cycles")
    ),
    *(
        Score(f"{level.letter} (sharpness)", f"levels.chain.{level.name}.sharpness", "one", 2)
        for level in LEVELS
        if level.name in ("mesh", "material")
    ),
    Score("f, whole mask (dB)", "levels.chain.cycles.psnr_whole_mask", "high", 1),
    Score("e above c' (dB)", "levels.chain.material.psnr - levels.chain.mean.psnr", "high", 1),
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
