# SPDX-License-Identifier: Apache-2.0
"""From photographs without poses to posed frames, in a work folder that can be taken up again.

Photographs are copied upright, grey and small enough for features first.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from PIL import Image

from robir.capture.capture import PHOTOGRAPHS_ALONE, Finding
from robir.capture.frames import FrameSet
from robir.capture.images.decode import (
    MAX_FILE_BYTES,
    exif_values,
    header,
    load,
    orientation,
    reduce,
    upright,
)
from robir.capture.images.loading import size_within
from robir.capture.images.pixels import pixels_of
from robir.capture.poses import sfm
from robir.capture.poses.diagnose import forget, hold_against_links, judge, look_alikes, read_links
from robir.capture.poses.sfm import MIN_PHOTOGRAPHS, MORE_PHOTOGRAPHS, Prepared, Workplace
from robir.capture.poses.sources import (
    MAX_BYTES,
    StatedLens,
    find_photographs,
    is_video,
    lens_of,
    stray_files,
    take_frames,
)
from robir.capture.readers import colmap
from robir.capture.refusal import CaptureRefusedError, note, refuse, some
from robir.capture.views import Progress
from robir.jobs.names import regular
from robir.jobs.paths import read_json, replacing, write_json

if TYPE_CHECKING:
    import pycolmap

REVISION = 3  # raised by hand when the results of this room change
MAX_ANEW = 4  # how often cameras are placed anew where sides that look alike led them astray
FEATURE_SIDE = 1000  # longer side of the copies in pixels
_PANORAMA = 2.2  # no lens takes pictures wider than this; stitching does
# typical share of each step in the time
_SHARES = {"frames": 0.1, "copies": 0.1, "features": 0.35, "matches": 0.25, "cameras": 0.2}


def register(source: Path, work: Path, seed: int, progress: Progress) -> FrameSet:
    """Posed frames of photographs or a video, in COLMAP's frame and unit, with sparse points.

    What could not be placed is named; a refusal says what to shoot differently. What a stopped call
    left in `work` is used if it belongs to the same files and seed; else it is cleared.
    """
    return _Registration(source, work, seed, progress).run()


class _Registration:
    """One attempt at one capture."""

    def __init__(self, source: Path, work: Path, seed: int, progress: Progress) -> None:
        self._source, self._work, self._seed, self._told = source, work, seed, progress
        self._place = Workplace(work)
        self._is_video = is_video(source)
        self._root = work / "frames" if self._is_video else source

    def run(self) -> FrameSet:
        """See `register`."""
        outcome = self._work / "outcome.json"
        self._begin()
        if not outcome.exists():
            write_json(outcome, [asdict(finding) for finding in self._findings()])
            # What is left is small: the model, and the frames of a video.
            self._place.database.unlink(missing_ok=True)
            for folder in (self._place.copies, self._place.models):
                shutil.rmtree(folder, ignore_errors=True)
        findings = [Finding.from_plain(plain) for plain in read_json(outcome)]
        if any(finding.level == "error" for finding in findings):
            raise CaptureRefusedError(findings)
        read = colmap.read(self._work / "model", self._root)
        # Poses belong to upright copies; the reader turns and scales the photographs alike.
        frames = tuple(
            replace(frame, lens=replace(frame.lens, is_scalable=True), is_upright=True)
            for frame in read.frames
        )
        read = replace(read, root=self._root, format=PHOTOGRAPHS_ALONE)
        return replace(read, frames=frames, findings=tuple(findings))

    def _begin(self) -> None:
        """Keep what a stopped call left, or clear the folder."""
        stamp = self._work / "stamp.json"
        self._told(0.0, "looking at the photographs")
        files = [self._source] if self._is_video else find_photographs(self._source)
        facts = [REVISION, version("pycolmap"), self._seed, [_fact(path) for path in files]]
        key = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
        if stamp.exists() and read_json(stamp) == key:
            return
        shutil.rmtree(self._work, ignore_errors=True)
        self._work.mkdir(parents=True)
        write_json(stamp, key)

    def _findings(self) -> list[Finding]:
        """Do what has not been done yet; the model is written if there is no error."""
        photographs, findings = self._copies()
        names = [photograph.copy for photograph in photographs]
        in_sequence = self._is_video or len(names) > sfm.MAX_EXHAUSTIVE
        portions = sfm.sequence_pairs(names) if in_sequence else sfm.all_pairs(names)
        looking = self._step("features", "looking for")
        sfm.find_features(self._place, photographs, sum(map(len, portions)), looking)
        sfm.match(self._place, portions, self._seed, self._step("matches", "looking for"))
        models, noticed = self._models(photographs)
        findings += noticed
        findings += judge(photographs, read_links(self._place, photographs), models)
        if not any(finding.level == "error" for finding in findings):
            self._write_model(models[0], photographs)
        return findings

    def _models(
        self, photographs: Sequence[Prepared]
    ) -> tuple[list[pycolmap.Reconstruction], list[Finding]]:
        """Models, the largest refined; anew where sides that look alike led it astray."""
        telling = self._step("cameras", "placing cameras:")
        models = self._mapped(len(photographs), telling)
        if not models:
            return [], []
        verdict = hold_against_links(self._place, photographs, models[0])
        best, fewest, forgotten = models, verdict, 0
        for _ in range(MAX_ANEW):
            if not verdict.suspects:
                break
            telling(1.0, "once more, without what looks alike from several sides")
            forget(self._place, verdict.suspects)
            forgotten += len(verdict.suspects)
            models = self._mapped(len(photographs), telling)
            if not models:
                break
            verdict = hold_against_links(self._place, photographs, models[0])
            if len(verdict.broken) < len(fewest.broken):
                best, fewest = models, verdict
        return best, look_alikes(photographs, fewest, forgotten)

    def _mapped(self, count: int, telling: Progress) -> list[pycolmap.Reconstruction]:
        """Models from what the database holds, the largest first and refined."""
        shutil.rmtree(self._place.models, ignore_errors=True)
        models = sfm.map_cameras(self._place, count, self._seed, telling)
        if models:
            telling(1.0, "refining all of them together")
            models[0] = sfm.refine(models[0])
        return models

    def _copies(self) -> tuple[list[Prepared], list[Finding]]:
        """Upright copies and what was noticed on the way, from a stopped call if it got so far."""
        listed = self._work / "photographs.json"
        if listed.exists():
            plain = read_json(listed)
            found = [Finding.from_plain(entry) for entry in plain["findings"]]
            return [Prepared(**photograph) for photograph in plain["photographs"]], found
        findings = []
        if self._is_video:
            telling = self._step("frames", "choosing frames:")
            findings += take_frames(self._source, self._root, telling)
        files = find_photographs(self._root)
        findings += stray_files(self._root, files)
        copying = self._step("copies", "copying")
        try:
            photographs, noticed = prepare(self._root, files, self._place.copies, copying)
        except CaptureRefusedError as refusal:
            raise CaptureRefusedError([*findings, *refusal.findings]) from None
        findings += noticed
        plain = {"photographs": [asdict(one) for one in photographs]}
        write_json(listed, plain | {"findings": [asdict(finding) for finding in findings]})
        return photographs, findings

    def _write_model(self, model: pycolmap.Reconstruction, photographs: Sequence[Prepared]) -> None:
        """Write the model under the photographs' own names, as a whole."""
        names = {photograph.copy: photograph.relative for photograph in photographs}
        for image in model.images.values():
            image.name = names[image.name]
        unfinished, target = self._work / "unfinished", self._work / "model"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        model.write_binary(unfinished)
        shutil.rmtree(target, ignore_errors=True)
        unfinished.rename(target)

    def _step(self, name: str, verb: str) -> Progress:
        """The progress of a step, as part of the whole."""
        names = list(_SHARES)
        before = sum(_SHARES[step] for step in names[: names.index(name)])
        return lambda share, text: self._told(before + _SHARES[name] * share, f"{verb} {text}")


