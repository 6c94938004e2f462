# SPDX-License-Identifier: Apache-2.0
"""`robir check`: findings about a capture before an hour is spent on it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from robir.capture.capture import Capture, Finding
from robir.capture.config import CaptureConfig
from robir.capture.frames import FrameSet, PosedRefusedError
from robir.capture.recognise import Workshop, read_capture
from robir.capture.refusal import CaptureRefusedError
from robir.capture.views import Progress, unheard


def check_capture(
    source: Path, masks: Path | None, config: CaptureConfig, progress: Progress = unheard
) -> tuple[Capture | None, tuple[Finding, ...], FrameSet | None]:
    """Read a capture and say what was noticed; a bad capture is no exception here.

    Args:
        source: Folder of the capture, or its file of poses; never written to.
        masks: Folder of masks, or None.
        config: Settings of the capture stage.
        progress: Told how far reading is.

    Returns:
        The capture, or None if errors are among the findings; all findings, errors first; of a
        refused capture the posed photographs, if there are any.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="robir-") as folder:
            workshop = Workshop(folder=Path(folder), seed=0)
            capture = read_capture(source, masks, config, progress, workshop)
    except CaptureRefusedError as refusal:
        posed = refusal.frames if isinstance(refusal, PosedRefusedError) else None
        return None, _sorted(refusal.findings), posed
    return capture, _sorted(capture.findings), None


def _sorted(findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    order = ("error", "warning", "note")
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))
