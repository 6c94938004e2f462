# SPDX-License-Identifier: Apache-2.0
"""The result under another light, beside the true scene under that light.

`robir relight OUT --environment CAPTURE/truth/second_light.exr` makes the pictures, in Cycles; the
truth has the true scene's radiance. Pictures go back to radiance by the recovered tone curve, which
they were shown through: neither its errors nor those of the recovered light count here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.evaluation import metrics
from robir.evaluation.layers import TONE_CURVE, stored_facts
from robir.evaluation.photos import read_picture
from robir.evaluation.truth import TrueView, Truth, read_exr
from robir.jobs.paths import JobPaths
from robir.maths import tone

Array = NDArray[np.floating[Any]]

LIGHT = "second_light"  # name, without suffix, of the map beside the truth
WHOLE = 254  # code of alpha from which a pixel is wholly the object's
_WHOLE_SHARE = 0.999


def second_light(capture: Path) -> Path | None:
    """The map under which a rendered capture was rendered once more, or None."""
    file = capture / "truth" / f"{LIGHT}.exr"
    return file if file.is_file() else None


def relit_picture(paths: JobPaths, view: str) -> Path:
    """Where `robir relight` leaves a test view under the second light."""
    return paths.renders / f"relit_{LIGHT}_test_{view}.png"


def relight_scores(paths: JobPaths, truth: Truth) -> dict[str, Any] | None:
    """PSNR of relit radiance over the pixels that are wholly object in result and truth.

    "psnr_srgb" and "psnr_linear" by alignment and "scale", as of `metrics.albedo_scores`, radiance
    clipped to [0, 1]; "views" that were compared. None where nothing was relit.
    """
    facts = stored_facts(paths.stage("appearance") / "tone_curve.json", TONE_CURVE)
    curve = tone.curve_from_name(facts["family"], facts["parameters"])
    pairs = [_radiance(paths, truth, view, curve) for view in truth.views]
    known = [pair for pair in pairs if pair is not None]
    if not known:
        return None
    ours, true = (np.concatenate([pair[i] for pair in known]) for i in (0, 1))
    return metrics.albedo_scores(ours, np.clip(true, 0.0, 1.0)) | {"views": len(known)}


def _radiance(
    paths: JobPaths, truth: Truth, view: TrueView, curve: tone.AbstractToneCurve
) -> tuple[Array, Array] | None:
    """Radiance (N, 3) of the result and of the truth over the pixels that count."""
    picture = relit_picture(paths, view.name)
    file = truth.root / "truth" / "relit" / f"{view.name}.exr"
    if not (picture.is_file() and file.is_file()):
        return None
    codes, planes = read_picture(picture), read_exr(file)
    if codes.shape != (*view.hit.shape, 4):
        return None
    shown = torch.from_numpy(codes[..., :3].astype(np.float32) / 255)
    ours = curve.linear_from_display(shown).numpy()
    true = np.stack([planes[f"radiance.{axis}"] for axis in "RGB"], axis=-1)
    both = view.hit & (planes["mask"] > _WHOLE_SHARE) & (codes[..., 3] >= WHOLE)
    return (ours[both], true[both]) if both.any() else None
