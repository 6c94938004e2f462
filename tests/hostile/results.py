# SPDX-License-Identifier: Apache-2.0
"""A small result folder as a finished run leaves it, as far as its readers look."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robir.capture.capture import Bounds, Capture, View
from robir.capture.store import save_capture
from robir.jobs.paths import JobPaths, write_json
from robir.jobs.status import StatusWriter


def write_result(root: Path, shots: list) -> JobPaths:
    """Status, worker, run, manifest and capture stage."""
    paths = JobPaths(root)
    root.mkdir()
    StatusWriter(paths).status("done", stage="", fraction=1.0, message="done", exit_code=0)
    write_json(paths.worker, {"started": 1.0, "pid": 2**22, "status_before": None})
    paths.log.write_text("said\n")
    paths.worker_log.write_text('{"kind": "failed", "message": "no", "exit_code": 3}\n')
    capture = {"fingerprint": "0", "name": "c", "place": "0", "masks": None}
    run = {"state": "done", "capture": capture, "peak_memory_bytes": {}}
    run |= {"seconds": {"capture": {"wall": 1.0, "cpu": 1}}}
    run |= {"warnings": [{"stage": "capture", "message": "few views"}]}
    write_json(paths.run, run)
    save_capture(paths.stage("capture"), _capture(shots))
    write_json(paths.manifest("capture"), {"fingerprint": "f", "metrics": {}, "outputs": {}})
    np.savez_compressed(paths.stage("capture") / "arrays.npz", a=np.eye(3), b=np.arange(4))
    return paths


def _capture(shots: list) -> Capture:
    views = [
        View(
            name=f"v{i}",
            image_display=np.ascontiguousarray(shot.rgba[:, :, :3]),
            mask=np.ascontiguousarray(shot.rgba[:, :, 3]),
            camera=shot.camera,
            split="train",
        )
        for i, shot in enumerate(shots)
    ]
    bounds = Bounds(centre=np.zeros(3), radius=1.0, origin="told")
    return Capture(source=Path("/c"), format="neus", views=tuple(views), bounds=bounds)
