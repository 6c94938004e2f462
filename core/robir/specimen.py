# SPDX-License-Identifier: Apache-2.0
"""The tiny capture of `robir selftest`, and the fit that is judged by it.

A two-coloured diffuse sphere under a uniform sky and one sun, whose radiance has a closed form:
albedo / pi (pi sky + sun max(n.l, 0)). The real stages run on it with small settings; the
photographs kept aside and the direction of the sun tell whether the result is any good.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from robir.config import RunConfig, resolve
from robir.errors import QualityError
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths.tone import srgb_from_linear
from robir.maths.vectors import fibonacci_sphere
from robir.pipeline.device import Execution
from robir.pipeline.runner import RunRequest, load_stages, reconstruct

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

CENTRE = np.array([0.3, -0.2, 0.5])
RADIUS = 0.6
SUN_DIRECTION = np.array([2.0, -1.0, 2.0]) / 3.0
SUN = np.array([2.6, 2.4, 2.0])
SKY = np.array([0.25, 0.28, 0.35])
ALBEDO = np.array([[0.6, 0.3, 0.2], [0.2, 0.35, 0.5]])

SIDE = 56
DISTANCE = 3.0
FOCAL = 1.6 * SIDE
SUBPIXELS = 4
VIEWS = {"train": 14, "test": 3}

# a run cut down to a few CPU seconds
SETTINGS = (
    f"geometry.image_side={SIDE}",
    "geometry.hull_cells=32",
    "geometry.level_cells=[32]",
    "geometry.level_steps=[100]",
    "geometry.rays=512",
    "geometry.face_budget=800",
    "geometry.stereo_side=0",
    "transport.num_surfels=1200",
    "transport.num_directions=128",
    f"transport.observation_side={SIDE}",
    "appearance.num_soft_lobes=12",
    "appearance.num_scan_directions=200",
    "appearance.num_solve_surfels=800",
    "appearance.iterations=40",
    "appearance.texture_size=128",
    "export.renders=false",
)

# dB on the views kept aside; a sound fit reaches 24.7, one of mirrored photographs 18.2
LOWEST_PSNR = 21.0

FARTHEST_SUN = 15.0  # degrees; a sound fit is 3 off


def write_specimen(folder: Path) -> None:
    """Write the sphere as a NeRF-synthetic capture, poses and one folder of pictures a split."""
    for split, count in VIEWS.items():
        (folder / split).mkdir(parents=True)
        frames = []
        # the spiral's ends lie on the poles, where up is no direction
        for index, back in enumerate(fibonacci_sphere(count + 2).double().numpy()[1:-1]):
            pose, name = _pose(back), f"./{split}/view_{index:02d}"
            codes = np.round(255.0 * photograph(pose)).astype(np.uint8)
            Image.fromarray(codes).save(folder / f"{name}.png")
            frames.append({"file_path": name, "transform_matrix": pose.tolist()})
        angle = 2.0 * math.atan(0.5 * SIDE / FOCAL)
        write_json(folder / f"transforms_{split}.json", {"camera_angle_x": angle, "frames": frames})


def photograph(pose: Array) -> Array:
    """The sphere through the sRGB curve, (SIDE, SIDE, 4) display values and coverage in [0, 1].

    `pose` (4, 4) is camera to world, OpenGL axes.
    """
    place = (np.arange(SIDE * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5 * SIDE
    x, y = np.meshgrid(place / FOCAL, -place / FOCAL)
    ray = np.stack([x, y, np.full_like(x, -1.0)], axis=-1) @ pose[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    origin = pose[:3, 3] - CENTRE
    nearest = ray @ origin
    half_chord_squared = nearest**2 - origin @ origin + RADIUS**2
    hit = half_chord_squared > 0.0
    distance = -nearest - np.sqrt(half_chord_squared.clip(0.0))
    normal = (origin + distance[..., None] * ray) / RADIUS
    albedo = ALBEDO[(normal.prod(axis=-1) > 0.0).astype(int)]
    irradiance = math.pi * SKY + SUN * (normal @ SUN_DIRECTION).clip(0.0)[..., None]
    radiance = np.where(hit[..., None], albedo / math.pi * irradiance, 0.0)
    coverage = _reduced(hit[..., None].astype(np.float64))
    colour = _reduced(radiance) / coverage.clip(1e-6)
    return np.concatenate([srgb_from_linear(torch.from_numpy(colour)).numpy(), coverage], axis=-1)


def _reduced(fine: Array) -> Array:
    """Mean over the subpixels of each pixel."""
    return fine.reshape(SIDE, SUBPIXELS, SIDE, SUBPIXELS, -1).mean(axis=(1, 3))


def _pose(back: Array) -> Array:
    """Camera to world of a camera that looks at the sphere from a direction, upright."""
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = CENTRE + DISTANCE * back
    return pose


def judged_fit(execution: Execution, progress: Progress) -> float:
    """Run the stages in a temporary folder; dB on the held-out views.

    `QualityError` if the result is bad.
    """
    with tempfile.TemporaryDirectory(prefix="robir-selftest-") as name:
        capture, paths = Path(name) / "capture", JobPaths(Path(name) / "out")
        write_specimen(capture)
        request = RunRequest(
            source=capture,
            masks=None,
            out=paths.root,
            config=resolve(RunConfig(), None, SETTINGS),
            execution=execution,
            is_resume=False,
        )
        reconstruct(request, _Watcher(progress), load_stages())
        psnr = read_json(paths.report_json)["held_out"]["psnr"]
        angle = _sun_error(read_json(paths.light)["lobes"])
    # written so that a number that is none fails
    if not (psnr >= LOWEST_PSNR and angle <= FARTHEST_SUN):
        raise QualityError(
            f"a small fit ended badly: {psnr:.1f} dB where {LOWEST_PSNR:.0f} are expected, the sun "
            f"{angle:.0f} degrees off; try the processor as device, or install the engine again"
        )
    return round(psnr, 2)


def _sun_error(lobes: list[dict[str, Any]]) -> float:
    """Degrees between the true sun and the strongest sharp lobe; 180 where there is none."""
    suns = [lobe for lobe in lobes if lobe["kind"] == "sharp"]
    if not suns:
        return 180.0
    strongest = max(suns, key=lambda lobe: sum(lobe["amplitude"]) / lobe["sharpness"])
    return math.degrees(math.acos(np.clip(np.dot(strongest["axis"], SUN_DIRECTION), -1.0, 1.0)))


class _Watcher:
    """Shows a run as its share and a few words."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:  # noqa: ARG002
        """See `robir.pipeline.reporter.Display.event`."""
        if event["stage"] and event["kind"] != "metric":
            self._progress(fraction, event["message"])
