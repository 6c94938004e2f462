# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a capture: checks of photographs, masks and the object's place."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Bounds, Finding, View
from robir.capture.refusal import error, note, warning

# distance from the origin, in radii of the object, at which 32-bit numbers lose a texel: their
# steps are 1.2e-4 radii there
FAR = 2000.0
_OBJECT = 128


def check_photographs(views: Sequence[View]) -> list[Finding]:
    """Black, white and repeated photographs, and exposure of the object.

    Args:
        views: Read photographs; where masks are missing, the mask is full.

    Returns:
        Findings.
    """
    found = []
    flat: dict[str, list[str]] = {"black": [], "white": []}
    same: dict[bytes, list[str]] = defaultdict(list)
    for view in views:
        same[hashlib.sha256(view.image_display.tobytes()).digest()].append(view.name)
        pixels = _object_pixels(view)
        if pixels.max() <= 2:
            flat["black"].append(view.name)
        elif pixels.min() >= 253:
            flat["white"].append(view.name)
    for what, names in flat.items():
        if names:
            found.append(
                error(
                    f"all-{what}",
                    f"{len(names)} of {len(views)} photographs are {what} all over the object",
                    "Replace them, or remove them together with their poses.",
                    *names,
                )
            )
    if len(same) == 1 < len(views):
        found.append(
            error(
                "same-photograph",
                f"All {len(views)} photographs are the same one, pixel by pixel, with different "
                "poses: nothing tells how far away anything is",
                "Give the photographs that the poses belong to.",
                views[0].name,
            )
        )
    if found:
        return found
    twins = [name for names in same.values() if len(names) > 1 for name in names]
    if twins:
        found.append(
            warning(
                "duplicate-images",
                f"{len(twins)} of {len(views)} photographs are equal to another, pixel by pixel",
                "Remove the repeated ones; two poses for one photograph contradict each other.",
                *twins,
            )
        )
    return found + _check_exposure(views)


def _check_exposure(views: Sequence[View]) -> list[Finding]:
    found = []
    brightest = {view.name: _object_pixels(view).max(axis=1) for view in views}
    over = [name for name, values in brightest.items() if (values == 255).mean() > 0.05]
    under = [name for name, values in brightest.items() if (values <= 3).mean() > 0.2]
    if over:
        found.append(
            warning(
                "over-exposed",
                f"{len(over)} of {len(views)} photographs are clipped (255) on more than 5 % of "
                f"the object; {100 * clipped_share(views):.1f} % of all object pixels are",
                "Clipped pixels only tell how bright the object is at least; "
                "photograph or render with less exposure.",
                *over,
            )
        )
    if under:
        found.append(
            warning(
                "under-exposed",
                f"{len(under)} of {len(views)} photographs are black on more than 20 % of "
                "the object",
                "Photograph or render with more exposure.",
                *under,
            )
        )
    if has_spike(views):
        found.append(note("clipping", "Object pixels pile up at 255: the tone curve clips"))
    return found


