# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a capture.

Its counts, files, poses and lenses are looked at before a pixel is read; then its photographs, its
masks and the object's place.
"""

from __future__ import annotations

import hashlib
import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robir.capture.bounds import Hull, sphere_from_masks, sphere_from_points
from robir.capture.capture import Bounds, Finding, Level, View
from robir.capture.frames import Frame, FrameSet, pose_fault, posed_otherwise
from robir.capture.masks.given import IGNORE
from robir.capture.readers.files import children, without_others
from robir.capture.refusal import error, note, some, warning

MIN_VIEWS = 3  # fewer views cannot fix a surface
MAX_VIEWS = 2000  # ten times as many as any object needs, and each takes time
FEW_VIEWS = 12  # below this many views, hidden sides stay guesses
_EXPLAINED = 0.8  # share of a mask that the hull explains at least
_SIDES_CURE = "Leave out the wrong ones, or set the intrinsics right."


def check_frames(frames: FrameSet) -> list[Finding]:
    """Counts, missing files, poses and focal lengths; with an error, reading on is useless."""
    everything = frames.frames
    tests = sum(frame.split == "test" for frame in everything)
    trains = len(everything) - tests
    message = f"{frames.format} capture with {len(everything)} posed photographs"
    found = [note("counts", message + (f", {tests} of them test views" if tests else ""))]
    if trains < MIN_VIEWS:
        message = f"{frames.root} has {trains} posed photographs to learn from; "
        message += f"at least {MIN_VIEWS} are needed, 30 or more are good"
        found.append(error("too-few-views", message, "Add photographs from other directions."))
    elif trains < FEW_VIEWS:
        cure = "Expect guesses on sides that few views see; 30 or more views are good."
        found.append(warning("few-views", f"Only {trains} views to learn from", cure))
    found += check_count(len(everything))
    missing = [frame.relative for frame in everything if not frame.image.is_file()]
    message = f"{len(missing)} of {len(everything)} posed photographs are missing below "
    cure = "Put the photographs there under the names the poses use, or do without them with "
    cure += "--skip-missing."
    found += some("error", "missing-images", missing, f"{message}{frames.root}", cure)
    unposed = [] if missing else _check_unposed(frames)
    return found + unposed + _check_poses(everything) + _check_lenses(everything)


def check_count(photographs: int) -> list[Finding]:
    """Whether there are more photographs than can be read in a sane time."""
    if photographs <= MAX_VIEWS:
        return []
    message = f"There are {photographs} photographs; at most {MAX_VIEWS} are read"
    return [error("too-many-views", message, "Keep every n-th of them: 200 show an object well.")]


def _check_unposed(frames: FrameSet) -> list[Finding]:
    """Photographs beside posed ones that have no pose themselves."""
    # NeRF-synthetic keeps depth and normal pictures beside the photographs; where the poses were
    # estimated here, what has none was named then.
    if frames.has_frame_of_ours or frames.format in ("nerf-synthetic", "nerfactor"):
        return []
    images = [frame.image for frame in frames.frames]
    masks = [frame.mask for frame in frames.frames if frame.mask is not None]
    used = {os.path.normpath(path) for path in (*images, *masks)}
    suffixes = {path.suffix.lower() for path in images}
    beside = [
        path.name
        for folder in sorted({path.parent for path in images})
        for path in without_others(children(folder))
        if path.suffix.lower() in suffixes
        and os.path.normpath(path) not in used
        and not path.name.startswith(IGNORE)
    ]
    message = f"{len(beside)} photographs have no pose and are left out"
    cure = "If they show sides that no other does, estimate poses that include them."
    return some("warning", "unposed-images", beside, message, cure)


def _check_poses(frames: Sequence[Frame]) -> list[Finding]:
    faults: dict[str, list[str]] = defaultdict(list)
    places: dict[bytes, list[str]] = defaultdict(list)
    for frame in frames:
        fault = pose_fault(frame.camera_to_world)
        if fault is not None:
            faults[fault].append(frame.relative)
        else:
            places[np.round(frame.camera_to_world, 9).tobytes()].append(frame.relative)
    found = []
    for fault, names in faults.items():
        message = f"The pose of {len(names)} of {len(frames)} photographs {fault}"
        cure = "Estimate the poses again, or remove these photographs."
        found.append(error("bad-pose", message, cure, *names))
    twins = [name for names in places.values() if len(names) > 1 for name in names]
    message = f"{len(twins)} of {len(frames)} photographs share their pose with another"
    cure = "Remove repeated photographs; if they differ, their poses are wrong."
    return found + some("warning", "duplicate-poses", twins, message, cure)


def _check_lenses(frames: Sequence[Frame]) -> list[Finding]:
    absurd = [frame.relative for frame in frames if not frame.lens.is_sane]
    if absurd:
        message = f"{len(absurd)} of {len(frames)} photographs have a focal length or field of view"
        return [error("bad-intrinsics", message + " that no camera has", _SIDES_CURE, *absurd)]
    stated = [(f.lens.fx, f.relative) for f in frames if f.lens.fx is not None]
    angles = [(f.lens.angle_x, f.relative) for f in frames if f.lens.fx is None]
    stated += [(1 / angle, name) for angle, name in angles if angle is not None]
    middle = float(np.median([value for value, _ in stated])) if stated else 1.0
    odd = [name for value, name in stated if not 0.5 <= value / middle <= 2]
    message = f"{len(odd)} of {len(frames)} photographs have a focal length less than half "
    message += "or more than twice that of the others"
    return some("warning", "focal-lengths", odd, message, _SIDES_CURE)


FAR = 2000.0  # radii from the origin at which 32-bit numbers lose a texel (1.2e-4 radii)
_OBJECT = 128
Views = tuple[View, ...]

GOOD_AGREEMENT = 0.97  # right masks and poses reach 0.99; below, something is likely wrong
MIN_AGREEMENT = 0.8  # below this median share that others explain, masks and poses do not fit


def check_photographs(views: Sequence[View]) -> list[Finding]:
    """Black, white and repeated photographs, and the object's exposure; masks may be full."""
    total, same = len(views), defaultdict[bytes, list[str]](list)
    objects = {view.name: _object_pixels(view) for view in views}
    for view in views:
        same[hashlib.sha256(view.image_display.tobytes()).digest()].append(view.name)
    black = [name for name, pixels in objects.items() if pixels.max() <= 2]
    white = [name for name, pixels in objects.items() if pixels.min() >= 253]
    cure = "Replace them, or remove them together with their poses."
    message = "photographs are {} all over the object"
    found = _of("error", "all-black", black, total, message.format("black"), cure)
    found += _of("error", "all-white", white, total, message.format("white"), cure)
    if len(same) == 1 < total:
        message = f"All {total} photographs are the same one, pixel by pixel, with different "
        message += "poses: nothing tells how far away anything is"
        cure = "Give the photographs that the poses belong to."
        found.append(error("same-photograph", message, cure, views[0].name))
    if found:
        return found
    twins = [name for names in same.values() if len(names) > 1 for name in names]
    cure = "Remove the repeated ones; two poses for one photograph contradict each other."
    message = "photographs are equal to another, pixel by pixel"
    found = _of("warning", "duplicate-images", twins, total, message, cure)
    brightest = {name: pixels.max(axis=1) for name, pixels in objects.items()}
    over = [name for name, values in brightest.items() if (values == 255).mean() > 0.05]
    under = [name for name, values in brightest.items() if (values <= 3).mean() > 0.2]
    message = "photographs are clipped (255) on more than 5 % of the object; "
    message += f"{100 * clipped_share(views):.1f} % of all object pixels are"
    cure = "Clipped pixels only tell how bright the object is at least; photograph or render with "
    found += _of("warning", "over-exposed", over, total, message, cure + "less exposure.")
    message = "photographs are black on more than 20 % of the object"
    cure = "Photograph or render with more exposure."
    found += _of("warning", "under-exposed", under, total, message, cure)
    if has_spike(views):
        found.append(note("clipping", "Object pixels pile up at 255: the tone curve clips"))
    return found


