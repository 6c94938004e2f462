# SPDX-License-Identifier: Apache-2.0
"""Environment maps from anybody, looked at before Blender opens them.

Blender dies of a damaged file without a sentence, takes any size, and renders light that is none.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from robir.capture.images.decode import MAX_FILE_BYTES
from robir.capture.images.regular import regular
from robir.errors import UsageError
from robir.evaluation.truth import TooLargeError, read_exr

# largest map; Blender takes sixteen bytes for each texel, and as many while it reads them
MOST_TEXELS = 8192 * 4096
# above any light in watts per square metre and steradian; sums of larger ones are no numbers
_MOST_RADIANCE = 1e12
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
        if not np.isfinite(image[name]).all():
            return f"its channel {name} holds numbers that are not finite"
        if image[name].min() < 0 or image[name].max() > _MOST_RADIANCE:
            low, high = image[name].min(), image[name].max()
            return f"its channel {name} goes from {low:g} to {high:g}"
    return ""


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
