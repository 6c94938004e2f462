# SPDX-License-Identifier: Apache-2.0
"""Which tone curve the photographs went through.

Two kinds of evidence come before any fit. A curve that clips piles pixels up at code 255; one that
rolls off does not. A curve that mixes channels does not reach every display colour: AgX draws
saturated colours towards grey. What is left is ranked under the suns of one of them, see
ranking.py.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from robir.appearance.config import FAMILIES, AppearanceConfig
from robir.appearance.light.problem import Scene, make_problem
from robir.appearance.light.solver import Light
from robir.appearance.light.sun_search import find_suns
from robir.appearance.tone.ranking import CAMERA, PLAIN, CurveCandidate, ranked
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.steps import Pipeline, Step
from robir.transport.observe import Observations

# by how much a colour may miss what a curve reaches: compression shifts colours (codes)
_TOLERANCE = 5.0
_MOST_BEYOND = 1e-3  # share of observations that may lie farther beyond
_NUM_ASKED = 20000  # observations that are asked


def share_beyond(curve: AbstractToneCurve, observations: Observations) -> float:
    """Share of the unclipped observations, 0..1, whose colour no light gives under a curve."""
    if not curve.mixes_channels:
        return 0.0
    shown = (observations.weight > 0) & ~observations.clipped.any(2)
    codes = observations.display[shown]
    codes = codes[:: max(1, len(codes) // _NUM_ASKED)]
    display = torch.from_numpy(codes.astype(np.float32) / 255)
    reached = curve.display_from_linear(curve.linear_from_display(display))
    missed = 255 * (reached - display).abs().amax(1)
    return float((missed > _TOLERANCE).float().mean()) if len(codes) else 0.0


def unable(curves: Iterable[AbstractToneCurve], observations: Observations) -> dict[str, float]:
    """The curves that cannot have made the photographs: their `share_beyond` by name."""
    shares = {curve.name: share_beyond(curve, observations) for curve in curves}
    return {name: share for name, share in shares.items() if share > _MOST_BEYOND}


_BRIGHT_CODE = 245  # codes from here to 254 are nearly white
_CLIPPED_SHARE = 0.004  # share of observations at code 255 from which clipping is plain
_SPIKE_RATIO = 0.75  # pixels at 255 for each that is nearly white from which they are a spike
_BRIGHT_SHARE = 0.016  # share of observations nearly white that rolls off if few lie at 255
# so many at 255 for each that is nearly white are few. In photographs of three cameras it is 0.06
# to 0.37; a white plate that just clips comes to 0.72.
_ROLLED_RATIO = 0.5
# share of observations at code 255 that is no glint any more, if next to none are nearly white
_FEW_CLIPPED = 3e-4
_LONE_RATIO = 10.0  # how many times those must outnumber the nearly white ones


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingEvidence:
    """What the histogram says about white."""

    clipped_share: float  # observations with a channel at code 255
    bright_share: float  # observations with their brightest channel nearly white

    @property
    def verdict(self) -> bool | None:
        """True for a clipping curve, False for one that rolls off, None if white does not tell."""
        clipped, bright = self.clipped_share, self.bright_share
        if clipped > max(_CLIPPED_SHARE, _SPIKE_RATIO * bright):
            return True
        if bright > max(_BRIGHT_SHARE, clipped / _ROLLED_RATIO):
            return False
        if clipped > max(_FEW_CLIPPED, _LONE_RATIO * bright):
            return True
        return None


def clipping_evidence(observations: Observations) -> ClippingEvidence:
    """Shares of clipped and of nearly white observations."""
    valid = observations.weight > 0
    brightest = observations.display.max(2)
    clipped = observations.clipped.any(2)
    total = max(1, int(valid.sum()))
    return ClippingEvidence(
        clipped_share=float((clipped & valid).sum() / total),
        bright_share=float(((brightest >= _BRIGHT_CODE) & ~clipped & valid).sum() / total),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ToneChoice:
    """All that the choice of the tone curve rests on, as far as the search has got."""

    scene: Scene  # samples with their transport
    config: AppearanceConfig  # families and sizes
    seed: int  # of the search
    allowed: list[AbstractToneCurve]  # curves that may be chosen, simplest first
    evidence: ClippingEvidence  # of the histogram
    # names of curves that cannot reach some colours, with these colours' share
    beyond: dict[str, float]
    # the light under the first curve: where shadows lie does not depend on it
    suns: Light | None = None
    # the chosen one first, then by score
    candidates: list[CurveCandidate] = field(default_factory=list)

    @classmethod
    def of(cls, scene: Scene, config: AppearanceConfig, seed: int) -> ToneChoice:
        """Curves that the configuration allows, and what white and colours say of them."""
        allowed = [curve_from_name(name) for name in FAMILIES if name in config.families]
        observations = scene.transport.observations
        return cls(
            scene=scene,
            config=config,
            seed=seed,
            allowed=allowed,
            evidence=clipping_evidence(observations),
            beyond=unable(allowed, observations),
        )

    @property
    def fitting(self) -> list[AbstractToneCurve]:
        """The curves that no code and no colour rules out; all if that would rule out every one.

        A camera's response rolls off a little before it clips, so it fits either way.
        """
        clipping, verdict = (PLAIN, CAMERA), self.evidence.verdict
        return [
            curve
            for curve in self.allowed
            if not (verdict is True and curve.name not in clipping)
            and not (verdict is False and curve.name == PLAIN)
            and curve.name not in self.beyond
        ] or self.allowed

    @property
    def first(self) -> AbstractToneCurve:
        """The curve under which suns are searched: Filmic lies between the families."""
        fitting = self.fitting
        return next((curve for curve in fitting if curve.name == "filmic"), fitting[0])

    @property
    def found(self) -> Light:
        """The light under the first curve."""
        if self.suns is None:
            raise RuntimeError("no suns were searched")
        return self.suns


def _search_suns(state: ToneChoice) -> ToneChoice:
    problem = make_problem(state.scene, state.first)
    return replace(state, suns=find_suns(problem, state.config, state.seed))


def _rank(state: ToneChoice) -> ToneChoice:
    return replace(state, candidates=ranked(state.scene, state.fitting, state.found, state.config))


# how the tone curve is found, in this order
SEARCH: tuple[Step[ToneChoice], ...] = (
    Step(
        name="suns",
        purpose="finds sharp lights by the shadows they cast",
        source="ours: dense scan, then a shrinking search with traced rays",
        run=_search_suns,
        is_on_trial=False,
    ),
    Step(
        name="tone-curve",
        purpose="ranks tone curves by albedo carried between neighbours in different light",
        source="ours, over RobIR's ACES (equations 6 to 8) and the view transforms of Blender",
        run=_rank,
        is_on_trial=False,
    ),
)


def choose_tone_curve(
    scene: Scene, config: AppearanceConfig, seed: int, pipeline: Pipeline
) -> ToneChoice:
    """Score every family that the histogram allows."""
    return pipeline.run(SEARCH, ToneChoice.of(scene, config, seed))