def _fact(path: Path) -> list[Any]:
    """What identifies a file: its name and contents, or its size where it is no photograph's."""
    size = path.stat().st_size
    if size > (MAX_BYTES if is_video(path) else MAX_FILE_BYTES):
        return [path.name, size]
    with regular(path, MAX_BYTES) as file:
        return [path.name, hashlib.file_digest(cast("Any", file), "sha256").hexdigest()]


@dataclass(frozen=True, slots=True)
class _Copy:
    """What was noticed while a photograph was copied."""

    relative: str
    path: Path
    size: tuple[int, int]
    lens: StatedLens
    digest: bytes


def prepare(
    root: Path, photographs: Sequence[Path], folder: Path, progress: Progress
) -> tuple[list[Prepared], list[Finding]]:
    """Copy photographs upright, grey and small; one entry for each that is read and no twin."""
    copies: list[_Copy] = []
    findings: list[Finding] = []
    broken: list[str] = []
    for done, path in enumerate(photographs):
        try:
            copies.append(_copy(root, path, folder / f"{done:05d}.png"))
        except CaptureRefusedError as refusal:
            if refusal.findings[0].code == "missing-reader":
                raise
            broken.append(path.relative_to(root).as_posix())
        progress((done + 1) / len(photographs), f"photograph {done + 1} of {len(photographs)}")
    message = f"{len(broken)} of {len(photographs)} photographs are damaged and are left out"
    cure = "Copy them again from the camera."
    findings += some("warning", "unreadable-images", broken, message, cure)
    first: dict[bytes, _Copy] = {}
    for copy in copies:
        first.setdefault(copy.digest, copy)
    distinct = list(first.values())
    if len(distinct) == 1 < len(copies):
        message = f"All {len(copies)} photographs are the same one, so nothing tells how far away "
        name = distinct[0].relative
        fault = refuse("same-photograph", message + "anything is", MORE_PHOTOGRAPHS, name)
        raise CaptureRefusedError([*findings, *fault.findings])
    repeated = [copy.relative for copy in copies if first[copy.digest] is not copy]
    message = f"{len(repeated)} photographs repeat another, pixel by pixel, and are left out"
    findings += some("note", "repeated-images", repeated, message)
    if len(distinct) < MIN_PHOTOGRAPHS:
        message = f"{root} holds {len(distinct)} different photographs without camera poses; at "
        message += f"least {MIN_PHOTOGRAPHS} are needed to find where they were taken"
        fault = refuse("too-few-photographs", message, MORE_PHOTOGRAPHS)
        raise CaptureRefusedError([*findings, *fault.findings])
    return _grouped(distinct), findings + _remarks(distinct)