def check_masks(views: Sequence[View]) -> list[Finding]:
    """Empty, full, tiny, inverted and cut-off masks.

    Args:
        views: Photographs with masks.

    Returns:
        Findings.
    """
    shares = {view.name: _share_of(view, float((view.mask >= _OBJECT).sum())) for view in views}
    border = {view.name: _border_share(view) for view in views}
    empty = [name for name, share in shares.items() if share == 0]
    full = [name for name, share in shares.items() if share > 0.999]
    tiny = [name for name, share in shares.items() if 0 < share < 0.005]
    cut = [name for name, share in border.items() if share > 0.02 and name not in full]
    found = [
        note(
            "mask-share",
            f"Masks cover {100 * np.mean(list(shares.values())):.1f} % of the photographs "
            f"({100 * min(shares.values()):.1f} to {100 * max(shares.values()):.1f} %)",
        )
    ]
    for names, what, means in ((empty, "empty", "no"), (full, "full", "every")):
        if names:
            found.append(
                error(
                    f"{what}-masks",
                    f"{len(names)} of {len(views)} masks are {what}: they call {means} pixel "
                    "object",
                    "Draw these masks (white = object), or remove the photographs and poses.",
                    *names,
                )
            )
    if tiny:
        found.append(
            warning(
                "tiny-masks",
                f"{len(tiny)} of {len(views)} masks cover less than 0.5 % of their photographs",
                "Check these masks, or crop the photographs.",
                *tiny,
            )
        )
    centre = np.mean(
        [view.mask[view.mask.shape[0] // 2, view.mask.shape[1] // 2] >= _OBJECT for view in views]
    )
    if np.mean(list(border.values())) > 0.8 and centre < 0.5 and not full:
        found.append(
            warning(
                "inverted-masks",
                "The masks are white at the border and black in the middle",
                "Invert them if they mark the background: white must be the object.",
            )
        )
    elif cut:
        found.append(
            note(
                "cut-off",
                f"The object is cut off by the border of {len(cut)} of {len(views)} photographs",
                *cut,
            )
        )
    return found


def check_place(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """How the object was found, and cameras inside it.

    Args:
        views: Photographs.
        bounds: The object's sphere.

    Returns:
        Findings.
    """
    x, y, z = bounds.centre
    found = [
        note(
            "bounds",
            f"Bounding sphere by {bounds.origin}: centre ({x:.4g}, {y:.4g}, {z:.4g}), "
            f"radius {bounds.radius:.4g}",
        )
    ]
    inside = [
        view.name
        for view in views
        if np.linalg.norm(view.camera.position - bounds.centre) < bounds.radius
    ]
    if inside:
        found.append(
            warning(
                "cameras-inside",
                f"{len(inside)} of {len(views)} cameras are inside the object's bounding sphere",
                "Check that poses and masks belong together; "
                "masks should hold one object, not its surroundings.",
                *inside,
            )
        )
    far = float(np.linalg.norm(bounds.centre))
    if far > FAR * bounds.radius:
        found.append(
            warning(
                "far-from-origin",
                f"The object lies {far:.6g} from the origin and is {2 * bounds.radius:.4g} wide: "
                "files that hold 32-bit numbers cannot tell its details apart there",
                "Export the cameras in local coordinates (not longitude and latitude, not UTM).",
            )
        )
    return found


def clipped_share(views: Iterable[View]) -> float:
    """Share of the object's pixels with a channel at 255."""
    clipped = total = 0
    for view in views:
        pixels = _object_pixels(view)
        clipped += int((pixels == 255).any(axis=1).sum())
        total += len(pixels)
    return clipped / max(total, 1)


def mask_share(views: Iterable[View]) -> float:
    """Mean share of the photographs that the masks cover."""
    return float(np.mean([_share_of(view, float(view.mask.sum()) / 255) for view in views]))


def has_spike(views: Iterable[View]) -> bool:
    """Whether object values pile up at 255 against the ten values below: a clipping curve."""
    counts = np.zeros(256, dtype=np.int64)
    for view in views:
        counts += np.bincount(_object_pixels(view).ravel(), minlength=256)
    below = counts[245:255].mean()
    return bool(counts[255] > 4 * max(below, 1.0) and counts[255] > 0.002 * counts.sum())


def _object_pixels(view: View) -> NDArray[np.uint8]:
    """(N, 3) pixels of the object, or of the whole photograph if the mask is empty."""
    inside = view.mask >= _OBJECT
    return view.image_display[inside] if inside.any() else view.image_display.reshape(-1, 3)


def _share_of(view: View, pixels: float) -> float:
    """Share of the whole photograph that some of its pixels are."""
    width, height = view.camera.whole_size
    return pixels / (width * height)


def _border_share(view: View) -> float:
    """Share of the whole photograph's border that is object; none of it is where it was cut."""
    mask = view.mask >= _OBJECT
    on = sum(float(side.sum()) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    return on / (2.0 * sum(view.camera.whole_size))
