# SPDX-License-Identifier: Apache-2.0
"""Which format a capture has, told from its files' content; the one door to every reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from robir.capture import masks as mask_files
from robir.capture import nerf_synthetic, nerfstudio, transforms
from robir.capture.bounds import bounds_of, sphere_from_masks, sphere_from_points
from robir.capture.capture import Bounds, Capture, Finding, View
from robir.capture.config import CaptureConfig
from robir.capture.findings import check_frames, check_masks, check_photographs, check_place
from robir.capture.frames import IMAGE_SUFFIXES, FrameSet
from robir.capture.refusal import CaptureRefused, error, refuse, warning
from robir.capture.views import Loaded, Progress, load_views, splits

_READING = 0.8
"""Share of the progress that reading the photographs takes."""


def read_frames(source: Path) -> FrameSet:
    """Recognise a capture and read everything but the photographs.

    Args:
        source: Folder of the capture, or its file of poses.

    Returns:
        Posed files.

    Raises:
        CaptureError: If nothing is there, no format fits, or the poses cannot be read.
    """
    if not source.exists():
        raise refuse("no-capture", f"{source} does not exist", "Give the folder of a capture.")
    if source.is_file():
        if transforms.looks_like(source) and source.name != nerf_synthetic.TRAIN:
            return nerfstudio.read(source)
        source = source.parent
    if (source / nerf_synthetic.TRAIN).is_file():
        return nerf_synthetic.read(source)
    if (source / nerfstudio.NAME).is_file():
        return nerfstudio.read(source / nerfstudio.NAME)
    raise _not_recognised(source)


def _not_recognised(source: Path) -> CaptureRefused:
    photographs = [
        path.relative_to(source).as_posix()
        for path in sorted(source.rglob("*"))
        if path.suffix.lower() in IMAGE_SUFFIXES
    ]
    known = (
        "transforms_train.json, transforms.json, a COLMAP model (sparse/0), "
        "cameras_sphere.npz or poses_bounds.npy"
    )
    if not photographs:
        return refuse(
            "no-capture",
            f"{source} holds no capture: there are neither photographs nor camera poses",
            f"Give the folder that holds {known}.",
        )
    return refuse(
        "no-poses",
        f"{source} holds {len(photographs)} photographs but no camera poses",
        "Estimate the poses first, for example with COLMAP, and give the folder that holds "
        f"{known}. Masks will be needed as well (--masks DIR).",
        *photographs,
    )


def read_capture(
    source: Path, masks: Path | None, config: CaptureConfig, progress: Progress | None = None
) -> Capture:
    """Read a capture of any known format and check it.

    Args:
        source: Folder of the capture, or its file of poses; never written to.
        masks: Folder of masks that win over the capture's own, or None.
        config: Settings of the stage.
        progress: Told how far reading is.

    Returns:
        Views in the capture's own frame, the object's bounds, and findings without errors.

    Raises:
        CaptureError: If the capture cannot be reconstructed; a `CaptureRefused` whose findings
            hold everything that was noticed until then.
    """
    tell = progress or (lambda fraction, message: None)
    frames = read_frames(source)
    findings = [*frames.findings, *check_frames(frames)]
    _stop_on_errors(findings)
    chosen = splits(frames.frames, config)
    try:
        drawn = {} if masks is None else mask_files.from_folder(masks, [f for f, _ in chosen])
    except CaptureRefused as refusal:
        raise CaptureRefused([*findings, *refusal.findings]) from None
    loaded = load_views(chosen, drawn, config, lambda share, text: tell(_READING * share, text))
    findings += loaded.findings
    if loaded.views:
        findings += check_photographs(loaded.views)
    findings += _check_mask_supply(loaded)
    _stop_on_errors(findings)
    findings += check_masks(loaded.views)
    _stop_on_errors(findings)
    tell(_READING, "looking for the object")
    bounds, about = find_bounds(frames, loaded.views)
    findings += about
    if bounds is None:
        raise CaptureRefused(findings)
    findings += check_place(loaded.views, bounds)
    tell(1.0, "capture read")
    return Capture(
        source=source,
        format=frames.format,
        views=loaded.views,
        bounds=bounds,
        findings=tuple(findings),
    )


def _check_mask_supply(loaded: Loaded) -> list[Finding]:
    if not loaded.maskless:
        return []
    if len(loaded.maskless) == len(loaded.views):
        message = "The photographs have no masks: nothing says which pixels are the object"
        return [error("no-masks", message, mask_files.HOW_TO_SUPPLY)]
    return [
        error(
            "missing-masks",
            f"{len(loaded.maskless)} of {len(loaded.views)} photographs have no mask",
            mask_files.HOW_TO_SUPPLY,
            *loaded.maskless,
        )
    ]


def find_bounds(
    frames: FrameSet, views: tuple[View, ...]
) -> tuple[Bounds | None, list[Finding]]:
    """The object's bounding sphere, and whether masks and poses agree on it.

    Args:
        frames: Where the format says the object is, if it does.
        views: Photographs with masks.

    Returns:
        Bounds, or None with an error among the findings.
    """
    start = frames.sphere
    if start is None and len(frames.points):
        start = sphere_from_points(frames.points, views)
    hull = sphere_from_masks(views, start)
    if hull is None or np.median(hull.agreement) < 0.5:
        return None, [
            error(
                "masks-disagree",
                "The masks have no object in common: masks and poses do not belong together",
                "Check that masks and photographs are paired rightly, that white is the object, "
                "and that the poses follow the format's axes.",
            )
        ]
    findings = []
    odd = [v.name for v, share in zip(views, hull.agreement, strict=True) if share < 0.8]
    if odd:
        findings.append(
            warning(
                "masks-disagree",
                f"{len(odd)} masks show more than the other masks allow there to be",
                "Check these masks and poses.",
                *odd,
            )
        )
    sphere = hull.sphere
    if start is not None:
        sphere = replace(sphere, origin=f"{sphere.origin}, starting from {start.origin}")
        if start.is_limit and start.radius <= sphere.radius:
            sphere = start
    return bounds_of(sphere), findings


def _stop_on_errors(findings: list[Finding]) -> None:
    if any(finding.level == "error" for finding in findings):
        raise CaptureRefused(findings)