def _copy(root: Path, path: Path, target: Path) -> _Copy:
    with header(path) as picture:
        exif = exif_values(picture)
        turn = orientation(picture)
        lens = StatedLens() if exif is None else lens_of(exif, picture.size)
        spare = max(picture.size) // (2 * FEATURE_SIDE)
        reduce(picture, max(factor for factor in (1, 2, 4, 8) if factor <= max(1, spare)))
        load(picture, path)
        pixels = pixels_of(upright(picture, turn))
    grey = Image.fromarray(pixels.image_display).convert("L")
    size = size_within(grey.size, FEATURE_SIDE)
    if size != grey.size:
        grey = grey.resize(size, Image.Resampling.LANCZOS, reducing_gap=3.0)
    with replacing(target) as temporary:
        grey.save(temporary, format="PNG", compress_level=1)
    digest = hashlib.sha256(grey.tobytes()).digest()
    return _Copy(path.relative_to(root).as_posix(), target, size, lens, digest)


def _grouped(copies: Sequence[_Copy]) -> list[Prepared]:
    """Number the lenses: same body, same focal length, same shape of picture."""
    numbers: dict[object, int] = {}
    result = []
    for copy in copies:
        lens, (width, height) = copy.lens, copy.size
        number = numbers.setdefault((lens.body, lens.setting, copy.size), len(numbers))
        focal = None if lens.focal is None else lens.focal * max(copy.size)
        names = {"relative": copy.relative, "copy": copy.path.name}
        result.append(Prepared(**names, width=width, height=height, lens=number, focal=focal))
    return result


def _remarks(copies: Sequence[_Copy]) -> list[Finding]:
    wide = [c.relative for c in copies if max(c.size) > _PANORAMA * min(c.size)]
    message = f"{len(wide)} photographs are much longer than high, as stitched panoramas are"
    cure = "Leave them out: a stitched picture has no single camera."
    found = some("warning", "panorama", wide, message, cure)
    by_lens = Counter(f"{p.width}x{p.height}, camera {p.lens + 1}" for p in _grouped(copies))
    if len(by_lens) > 1:
        groups = "; ".join(f"{count} of {name}" for name, count in by_lens.items())
        message = f"The photographs come from {len(by_lens)} cameras, lenses or formats ({groups})"
        found.append(note("several-cameras", f"{message}; each has its own intrinsics"))
    known = sum(c.lens.focal is not None for c in copies)
    start = f"of {known} of {len(copies)}" if known else "of none"
    found.append(note("focal-length", f"EXIF data give a start for the focal length {start}"))
    return found
