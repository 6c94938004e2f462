# SPDX-License-Identifier: Apache-2.0
"""Settings of the choice of the tone curve."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.errors import ConfigError
from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingConfig:
    """What the histogram about white must be to tell a clipping curve from one that rolls off.

    Attributes:
        bright_code: Codes from here to 254 are nearly white.
        clipped_share: Share of observations at code 255 from which clipping is plain.
        spike_ratio: Pixels at 255 for each that is nearly white from which they are a spike.
        bright_share: Share of observations nearly white that rolls off if few lie at 255.
        rolled_ratio: So many at 255 for each that is nearly white are few. In photographs of three
            cameras it is .06 to .37; a white plate that just clips comes to .72.
        few_clipped: Share of observations at code 255 that is no glint any more, if next to none
            are nearly white.
        lone_ratio: How many times those must outnumber the nearly white ones.
    """

    bright_code: Annotated[int, Within(128, 254, "codes")] = 245
    clipped_share: Annotated[float, Within(0, 1)] = 0.004
    spike_ratio: Annotated[float, Within(0, 100)] = 0.75
    bright_share: Annotated[float, Within(0, 1)] = 0.016
    rolled_ratio: Annotated[float, Within(0.01, 100)] = 0.5
    few_clipped: Annotated[float, Within(0, 1)] = 3e-4
    lone_ratio: Annotated[float, Within(0, 1000)] = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GamutConfig:
    """When a curve cannot have made the photographs.

    Attributes:
        tolerance: By how much a colour may miss what a curve reaches: compression shifts colours.
        most_beyond: Share of observations that may lie farther beyond.
        num_asked: Observations that are asked.
    """

    tolerance: Annotated[float, Within(0, 255, "codes")] = 5.0
    most_beyond: Annotated[float, Within(0, 1)] = 1e-3
    num_asked: Annotated[int, Within(1, 10_000_000)] = 20000


@dataclass(frozen=True, slots=True, kw_only=True)
class HighlightEvidenceConfig:
    """How highlights are explained under a curve.

    Attributes:
        roughnesses: That are tried. The error grows on both sides of the right one as it does from
            the tip of a V, so that wider steps would favour whichever curve has its tip near one.
        num_samples: Samples that are looked at.
        least_views: Views near a sun's mirror direction that these must have to say anything.
        num_materials: Groups of like albedo among them; each has one roughness.
    """

    roughnesses: Annotated[tuple[float, ...], Within(0.05, 1)] = (
        *(0.2, 0.3, 0.38, 0.46, 0.54),
        *(0.61, 0.68, 0.75, 0.82, 0.9),
    )
    num_samples: Annotated[int, Within(1, 1_000_000)] = 1500
    least_views: Annotated[int, Within(1, 1_000_000)] = 100
    num_materials: Annotated[int, Within(1, 1000)] = 6

    def __post_init__(self) -> None:
        """Refuse to try nothing."""
        if not self.roughnesses:
            raise ConfigError(
                "appearance.tone.highlight_evidence.roughnesses is empty; it must name some"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingConfig:
    """How curves are ranked by albedo that is carried between neighbours.

    Attributes:
        error_cap: Display error, 0..1, beyond which a pair is of two materials and says no more.
        least_contrast: Difference of log irradiance from which a pair counts, by what exceeds it.
        most_contrast: Difference from which it counts no more than others.
        simpler_margin: Standard errors within which the simpler one of two curves of a kind is
            taken.
        settled_below: Lead of the plain curve over a shoulder below which their lights need not be
            settled: that moves it by less.
    """

    error_cap: Annotated[float, Within(0.001, 1)] = 0.08
    least_contrast: Annotated[float, Within(0, 10)] = 0.3
    most_contrast: Annotated[float, Within(0, 10)] = 1.5
    simpler_margin: Annotated[float, Within(0, 100, "standard errors")] = 1.0
    settled_below: Annotated[float, Within(-100, 100, "standard errors")] = -1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ShoulderConfig:
    """When the plain curve is taken rather than one with a shoulder.

    Attributes:
        mismatch_cap: Mismatch beyond which a pair is of two materials and says nothing more.
        mismatch_error: Mismatches by which curves differ for no reason; adds to their standard
            error. Blocks of one shadow err alike and agree better than they are right.
    """

    mismatch_cap: Annotated[float, Within(0.001, 100)] = 1.0
    mismatch_error: Annotated[float, Within(1e-6, 1)] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class ToneConfig:
    """How the tone curve is chosen.

    Attributes:
        code_error: Display codes by which mean errors differ for no reason; adds to their standard
            error. Photographs hold whole codes, and where highlights are faint the errors of all
            curves agree too well from block to block.
        clipping: What white tells.
        gamut: What colours tell.
        highlight_evidence: What highlights tell.
        ranking: What albedo carried between neighbours tells.
        shoulder: The plain curve against those with a shoulder.
    """

    code_error: Annotated[float, Within(1e-4, 100, "codes")] = 0.1
    clipping: ClippingConfig = field(default_factory=ClippingConfig)
    gamut: GamutConfig = field(default_factory=GamutConfig)
    highlight_evidence: HighlightEvidenceConfig = field(default_factory=HighlightEvidenceConfig)
    ranking: RankingConfig = field(default_factory=RankingConfig)
    shoulder: ShoulderConfig = field(default_factory=ShoulderConfig)
