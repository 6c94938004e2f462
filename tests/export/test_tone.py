# SPDX-License-Identifier: Apache-2.0
"""The plot of the recovered tone curve."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from robir.export import tone_lut as plotted
from robir.jobs.paths import JobPaths, write_json
from robir.maths import tone


def test_the_plot_shows_the_chosen_curve_where_it_runs(tmp_path: Path) -> None:
    paths = JobPaths(tmp_path)
    for folder in (paths.stage("appearance"), paths.tone_plot.parent):
        folder.mkdir(parents=True)
    row = {"score": 1.0, "standard_error": None, "albedo_apart": None}
    candidates = [{"family": name, **row} for name in ("agx", "filmic", "standard")]
    table = {"family": "filmic", "parameters": {}, "candidates": candidates, "clipped_share": 0.0}
    table |= {"blender_view_transform": "Filmic", "exposure": 0.0}
    write_json(paths.stage("appearance") / "tone_curve.json", table)
    samples = plotted.export_tone_curve(paths)["samples"]
    picture = np.asarray(Image.open(paths.tone_plot)).astype(int)
    accent = np.array([0xC8, 0x50, 0x2D])
    curve = tone.curve_from_name("filmic", {})
    assert samples == tone.as_samples(curve, len(samples["linear"]))
    # the axes as the picture has them: 2^-10 and 2^4 at its ends, codes 0 and 1 below and above
    for linear, display in [*zip(samples["linear"], samples["display"], strict=True)][4:-4:12]:
        column = 92 + (np.log2(linear) + 10) / 14 * (786 - 92)
        row = 432 - display * (432 - 40)
        shown = picture[round(row) - 1 : round(row) + 2, round(column)]
        assert (np.abs(shown - accent).max(1) < 60).any()


def test_no_plotting_library_is_loaded_for_a_run() -> None:
    told = "import sys, robir.export.stage; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", told], check=False).returncode == 0
