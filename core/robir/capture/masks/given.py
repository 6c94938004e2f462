# SPDX-License-Identifier: Apache-2.0
"""Which mask belongs to which photograph."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from robir.capture.bounds import INSIDE
from robir.capture.capture import Finding, Split
from robir.capture.frames import IMAGE_SUFFIXES, Frame
from robir.capture.images.decode import may_hold_alpha
from robir.capture.images.loading import read_mask
from robir.capture.refusal import refuse, some, warning

_AFFIX = re.compile(
    r"^(?:dynamic_)?(?:mask|alpha|matte|seg)[-_.]|"
    r"[-_.](?:mask|masks|alpha|matte|matted|seg|segmentation|rgba|removebg-preview|removebg)$"
)

IGNORE = "dynamic_mask"  # how the names of pictures begin that say what to ignore (instant-ngp)
_FEWEST = 3  # photographs by which one mask for all is no coincidence
_OPEN = 0.5  # share of the border that a mask has to leave in to outline nothing
MAX_FILES = 100_000  # files that a folder of masks may hold
# the cure for missing masks, in one place
HOW_TO_SUPPLY = (
    "Supply one mask for each photograph (white = object) with --masks DIR, named like the "
    "photographs, or save the photographs as PNG with a transparent background."
)


def from_folder(folder: Path, frames: Iterable[Frame]) -> dict[str, Path]:
    """Match the masks of a folder and its subfolders to photographs; by frame name.

    A mask fits by its path below the folder, by its stem, by its stem without the usual
    additions ("_mask", "mask_", "-removebg-preview", a doubled suffix as in "a.jpg.png"), and
    last by its number ("000.png" for "000000.png"); a fit that is not unique does not count.
    """
    frames = tuple(frames)
    own = {os.path.normpath(f.image) for f in frames if not may_hold_alpha(f.image)}
    if not folder.is_dir():
        raise refuse("missing-masks", f"The folder of masks {folder} does not exist", HOW_TO_SUPPLY)
    index: dict[str, set[Path]] = defaultdict(set)
    pictures = [path for path in _pictures(folder) if not path.name.startswith(IGNORE)]
    for path in pictures:
        if os.path.normpath(path) in own:
            continue  # a photograph is not its own outline
        for key in _keys(path.relative_to(folder).as_posix()):
            index[key].add(path)
    found = {}
    for frame in frames:
        for key in _keys(frame.relative):
            if len(index.get(key, ())) == 1:
                (found[frame.name],) = index[key]
                break
    missing = [frame.relative for frame in frames if frame.name not in found]
    if missing and pictures and own >= {os.path.normpath(path) for path in pictures}:
        message = f"{folder} holds photographs and no masks that outline the object ({IGNORE}* "
        message += "says what to ignore)"
        raise refuse("missing-masks", message, HOW_TO_SUPPLY)
    if missing:
        message = f"{len(missing)} of {len(frames)} photographs have no mask in {folder}"
        cure = "Name each mask like its photograph (IMG_1.png or IMG_1_mask.png for IMG_1.jpg)."
        raise refuse("missing-masks", message, cure, *missing)
    users = Counter(found.values())
    shared = [frame.relative for frame in frames if users[found[frame.name]] > 1]
    if shared:
        message = f"{len(shared)} photographs share a mask in {folder}"
        cure = "Give each photograph a mask of its own, in the same subfolder as the photograph."
        raise refuse("missing-masks", message, cure, *shared)
    return found


def without_ignoring(
    chosen: Sequence[tuple[Frame, Split]], drawn: Mapping[str, Path]
) -> tuple[list[tuple[Frame, Split]], dict[str, Path], list[Finding]]:
    """Frames, masks and findings without masks that say what to ignore: all alike, or so named."""
    masks = [drawn.get(frame.name) or frame.mask for frame, _ in chosen]
    beside = [f.image.with_name(f"{IGNORE}_{f.image.stem}.png") for f, _ in chosen]
    dynamic = [path.name for path in beside if path.is_file()]
    message = f"{len(dynamic)} pictures {IGNORE}_* say what to ignore, outline no object, are not "
    found = some("note", "ignore-masks", dynamic, message + "used")
    if len(chosen) < _FEWEST or not _are_one(masks):
        return list(chosen), dict(drawn), found
    message = f"The masks of all {len(chosen)} photographs are the same picture and leave the "
    message += "border in: they say what to ignore, not what is the object, and are not used"
    found.append(warning("ignore-masks", message, HOW_TO_SUPPLY, str(masks[0])))
    return [(replace(frame, mask=None), split) for frame, split in chosen], {}, found


def _are_one(masks: Sequence[Path | None]) -> bool:
    """Whether all masks are one picture that calls most of its border object."""
    if None in masks:
        return False
    first, *others = sorted({Path(os.path.normpath(path)) for path in masks if path is not None})
    mask = read_mask(first, (0, 0))
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    is_open = (border >= INSIDE).mean() > _OPEN
    return bool(is_open) and all(np.array_equal(read_mask(p, (0, 0)), mask) for p in others)


def _pictures(folder: Path) -> list[Path]:
    """Pictures in a folder and its subfolders; links to folders are not followed."""
    found = []
    seen = 0
    for parent, folders, names in os.walk(folder):
        folders.sort()
        seen += len(names) + len(folders)
        if seen > MAX_FILES:
            message = f"{folder} holds more than {MAX_FILES} files and can be no folder of masks"
            raise refuse("missing-masks", message, HOW_TO_SUPPLY)
        paths = [Path(parent, name) for name in sorted(names)]
        found += [p for p in paths if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file()]
    return found


def natural_order(relative: str) -> list[tuple[int, str]]:
    """Sort key that puts "2.jpg" before "10.jpg"."""
    pieces = re.split(r"([0-9]{1,18})", relative.lower())
    return [(int(p), "") if p.isdigit() and p.isascii() else (-1, p) for p in pieces]


def _keys(relative: str) -> list[str]:
    """What a path can be found by, the strictest first."""
    path = _without_suffixes(relative.lower())
    parts = path.split("/")
    stem = parts[-1]
    bare = _AFFIX.sub("", _without_suffixes(_AFFIX.sub("", stem)))
    keys = [f"path:{path}"]
    keys += [f"path:{'/'.join([*parts[i:-1], bare])}" for i in range(len(parts))]
    keys += [f"stem:{stem}", f"bare:{bare}"]
    if bare.isascii() and bare.isdigit():
        keys.append(f"number:{int(bare)}")
    return list(dict.fromkeys(keys))


def _without_suffixes(name: str) -> str:
    while name.endswith(IMAGE_SUFFIXES):
        name = name.rsplit(".", 1)[0]
    return name