def check_masks(views: Sequence[View]) -> list[Finding]:
    """Empty, full, tiny, inverted and cut-off masks."""
    total = len(views)
    shares = {view.name: _share_of(view, float((view.mask >= _OBJECT).sum())) for view in views}
    border = {view.name: _border_share(view) for view in views}
    empty = [name for name, share in shares.items() if share == 0]
    full = [name for name, share in shares.items() if share > 0.999]
    tiny = [name for name, share in shares.items() if 0 < share < 0.005]
    cut = [name for name, share in border.items() if share > 0.02 and name not in full]
    percent = [100 * share for share in shares.values()]
    message = f"Masks cover {np.mean(percent):.1f} % of the photographs "
    found = [note("mask-share", message + f"({min(percent):.1f} to {max(percent):.1f} %)")]
    cure = "Draw these masks (white = object), or remove the photographs and poses."
    message = "masks are empty: they call no pixel object"
    found += _of("error", "empty-masks", empty, total, message, cure)
    message = "masks are full: they call every pixel object"
    found += _of("error", "full-masks", full, total, message, cure)
    message = "masks cover less than 0.5 % of their photographs"
    cure = "Check these masks, or crop the photographs."
    found += _of("warning", "tiny-masks", tiny, total, message, cure)
    middles = [view.mask[view.mask.shape[0] // 2, view.mask.shape[1] // 2] for view in views]
    centre = np.mean(np.array(middles) >= _OBJECT)
    if np.mean(list(border.values())) > 0.8 and centre < 0.5 and not full:
        message = "The masks are white at the border and black in the middle"
        cure = "Invert them if they mark the background: white must be the object."
        return [*found, warning("inverted-masks", message, cure)]
    message = "photographs cut the object off at their border"
    return found + _of("note", "cut-off", cut, total, message)


def check_place(views: Sequence[View], bounds: Bounds) -> list[Finding]:
    """How the object was found, and cameras inside it."""
    x, y, z = bounds.centre
    message = f"Bounding sphere by {bounds.origin}: centre ({x:.4g}, {y:.4g}, {z:.4g}), "
    found = [note("bounds", message + f"radius {bounds.radius:.4g}")]
    away = [np.linalg.norm(view.camera.position - bounds.centre) for view in views]
    inside = [v.name for v, d in zip(views, away, strict=True) if d < bounds.radius]
    cure = "Check that poses and masks belong together; "
    cure += "masks should hold one object, not its surroundings."
    message = "cameras are inside the object's bounding sphere"
    found += _of("warning", "cameras-inside", inside, len(views), message, cure)
    far = float(np.linalg.norm(bounds.centre))
    if far > FAR * bounds.radius:
        message = f"The object lies {far:.6g} from the origin and is {2 * bounds.radius:.4g} wide: "
        message += "files that hold 32-bit numbers cannot tell its details apart there"
        cure = "Export the cameras in local coordinates (not longitude and latitude, not UTM)."
        found.append(warning("far-from-origin", message, cure))
    return found


def _of(
    level: Level, code: str, names: Sequence[str], total: int, message: str, cure: str = ""
) -> list[Finding]:
    """A finding about some of all photographs; none where there are none."""
    return some(level, code, names, f"{len(names)} of {total} {message}", cure)


def place_object(frames: FrameSet, views: Views) -> tuple[Views, Bounds | None, list[Finding]]:
    """The object's sphere by masks of train views, with the right poses; or None and an error."""
    hull = _hull(frames, views)
    findings: list[Finding] = []
    if frames.other_order:
        stated = {frame.name: frame for frame in frames.other_order}
        moved = [posed_otherwise(view.camera, stated[view.name]) for view in views]
        others = tuple(replace(v, camera=c) for v, c in zip(views, moved, strict=True))
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
        cure = "Check that masks and photographs are paired rightly and that white is the object. "
        if frames.has_frame_of_ours:
            cure += "The poses were estimated here and may be wrong: put the object on a patterned "
            cure += "cloth that stays in place, and photograph from more places."
        else:
            cure += "Check that the poses follow the format's axes."
        findings.append(error("masks-disagree", message, cure))
        return views, None, findings
    views, hull, about = _without_misplaced(frames, views, hull)
    findings += about
    if hull.strict < GOOD_AGREEMENT:
        message = f"What all masks allow to be there explains only {100 * hull.strict:.0f} % of a "
        cure = "Check that masks and photographs are paired rightly and that the poses are good."
        findings.append(warning("masks-disagree", message + "mask", cure))
    train, odd = _train(views), _odd(views, hull)
    message, cure = "masks show more than the others leave room for", "Check these masks and poses."
    findings += _of("warning", "odd-masks", odd, len(train), message, cure)
    sphere = hull.sphere
    start = frames.sphere
    if start is not None and start.is_limit:
        sphere = replace(sphere, origin=f"{sphere.origin}, inside {start.origin}")
        if start.radius <= sphere.radius:
            sphere = start
    return views, replace(sphere, is_limit=False), findings


def _train(views: Views) -> Views:
    """The views that are fitted, whose masks make the hull."""
    return tuple(view for view in views if view.split == "train")


def _odd(views: Views, hull: Hull) -> list[str]:
    """Names of views that a hull does not explain the masks of."""
    pairs = zip(_train(views), hull.agreement, strict=True)
    return [view.name for view, share in pairs if share < _EXPLAINED]


def _without_misplaced(
    frames: FrameSet, views: Views, hull: Hull
) -> tuple[Views, Hull, list[Finding]]:
    """Views without those that only a wrong place explains, if we placed them; and their hull.

    On things that look alike from several sides a photograph may be put on the wrong one, and its
    mask would cut off what all others show.
    """
    odd = _odd(views, hull)
    if not frames.has_frame_of_ours or hull.strict >= GOOD_AGREEMENT or not odd:
        return views, hull, []
    rest = tuple(view for view in views if view.name not in odd)
    other = _hull(frames, rest)
    if len(rest) < MIN_VIEWS or other is None or other.strict < GOOD_AGREEMENT:
        return views, hull, []
    message = "photographs were put where their masks fit no other, and are left out"
    cure = "Photograph again from between these places and their neighbours, or turn what the "
    cure += "object stands on so that no two sides look alike."
    return rest, other, _of("warning", "misplaced", odd, len(views), message, cure)


def _hull(frames: FrameSet, views: Views) -> Hull | None:
    train = _train(views)
    start = frames.sphere
    if start is None and len(frames.points):
        start = sphere_from_points(frames.points, train)
    return sphere_from_masks(train, start)


def clipped_share(views: Iterable[View]) -> float:
    """Share of the object's pixels with a channel at 255."""
    clipped = [(_object_pixels(view) == 255).any(axis=1) for view in views]
    return sum(int(each.sum()) for each in clipped) / max(sum(map(len, clipped)), 1)


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
