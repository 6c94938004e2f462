# SPDX-License-Identifier: Apache-2.0
"""The capture stage: any known format in, undistorted views of one size class out."""

from __future__ import annotations

from typing import Any

from robir.capture.checks.findings import clipped_share, mask_share
from robir.capture.config import CaptureConfig
from robir.capture.poses.adjust import with_adjusted_cameras
from robir.capture.recognise import Workshop, read_capture
from robir.capture.refusal import describe
from robir.capture.store import save_capture
from robir.jobs.context import StageContext

REVISION = 10  # raised by hand when the results of this stage change


def run(context: StageContext[CaptureConfig]) -> dict[str, Any]:
    """Read, check and store the capture; nothing is stored if it cannot be reconstructed."""
    capture = read_capture(
        context.source,
        context.masks,
        context.config,
        lambda fraction, message: context.reporter.progress(0.85 * fraction, message),
        Workshop(folder=context.paths.registration, seed=context.seed),
        context.paths.masks,
        context.mesh,
    )
    if context.config.adjust_cameras:
        context.reporter.progress(0.85, "holding the cameras against the photographs")
        capture = with_adjusted_cameras(capture)
    for finding in capture.findings:
        if finding.level == "warning":
            context.reporter.warn(describe(finding))
    save_capture(context.paths.stage("capture"), capture)
    context.reporter.progress(1.0, "capture stored")
    counts = {"views": len(capture.train), "held_out": len(capture.held_out)}
    shares = {"mask_share": mask_share, "clipped_share": clipped_share}
    found = {name: share(capture.views) for name, share in shares.items()}
    return {"format": capture.format} | counts | found | {"bounds_radius": capture.bounds.radius}
