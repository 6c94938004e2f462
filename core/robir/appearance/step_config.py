# SPDX-License-Identifier: Apache-2.0
"""Settings of the steps that stand in no room of the appearance stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class BlocksConfig:
    """What standard errors are taken over.

    Attributes:
        side: Of a block. Samples in one share their materials and the errors of the mesh.
    """

    side: Annotated[float, Within(0.01, 2, "unit frame")] = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofConfig:
    """By which photographs whatever enters the model is proven.

    Attributes:
        every: One view in so many takes no part in a fit.
    """

    every: Annotated[int, Within(2, 50)] = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvenSunsConfig:
    """Whether photographs disprove the suns.

    Attributes:
        margin: By which suns must lead. A convex thing without highlights has no shadow that could
            tell; its suns stay.
    """

    margin: Annotated[float, Within(-100, 100, "standard errors")] = -0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothNormalsConfig:
    """How normals of a photographed surface are freed of its grain.

    Attributes:
        reach: Distance that is averaged over.
        edge: Angle between normals at which they count a third: twice the error of a good one.
        num_samples: Samples that are averaged at most, the nearest.
    """

    reach: Annotated[float, Within(0, 1, "unit frame")] = 0.08
    edge: Annotated[float, Within(0.1, 180, "degrees")] = 25.0
    num_samples: Annotated[int, Within(2, 1024)] = 128


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderConfig:
    """Our own re-renders of views.

    Attributes:
        pixel_rays: Rays along each side of a pixel.
        held_out_side: Longer side of the held-out views at most.
    """

    pixel_rays: Annotated[int, Within(1, 8)] = 2
    held_out_side: Annotated[int, Within(32, 8192, "pixels")] = 400
