# SPDX-License-Identifier: Apache-2.0
"""Posed photographs that take no part: those the user left out, and missing ones if allowed."""

from __future__ import annotations

from dataclasses import replace

from robir.capture.config import CaptureConfig
from robir.capture.frames import FrameSet
from robir.capture.refusal import note, warning


def without_left_out(frames: FrameSet, config: CaptureConfig) -> FrameSet:
    """The photographs to work with, and findings about those left out.

    Args:
        frames: What the format says.
        config: Its `leave_out` names photographs as findings do: by path or by view; `missing` says
            whether photographs without a file go too.
    """
    unwanted = set(config.leave_out)
    chosen = [frame for frame in frames.frames if unwanted & {frame.name, frame.relative}]
    known = {name for frame in chosen for name in (frame.name, frame.relative)}
    skips = config.missing == "skip"
    missing = [f for f in frames.frames if skips and f.name not in known and not f.image.is_file()]
    found = []
    if chosen:
        names = [frame.name for frame in chosen]
        found.append(note("left-out", f"{len(chosen)} photographs are left out as asked", *names))
    if unwanted - known:
        message = "Photographs that were to be left out are not in the capture"
        cure = "Name them as the findings do."
        found.append(warning("unknown-photographs", message, cure, *sorted(unwanted - known)))
    if missing:
        message = f"{len(missing)} of {len(frames.frames)} posed photographs are missing and left "
        message += "out"
        cure = "Put them below the capture's folder to have them used."
        found.append(
            warning("missing-skipped", message, cure, *(frame.relative for frame in missing))
        )
    gone = {frame.name for frame in (*chosen, *missing)}
    return replace(
        frames,
        frames=tuple(f for f in frames.frames if f.name not in gone),
        other_order=tuple(f for f in frames.other_order if f.name not in gone),
        findings=(*frames.findings, *found),
    )
