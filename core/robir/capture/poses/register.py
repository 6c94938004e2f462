# SPDX-License-Identifier: Apache-2.0
"""From photographs without poses to posed frames, in a work folder that can be taken up again."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robir.capture.capture import PHOTOGRAPHS_ALONE, Finding
from robir.capture.frames import FrameSet
from robir.capture.images.decode import MAX_FILE_BYTES
from robir.capture.images.regular import regular
from robir.capture.poses.ambiguity import forget, hold_against_links
from robir.capture.poses.diagnose import judge, look_alikes, read_links
from robir.capture.poses.pairs import MAX_EXHAUSTIVE, all_pairs, sequence_pairs
from robir.capture.poses.photos import VIDEO_SUFFIXES, find_photographs, stray_files
from robir.capture.poses.prepare import Prepared, prepare
from robir.capture.poses.solve import Workplace, find_features, map_cameras, match, refine
from robir.capture.poses.video import MAX_BYTES, take_frames
from robir.capture.readers import colmap
from robir.capture.refusal import CaptureRefusedError
from robir.capture.views import Progress
from robir.jobs.paths import read_json, write_json

if TYPE_CHECKING:
    import pycolmap

REVISION = 3  # raised by hand when the results of this room change
MAX_ANEW = 4  # how often cameras are placed anew where sides that look alike led them astray
# typical share of each step in the time
_SHARES = {"frames": 0.1, "copies": 0.1, "features": 0.35, "matches": 0.25, "cameras": 0.2}


def is_video(source: Path) -> bool:
    """Whether a path is a video file."""
    return source.is_file() and source.suffix.lower() in VIDEO_SUFFIXES


def register(source: Path, work: Path, seed: int, progress: Progress) -> FrameSet:
    """Find out where photographs were taken.

    Args:
        source: Folder of photographs, or a video; never written to.
        work: Folder of this room alone. What a stopped call left there is used if it belongs to
            the same files and seed; else it is cleared.
        seed: Seed of all robust estimators.
        progress: Told what is being done.

    Returns:
        Posed frames of the photographs themselves, in the frame and unit of COLMAP, with sparse
        points. Photographs that could not be placed are named in a finding.

    Raises:
        CaptureError: If the photographs cannot be placed; a `CaptureRefusedError` whose findings
            say what to shoot differently.
    """
    return _Registration(source, work, seed, progress).run()


class _Registration:
    """One attempt at one capture."""

    def __init__(self, source: Path, work: Path, seed: int, progress: Progress) -> None:
        self._source = source
        self._work = work
        self._seed = seed
        self._told = progress
        self._place = Workplace(work)
        self._is_video = is_video(source)
        self._root = work / "frames" if self._is_video else source

    def run(self) -> FrameSet:
        """See `register`."""
        outcome = self._work / "outcome.json"
        self._begin()
        if not outcome.exists():
            findings = self._findings()
            write_json(outcome, [asdict(finding) for finding in findings])
            # What is left is small: the model, and the frames of a video.
            self._place.database.unlink(missing_ok=True)
            for folder in (self._place.copies, self._place.models):
                shutil.rmtree(folder, ignore_errors=True)
        findings = [Finding.from_plain(plain) for plain in read_json(outcome)]
        if any(finding.level == "error" for finding in findings):
            raise CaptureRefusedError(findings)
        return self._frames(findings)

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
        in_sequence = self._is_video or len(names) > MAX_EXHAUSTIVE
        portions = sequence_pairs(names) if in_sequence else all_pairs(names)
        looking = self._step("features", "looking for")
        find_features(self._place, photographs, sum(map(len, portions)), looking)
        match(self._place, portions, self._seed, self._step("matches", "looking for"))
        models, noticed = self._models(photographs)
        findings += noticed
        findings += judge(photographs, read_links(self._place, photographs), models)
        if not any(finding.level == "error" for finding in findings):
            self._write_model(models[0], photographs)
        return findings

    def _models(
        self, photographs: Sequence[Prepared]
    ) -> tuple[list[pycolmap.Reconstruction], list[Finding]]:
        """Models, the largest refined; where sides that look alike led it astray, anew.

        A stretch that stood wrong ties others together, so that each model shows new suspects.
        """
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
        models = map_cameras(self._place, count, self._seed, telling)
        if models:
            telling(1.0, "refining all of them together")
            models[0] = refine(models[0])
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
        try:
            photographs, noticed = prepare(
                self._root, files, self._place.copies, self._step("copies", "copying")
            )
        except CaptureRefusedError as refusal:
            raise CaptureRefusedError([*findings, *refusal.findings]) from None
        findings += noticed
        write_json(
            listed,
            {
                "photographs": [photograph.plain() for photograph in photographs],
                "findings": [asdict(finding) for finding in findings],
            },
        )
        return photographs, findings

    def _write_model(self, model: pycolmap.Reconstruction, photographs: Sequence[Prepared]) -> None:
        """Write the model under the photographs' own names, as a whole."""
        names = {photograph.copy: photograph.relative for photograph in photographs}
        for image in model.images.values():
            image.name = names[image.name]
        unfinished = self._work / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        model.write_binary(unfinished)
        target = self._work / "model"
        shutil.rmtree(target, ignore_errors=True)
        unfinished.rename(target)

    def _frames(self, findings: Sequence[Finding]) -> FrameSet:
        """The model through the reader of all COLMAP models."""
        read = colmap.read(self._work / "model", self._root)
        # Poses belong to upright copies; the reader turns and scales the photographs alike.
        frames = tuple(
            replace(frame, lens=replace(frame.lens, is_scalable=True), is_upright=True)
            for frame in read.frames
        )
        return replace(
            read, root=self._root, format=PHOTOGRAPHS_ALONE, frames=frames, findings=tuple(findings)
        )

    def _step(self, name: str, verb: str) -> Progress:
        """What a step is told, as part of the whole."""
        names = list(_SHARES)
        before = sum(_SHARES[step] for step in names[: names.index(name)])

        def tell(fraction: float, message: str) -> None:
            self._told(before + _SHARES[name] * fraction, f"{verb} {message}")

        return tell


def _fact(path: Path) -> list[Any]:
    """What identifies a file: its name and contents, or its size where it is no photograph's."""
    size = path.stat().st_size
    if size > (MAX_BYTES if is_video(path) else MAX_FILE_BYTES):
        return [path.name, size]
    digest = hashlib.sha256()
    with regular(path, MAX_BYTES) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return [path.name, digest.hexdigest()]
