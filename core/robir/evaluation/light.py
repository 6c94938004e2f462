# SPDX-License-Identifier: Apache-2.0
"""Reads the recovered light, and looks at environment maps from anybody.

Blender dies of a damaged map without a sentence, takes any size, and renders light that is none.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import torch
from numpy.typing import NDArray

from robir.capture.images.decode import MAX_FILE_BYTES
from robir.errors import StorageError, UsageError
from robir.evaluation.layers import stored_facts
from robir.jobs.names import regular
from robir.jobs.records import NUMBERS
from robir.maths import spherical_gaussian as sg
from robir.maths.vectors import equirect_directions

Array = NDArray[np.floating[Any]]
_MAX_NUMBERS = 400_000_000  # of an EXR over all channels; a sky of 8192 columns has a quarter of it

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_CHUNK_ROWS = 64
_LOBE = {"axis": NUMBERS, "sharpness": float, "amplitude": NUMBERS, "kind": str}
_LIGHT = {"lobes": [_LOBE], "distance_radii?": float}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveredLight:
    """The lobes of light.json."""

    lobes: sg.SphericalGaussians  # world-space mixture; amplitude is radiance, linear Rec.709
    is_sharp: NDArray[np.bool_]  # (K,) bool, suns and lamps as opposed to sky
    # radius of the sphere about the thing that they shine from, radii of its bounds
    distance: float = math.inf

    def power(self) -> Array:
        """Luminance of each lobe integrated over the sphere, (K,)."""
        return sg.integral(self.lobes).numpy() @ LUMINANCE

    def strongest_direction(self) -> Array | None:
        """Axis (3,) of the sharp lobe of the greatest power, or None without sharp lobes."""
        if not self.is_sharp.any():
            return None
        strongest = int(np.argmax(np.where(self.is_sharp, self.power(), -np.inf)))
        return self.lobes.axis[strongest].numpy()

    def environment(self, rows: int) -> NDArray[np.float32]:
        """Lat-long image (rows, 2 rows, 3) in Blender's world frame, linear Rec.709 radiance.

        Lobes wider than four texels are evaluated at the texels' centres (energy to 1 in 1000);
        narrower ones are integrated over the texels, which keeps all of their energy.
        """
        wide = self.lobes.sharpness < (rows / (4 * np.pi)) ** 2
        image = np.empty((rows, 2 * rows, 3), np.float32)
        directions = equirect_directions(rows)
        for start in range(0, rows, _CHUNK_ROWS):
            part = slice(start, start + _CHUNK_ROWS)
            image[part] = sg.evaluate(self.chosen(wide), directions[part]).numpy()
        if not bool(wide.all()):
            image += sg.to_equirect(self.chosen(~wide), rows).numpy()
        return image

    def chosen(self, which: torch.Tensor) -> sg.SphericalGaussians:
        """Some of the lobes."""
        axis, sharpness, amplitude = self.lobes.axis, self.lobes.sharpness, self.lobes.amplitude
        parts = {"axis": axis[which], "sharpness": sharpness[which], "amplitude": amplitude[which]}
        return sg.SphericalGaussians(**parts)


def load_light(path: Path) -> RecoveredLight:
    """Read a light.json, or a `StorageError`."""
    facts = stored_facts(path, _LIGHT)
    table = facts["lobes"]
    if any(len(lobe["axis"]) != 3 or len(lobe["amplitude"]) != 3 for lobe in table):
        fault = "an axis or amplitude has not three numbers"
        raise StorageError(f"{path} is damaged ({fault}); reconstruct with --resume")

    def column(name: str) -> torch.Tensor:
        return torch.tensor([lobe[name] for lobe in table], dtype=torch.float32)

    return RecoveredLight(
        lobes=sg.SphericalGaussians(
            axis=column("axis").reshape(-1, 3),
            sharpness=column("sharpness"),
            amplitude=column("amplitude").reshape(-1, 3),
        ),
        is_sharp=np.array([lobe["kind"] == "sharp" for lobe in table], bool),
        distance=facts.get("distance_radii", math.inf),
    )


class TooLargeError(ValueError):
    """A picture has more numbers than are read."""


def read_exr(path: Path, most: int = _MAX_NUMBERS) -> dict[str, NDArray[np.float32]]:
    """All channels of an EXR by name, (H, W) float32; `TooLargeError` above `most` numbers."""
    with regular(path, MAX_FILE_BYTES), OpenEXR.File(str(path), header_only=True) as opened:
        header = opened.header()
        low, high = header["dataWindow"]
        sides = [int(last) - int(first) + 1 for first, last in zip(low, high, strict=True)]
        if math.prod(sides) * len(header["channels"]) > most:
            raise TooLargeError(f"it has {sides[0]} by {sides[1]} pixels")
    with OpenEXR.File(str(path), separate_channels=True) as opened:
        return {name: np.asarray(c.pixels, np.float32) for name, c in opened.channels().items()}


MOST_TEXELS = 8192 * 4096  # Blender takes sixteen bytes for each, twice while it reads them
_MOST_RADIANCE = 1e12  # W/(m2 sr), above any light; sums of larger ones are no numbers
# of the light that may lie below 0: colours outside of Rec.709, as Blender's own maps have, come
# to a millionth
_MOST_BELOW = 1e-3
_HDR_HEAD_BYTES = 1 << 16
_HDR_SIZE = re.compile(rb"\n[-+][XY] (\d{1,9}) [-+][XY] (\d{1,9})\n")


def refuse_light(path: Path) -> None:
    """Refuse an .exr or .hdr that is damaged, too large or no light, by a `UsageError`."""
    suffix = path.suffix.lower()
    try:
        fault = {".exr": _exr_fault, ".hdr": _hdr_fault}.get(suffix, lambda _: "")(path)
    except TooLargeError as error:
        fault = f"{error}, and up to 8192 by 4096 are taken"
    except Exception as error:  # a foreign parser on foreign bytes may raise anything
        reason = error.strerror if isinstance(error, OSError) else "it is cut off or damaged"
        fault = f"it cannot be read ({reason})"
    if fault:
        raise UsageError(f"{path} is no light: {fault}; give another map with --environment")


def _exr_fault(path: Path) -> str:
    image = read_exr(path, 4 * MOST_TEXELS)
    colours = {name for name in image if name.rpartition(".")[2].upper() in tuple("RGBY")}
    if not colours:
        return f"it has no colours, only {', '.join(sorted(image))[:80]}"
    for name in colours:
        values = image[name]
        if not np.isfinite(values).all():
            return f"its channel {name} holds numbers that are not finite"
        low, high = values.min(), values.max()
        if high > _MOST_RADIANCE or (low < 0 and _share_below(values) > _MOST_BELOW):
            return f"its channel {name} goes from {low:g} to {high:g}"
    return ""


def _share_below(values: NDArray[np.float32]) -> float:
    """Sum of what lies below 0, some of which does, against the sum of what lies above."""
    above = values.clip(min=0).sum(dtype=np.float64)
    below = -values.clip(max=0).sum(dtype=np.float64)
    return float(below / above) if above > 0 else np.inf


def _hdr_fault(path: Path) -> str:
    with regular(path, MAX_FILE_BYTES) as file:
        head = file.read(_HDR_HEAD_BYTES)
    size = _HDR_SIZE.search(head)
    if not head.startswith(b"#?") or size is None:
        return "its header is none of a Radiance picture"
    first, second = int(size[1]), int(size[2])
    if not 0 < first * second <= MOST_TEXELS:
        return f"it has {first} by {second} texels, and up to 8192 by 4096 are taken"
    return ""
