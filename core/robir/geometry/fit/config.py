# SPDX-License-Identifier: Apache-2.0
"""Settings of the fit of field and colours, and of what is done to it on its way."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

from robir.errors import ConfigError
from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentConfig:
    """How cameras are turned to fit a field.

    Attributes:
        image_side: Longer side of the photographs that are compared; finer ones show no more of a
            coarse field.
        pixels: Pixels of a photograph that are compared, drawn where it changes most.
        blur: Standard deviation of the filter under which a photograph's slopes are taken.
        border: Left out along a picture's border.
        tolerance: Difference from the rendering, in multiples of the photograph's median, at which
            a pixel counts half: what the field does not show yet must not turn the camera.
        prior: Standard deviation that is expected of a given camera about each of its axes; it only
            holds what the photograph does not tell, as the roll about a plain ball.
        frame_rounds: Rounds of reweighting by which the motion of the world is found without the
            worst cameras.
    """

    image_side: Annotated[int, Within(32, 4000, "pixels")] = 200
    pixels: Annotated[int, Within(16, 100_000)] = 600
    blur: Annotated[float, Within(0, 10, "pixels")] = 0.7
    border: Annotated[int, Within(1, 8, "pixels")] = 2
    tolerance: Annotated[float, Within(0.1, 100)] = 3.0
    prior: Annotated[float, Within(0.001, 90, "degrees")] = 1.0
    frame_rounds: Annotated[int, Within(1, 100)] = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class CleanConfig:
    """What is brought back to the field, and taken away from its surface.

    Attributes:
        batches: Batches of 2048 rays that are searched for missing parts.
        least_share: Pieces with less than this share of the largest piece's area are removed.
    """

    batches: Annotated[int, Within(0, 1000)] = 40
    least_share: Annotated[float, Within(0, 1)] = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class DescentConfig:
    """Steps of the distances.

    Attributes:
        gradient_passes: Passes of the (1, 2, 1) / 4 filter over the gradient of the distances.
        first_decay: Of the first moment, of features and network as well.
        second_decay: Of the second moment, likewise.
        memory: Decay of the mean gradient that tells whether gradients agree: over 50 steps every
            spot is seen from many sides.
        doubt: Agreement, in multiples of what gradients of random sign show by chance, at which the
            step is halved. Chance alone then leaves a tenth of the step, ten times chance all but a
            tenth.
    """

    gradient_passes: Annotated[int, Within(0, 20)] = 2
    first_decay: Annotated[float, Within(0, 0.9999)] = 0.9
    second_decay: Annotated[float, Within(0.5, 0.9999)] = 0.99
    memory: Annotated[float, Within(0, 0.9999)] = 0.98
    doubt: Annotated[float, Within(0.01, 1000)] = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldConfig:
    """The network of the colours, and what it is told.

    Attributes:
        octaves: Frequencies at which the mirrored direction is shown to the network as well.
        width: Units of a hidden layer.
        soft_passes: Passes of the (1, 2, 1) / 4 filter that frees the surface of small lumps.
    """

    octaves: Annotated[tuple[float, ...], Within(0.1, 100, "radians")] = (2.0, 4.0, 8.0)
    width: Annotated[int, Within(1, 1024)] = 64
    soft_passes: Annotated[int, Within(0, 20)] = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutConfig:
    """Pictures of the finished field.

    Attributes:
        image_side: Longer side of the pictures, where photographs are larger.
    """

    image_side: Annotated[int, Within(16, 8000, "pixels")] = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorPitsConfig:
    """Where hollows are filled that mirrored light has dug.

    Attributes:
        near: Nodes so close to the surface are asked, each about the surface next to it.
        least_cosine: Between normal and view, from which a camera is asked.
        least_views: Cameras that must face a spot.
        most_views: Cameras that are asked at all.
        region_passes: Passes of the (1, 2, 1) / 4 filter over what single spots show: twelve make
            regions of five cells.
        dull: Mean change of display colour with the direction, over a region of the coarsest level,
            up to which nothing is filled: more than glossy paint shows.
        mirroring: The same from which hollows are filled at full speed: less than metal shows.
        proven_dull: As `dull` where photographs prove that something is mirrored: less than glossy
            paint shows. What is filled by it must let them predict each other better.
        proven_mirroring: As `mirroring`, likewise.
        most_mirroring: Share of the surface above which another light in some photographs, or
            cameras that are off, may be the cause instead of metal: then it must be proven.
        reach: By which such a region is widened: a pit hides from the network what dug it.
        rounds: Steps of the filling: 200 fill a hollow of nine cells across.
    """

    near: Annotated[float, Within(0.5, 3, "cells")] = 0.7
    least_cosine: Annotated[float, Within(0, 0.95)] = 0.3
    least_views: Annotated[int, Within(2, 100)] = 4
    most_views: Annotated[int, Within(2, 500)] = 16
    region_passes: Annotated[int, Within(0, 20)] = 12
    dull: Annotated[float, Within(0, 1)] = 0.042
    mirroring: Annotated[float, Within(0, 1)] = 0.05
    proven_dull: Annotated[float, Within(0, 1)] = 0.018
    proven_mirroring: Annotated[float, Within(0, 1)] = 0.026
    most_mirroring: Annotated[float, Within(0, 1)] = 0.25
    reach: Annotated[int, Within(0, 32, "cells of the coarsest level")] = 4
    rounds: Annotated[int, Within(0, 10_000)] = 200

    def __post_init__(self) -> None:
        """Refuse ramps that do not rise."""
        for low, high in (("dull", "mirroring"), ("proven_dull", "proven_mirroring")):
            if not getattr(self, low) < getattr(self, high):
                raise ConfigError(
                    f"geometry.fit.mirror_pits.{low} is {getattr(self, low)}; it must be below "
                    f"{high}, {getattr(self, high)}"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class OptimiseConfig:
    """Losses, rates and their course over the fit.

    Attributes:
        first_sharpness: NeuS steepness at the start, for an object of longest side 2.
        last_sharpness: The same at the end.
        sharpest_at: Share of the fit from which it is the last one.
        band: Distance from the surface that rays are sampled in, in widths of the soft surface.
        mask_weight: Weight of the coverage's cross-entropy against the colour.
        full_coverage: From which coverage counts as full: what dropped intervals leave of it.
        refresh: Between updates of the occupancy and of the nodes that carry features.
        smooth_every: Between the proximal steps on the field.
        smoothing: Share of the way towards its neighbours' mean that such a step moves a node at
            the start; it falls to 0. Early steps are large and noisy, and lumps that stay where the
            colour decides little are dug further by the colours learnt on them; but smoothing
            shrinks what is round.
        fairing: Share of the way that every such step moves a node there and back, which takes what
            is rough and leaves what is round (Taubin 1995, "A signal processing approach to fair
            surface design").
        first_distance_rate: Of the distances where gradients agree, at the coarsest level, which
            has to leave the visual hull.
        distance_rate: The same at the other levels.
        feature_rate: Adam's rate of the features.
        network_rate: Adam's rate of the network: reflections must be learnt before the surface is
            dug for them.
        decay_from: Share of the fit from which all rates fall.
        last_rate: Share of the rates that is left at the end.
    """

    first_sharpness: Annotated[float, Within(1, 1000)] = 30.0
    last_sharpness: Annotated[float, Within(1, 2000)] = 160.0
    sharpest_at: Annotated[float, Within(0.01, 1)] = 0.85
    band: Annotated[float, Within(0.5, 20)] = 5.0
    mask_weight: Annotated[float, Within(0, 10)] = 0.2
    full_coverage: Annotated[float, Within(0.5, 0.999)] = 0.98
    refresh: Annotated[int, Within(1, 1000, "steps")] = 25
    smooth_every: Annotated[int, Within(1, 1000, "steps")] = 10
    smoothing: Annotated[float, Within(0, 0.9)] = 0.5
    fairing: Annotated[float, Within(0, 0.9)] = 0.25
    first_distance_rate: Annotated[float, Within(0, 5, "cells a step")] = 0.5
    distance_rate: Annotated[float, Within(0, 5, "cells a step")] = 0.375
    feature_rate: Annotated[float, Within(0, 10)] = 0.3
    network_rate: Annotated[float, Within(0, 1)] = 0.01
    decay_from: Annotated[float, Within(0, 0.99)] = 0.3
    last_rate: Annotated[float, Within(1e-6, 1)] = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseTrialConfig:
    """When cameras are tried, and what they must show to be turned.

    Attributes:
        trial_step: Step of the fit at which the cameras are tried. Shorter fits try none.
        last_step: After which the fit begins anew with the cameras that were turned until then.
        polish_every: Between the turns of cameras that stood the test.
        last_polish: Last step for one.
        least_shift: Root mean square of the training views that the first step must move the
            photographs to count: more than it moves exact cameras.
        least_gain: Share by which the photographs' difference from the rendering must fall.
        most_rounds: How often at most the fit begins anew with turned cameras.
    """

    trial_step: Annotated[int, Within(1, 100_000, "steps")] = 75
    last_step: Annotated[int, Within(1, 100_000, "steps")] = 150
    polish_every: Annotated[int, Within(1, 100_000, "steps")] = 100
    last_polish: Annotated[int, Within(0, 100_000, "steps")] = 500
    least_shift: Annotated[float, Within(0, 100, "pixels")] = 0.13
    least_gain: Annotated[float, Within(0, 0.99)] = 0.02
    most_rounds: Annotated[int, Within(0, 20)] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingConfig:
    """Steps of rays near the surface.

    Attributes:
        block: Edge of a block of the coarse occupancy.
        least_steps: Fewest steps that a ray takes along such an edge.
        most_steps: Most of them. In between, no step is longer than the width of the soft surface,
            1 / inv_std: early on that is soft, and shorter ones find no more.
        least_weight: Intervals that contribute less than this to their pixel are dropped.
    """

    block: Annotated[int, Within(1, 16, "cells")] = 2
    least_steps: Annotated[int, Within(1, 100)] = 3
    most_steps: Annotated[int, Within(1, 100)] = 5
    least_weight: Annotated[float, Within(0, 0.1)] = 2e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class FitConfig:
    """The fit, by its parts.

    Attributes:
        alignment: How cameras are turned to fit a field.
        clean: What is brought back, and which pieces go.
        descent: Steps of the distances.
        field: The network of the colours.
        held_out: Pictures of the finished field.
        mirror_pits: Hollows that mirrored light has dug.
        optimise: Losses and rates.
        pose_trial: When cameras are turned.
        sampling: Steps of rays.
    """

    alignment: AlignmentConfig = dataclasses.field(default_factory=AlignmentConfig)
    clean: CleanConfig = dataclasses.field(default_factory=CleanConfig)
    descent: DescentConfig = dataclasses.field(default_factory=DescentConfig)
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    held_out: HeldOutConfig = dataclasses.field(default_factory=HeldOutConfig)
    mirror_pits: MirrorPitsConfig = dataclasses.field(default_factory=MirrorPitsConfig)
    optimise: OptimiseConfig = dataclasses.field(default_factory=OptimiseConfig)
    pose_trial: PoseTrialConfig = dataclasses.field(default_factory=PoseTrialConfig)
    sampling: SamplingConfig = dataclasses.field(default_factory=SamplingConfig)
