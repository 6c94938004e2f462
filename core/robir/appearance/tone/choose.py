# SPDX-License-Identifier: Apache-2.0
"""Which tone curve the photographs went through.

Two kinds of evidence come before any fit: what is clipped, see clipping.py, and which colours a
curve cannot reach, see gamut.py. What is left is ranked under the suns of one of them, see
ranking.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from robir.appearance.config import KNOWN_FAMILIES, AppearanceConfig
from robir.appearance.light.problem import Scene, make_problem
from robir.appearance.light.solver import Light
from robir.appearance.light.sun_search import find_suns
from robir.appearance.tone.clipping import ClippingEvidence, clipping_evidence
from robir.appearance.tone.gamut import unable
from robir.appearance.tone.ranking import CAMERA, PLAIN, CurveCandidate, ranked
from robir.maths.tone import curve_from_name
from robir.maths.tone_curve import AbstractToneCurve
from robir.steps import Pipeline, Step


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
        allowed = [curve_from_name(name) for name in KNOWN_FAMILIES if name in config.families]
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
