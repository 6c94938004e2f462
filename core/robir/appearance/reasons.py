# SPDX-License-Identifier: Apache-2.0
"""What was chosen about tone curve, lights and cameras, in words for the report."""

from __future__ import annotations

from collections.abc import Collection

from robir.appearance.light.solver import Light
from robir.appearance.photometry.comparison import LEAST_SPREAD, LEAST_STOPS
from robir.appearance.photometry.exposure import Gains
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import fits_alike
from robir.jobs.context import Choice

GREY, BY_ALL, BY_KNOWN_ALBEDO = (
    "grey as a whole",
    "as is common",
    "by the paint that you know",
)


def light_choices(tone: ToneChoice, light: Light, seconds: dict[str, float]) -> tuple[Choice, ...]:
    """On the tone curve and the light; `seconds` is processor time by "tone_curve", "light"."""
    candidates, evidence = tone.candidates, tone.evidence
    is_known = tone.scene.known_albedo is not None
    reason = {
        True: f"{evidence.clipped_share:.1%} of the observations sit at code 255: the curve clips",
        False: "bright pixels thin out towards code 255: the curve rolls off",
        None: "too little is white, or nearly so, to tell; all families were compared",
    }[evidence.verdict]
    is_compared = len(tone.allowed) > 1
    return (
        Choice(
            choice="tone curve",
            chosen=candidates[0].curve.name,
            alternatives=tuple(candidate.curve.name for candidate in candidates[1:]),
            held_out_error=candidates[0].score,
            cost_seconds=seconds["tone_curve"],
            why="the photographs are linear, or the settings allow no other"
            if not is_compared
            else f"{reason}; the lowest display error of albedo carried between neighbours in "
            "different light, the simplest within one standard error; a camera's response is kept "
            f"unless it clearly lags{_near(tone)}{_beyond(tone)}",
        ),
        Choice(
            choice="sharp lights",
            chosen=len(light.axes),
            alternatives=tuple(range(len(light.history))),
            held_out_error=light.loss,
            cost_seconds=seconds["light"],
            why="the first must cast a shadow that the photographs show or explain the shading, a "
            "further one both; differences of albedo between neighbours that face alike without, "
            "with one, ...: " + ", ".join(f"{loss:.3f}" for loss in light.history),
        ),
        Choice(
            choice="hue of the light",
            chosen=BY_KNOWN_ALBEDO if is_known else GREY,
            alternatives=(GREY if is_known else BY_KNOWN_ALBEDO,),
            why="nothing tells the light's colour from that of all albedos but paint that you know",
        ),
        Choice(
            choice="brightness of the light",
            chosen=BY_KNOWN_ALBEDO if is_known else BY_ALL,
            alternatives=(BY_ALL if is_known else BY_KNOWN_ALBEDO,),
            why="how bright paints and exposures commonly are tells it, or paint that you know",
        ),
    )


def _near(tone: ToneChoice) -> str:
    """Which curves could not be told from the chosen one."""
    chosen, *others = tone.candidates
    near = [other.curve.name for other in others if fits_alike(chosen, other)]
    return f"; within noise of it: {', '.join(near)}" if near else ""


def _beyond(tone: ToneChoice) -> str:
    """Which curves do not reach the colours of the photographs."""
    return "".join(
        f"; {name} cannot show {share:.1%} of the colours" for name, share in tone.beyond.items()
    )


def camera_choices(
    gains: Gains, unlike: Collection[str], seconds: dict[str, float]
) -> tuple[Choice, ...]:
    """On exposures, light and corners of photographs; `seconds` is processor time by "exposure"."""
    alike, apart = "one for all", "each photograph its own"
    stops = gains.falloff.corner_stops
    even, darker = "as bright as the middle", f"{stops:.2f} stops darker than the middle"
    number, own = len(unlike), bool(gains.slopes)
    light = f"{apart if own else 'one'}, without {number} of them" if number else apart
    return (
        Choice(
            choice="light of the photographs",
            chosen=light if number or own else "one",
            alternatives=("one",) if own else (apart,),
            why="a photograph is left out where it is more than "
            f"{LEAST_STOPS} stops brighter or darker than the rest and its points "
            f"differ in that by more than {LEAST_SPREAD:.0%}; each has its own light "
            "where that lets photographs predict points elsewhere better than a sheen would",
        ),
        Choice(
            choice="exposure",
            chosen=apart if gains.by_view else alike,
            alternatives=(alike if gains.by_view else apart,),
            cost_seconds=seconds["exposure"],
            why="photographs are exposed apart as far as points of some orientations tell the same "
            "gains as points of the others",
        ),
        Choice(
            choice="corners of the photographs",
            chosen=darker if stops else even,
            alternatives=(even if stops else "darker than the middle",),
            why="corners are darker where photographs that had no part in that prove it",
        ),
    )
