# SPDX-License-Identifier: Apache-2.0
"""The transport stage: mesh and photographs in, baked light transport out."""

from __future__ import annotations

from typing import Any

import numpy as np

from robir.capture.store import load_settled
from robir.errors import CaptureError
from robir.geometry.mesh.triangles import mesh_for_light
from robir.jobs.context import StageContext
from robir.transport.baked import bake
from robir.transport.config import TransportConfig

REVISION = 5


def run(context: StageContext[TransportConfig]) -> dict[str, Any]:
    """Bake visibility, the one-bounce matrix and observations; counts for the manifest.

    `CaptureError` if hardly any surface is seen by the cameras.
    """
    context.reporter.progress(0.0, "reading the mesh and the photographs")
    capture = load_settled(context.paths).normalised()
    mesh = mesh_for_light(context.paths.stage("geometry"))
    context.reporter.progress(0.1, "tracing what every surface sample sees")
    transport = bake(mesh, capture.train, context.config, context.seed)
    seen = (transport.observations.weight > 0).sum(1)
    if (seen >= 2).mean() < 0.05:
        raise CaptureError(
            f"only {(seen >= 2).mean():.0%} of the reconstructed surface is seen by two cameras; "
            "the cameras and the masks do not fit together. Run `robir check` and look at the "
            "masks and poses it names."
        )
    context.reporter.progress(0.9, "writing")
    transport.save(context.paths.stage("transport"))
    return {
        "surfels": len(transport.surfels),
        "directions": len(transport.visibility.directions),
        "bounces": int(transport.visibility.bounce.nnz),
        "seen_share": round(float((seen >= 2).mean()), 4),
        "views_per_surfel": round(float(np.mean(seen)), 2),
    }
