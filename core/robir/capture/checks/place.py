# SPDX-License-Identifier: Apache-2.0
"""Where the object is, and whether masks and poses agree on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robir.capture.bounds import Hull, bounds_of, sphere_from_masks, sphere_from_points
from robir.capture.capture import Bounds, Finding, View
from robir.capture.frames import FrameSet, posed_otherwise
from robir.capture.refusal import error, note, warning

Views = tuple[View, ...]

# right masks and poses reach 0.99 and more; below this, something is likely to be wrong
GOOD_AGREEMENT = 0.97
# below this median share of a mask explained by the others, masks and poses do not fit
MIN_AGREEMENT = 0.8


def place_object(frames: FrameSet, views: Views) -> tuple[Views, Bounds | None, list[Finding]]:
    """Find the object's bounding sphere from the masks of the train views.

    Returns:
        Views (with the poses in the order that fits), bounds or None, and findings; without
        bounds there is an error among them.
    """
    hull = _hull(frames, views)
    findings: list[Finding] = []
    if frames.other_order:
        others = _with_other_poses(frames, views)
        other_hull = _hull(frames, others)
        shares = [0.0 if h is None else h.strict for h in (hull, other_hull)]
        used = int(shares[1] > shares[0])
        if used:
            hull, views = other_hull, others
        order = ("names as text", "numbers")[used]
        message = f"Poses belong to the photographs in order of their {order}: their masks agree "
        message += f"to {100 * shares[used]:.0f} %, in the other order to "
        findings.append(note("pose-order", message + f"{100 * shares[1 - used]:.0f} %"))
    if hull is None or np.median(hull.agreement) < MIN_AGREEMENT:
        message = "The masks have no object in common: masks and poses do not belong together"
        cure = "Check that masks and photographs are paired rightly, that white is the object, "
        cure += "and that the poses follow the format's axes."
        findings.append(error("masks-disagree", message, cure))
        return views, None, findings
    if hull.strict < GOOD_AGREEMENT:
        message = f"What all masks allow to be there explains only {100 * hull.strict:.0f} % of a "
        cure = "Check that masks and photographs are paired rightly and that the poses are good."
        findings.append(warning("masks-disagree", message + "mask", cure))
    train = [view for view in views if view.split == "train"]
    odd = [v.name for v, share in zip(train, hull.agreement, strict=True) if share < 0.8]
    if odd:
        message = f"{len(odd)} of {len(train)} masks show more than the others leave room for"
        findings.append(warning("odd-masks", message, "Check these masks and poses.", *odd))
    sphere = hull.sphere
    start = frames.sphere
    if start is not None and start.is_limit:
        sphere = replace(sphere, origin=f"{sphere.origin}, inside {start.origin}")
        if start.radius <= sphere.radius:
            sphere = start
    return views, bounds_of(sphere), findings


def _hull(frames: FrameSet, views: Views) -> Hull | None:
    train = [view for view in views if view.split == "train"]
    start = frames.sphere
    if start is None and len(frames.points):
        start = sphere_from_points(frames.points, train)
    return sphere_from_masks(train, start)


def _with_other_poses(frames: FrameSet, views: Views) -> Views:
    by_name = {frame.name: frame for frame in frames.other_order}
    return tuple(
        replace(view, camera=posed_otherwise(view.camera, by_name[view.name])) for view in views
    )
