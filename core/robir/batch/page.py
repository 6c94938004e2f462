# SPDX-License-Identifier: Apache-2.0
"""What a library shows: its contact sheet, and facts and catalogues for Blender's asset browser."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robir.batch.local import Standing
from robir.batch.plan import Entry, Plan
from robir.export.asset import catalogue_id
from robir.export.page import page_template
from robir.jobs.library import Format, LibraryPaths
from robir.jobs.paths import replacing
from robir.jobs.records import read_record
from robir.settings import toml_from_settings

_REPORT = {
    "held_out": {"psnr": (None, float)}, "trust": {
        "is_trusted": bool, "doubts": [str],
        "verdict?": {"word": str, "reason": str, "remedy": str},
    },
    "capture": {"train_views": int}, "seconds": {...: {"cpu": float}},
}  # fmt: skip
_ORDER = ("failed", "doubtful", "running", "waiting", "dropped", "done")


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetRow:
    """What the sheet says of one capture."""

    name: str  # of its result folder
    state: str  # as of `Standing`, or "doubtful"
    word: str = ""  # what is said of it: the result's verdict, else its state
    sentences: tuple[str, ...] = ()  # why it failed, or the verdict's reason and remedy
    facts: Mapping[str, Any] = field(default_factory=dict)  # psnr (dB), views, seconds
    tags: tuple[str, ...] = ()  # of its asset
    report: str = ""  # its own report from the library's folder; empty without one
    picture: str = ""  # its pictures, likewise
    files: Mapping[str, str] = field(default_factory=dict)  # format and file, likewise


def row_of(
    entry: Entry, standing: Standing, paths: LibraryPaths, formats: Sequence[Format]
) -> SheetRow:
    """The row of a capture as its result folder has it now."""
    job = paths.result(entry.name)
    files = {"glb": job.asset, "usd": job.usd, "blend": job.library_asset}
    if standing.state != "done":
        sentences = (standing.message,) if standing.message else ()
        return SheetRow(name=entry.name, state=standing.state, sentences=sentences, tags=entry.tags)
    try:
        report = read_record(job.report_json, _REPORT)
    except (OSError, ValueError) as error:
        sentence = f"its report cannot be read ({error}); reconstruct it again"
        return SheetRow(name=entry.name, state="failed", sentences=(sentence,), tags=entry.tags)
    trust = report["trust"]
    verdict = trust.get("verdict")  # results of older versions have none
    told = (f"{verdict['reason']}; {verdict['remedy']}",) if verdict and verdict["reason"] else ()
    return SheetRow(
        name=entry.name,
        state="done" if trust["is_trusted"] else "doubtful",
        word=verdict["word"] if verdict else "",
        sentences=told or tuple(trust["doubts"]),
        facts={
            "psnr": report["held_out"]["psnr"],
            "views": report["capture"]["train_views"],
            "seconds": sum(stage["cpu"] for stage in report["seconds"].values()),
        },
        tags=entry.tags,
        report=_from(job.report, paths),
        picture=_from(job.contact, paths) if job.contact.is_file() else "",
        files={kind: _from(files[kind], paths) for kind in formats if files[kind].is_file()},
    )


def write_page(rows: Sequence[SheetRow], paths: LibraryPaths) -> None:
    """Write index.html; it needs no network and no script but its own."""
    counts = {state: sum(row.state == state for row in rows) for state in _ORDER}
    text = page_template("robir.batch", "library.html").render(
        title=paths.root.absolute().name,
        rows=sorted(rows, key=lambda row: (_ORDER.index(row.state), row.name.lower())),
        counts={state: count for state, count in counts.items() if count},
        order=_ORDER,
    )
    with replacing(paths.page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _from(file: Path, paths: LibraryPaths) -> str:
    return file.relative_to(paths.root).as_posix()


_HEAD = "# Catalogues of Blender's asset browser, which may write this file, too.\n\nVERSION 1\n\n"


def write_facts(plan: Plan, paths: LibraryPaths) -> None:
    """Write what is known of each asset where its process reads it, and the catalogues."""
    if not plan.options.made:
        return
    for entry in plan.entries:
        _write_if_other(paths, entry.name, toml_from_settings(plan.facts(entry)))
    if "blend" in plan.options.made:
        _write_catalogues({entry.catalogue for entry in plan.entries}, paths)


def _write_if_other(paths: LibraryPaths, name: str, text: str) -> None:
    file = paths.facts(name)
    if not file.is_file() or file.read_bytes() != text.encode():
        with replacing(file) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _write_catalogues(catalogues: set[str], paths: LibraryPaths) -> None:
    """Add what is missing; lines that Blender or the user wrote stay."""
    file = paths.catalogues
    as_it_is = {"encoding": "utf-8", "errors": "surrogateescape"}  # lines of others may be anything
    before = file.read_text(**as_it_is) if file.is_file() else _HEAD
    lines = [
        f"{catalogue_id(name)}:{name}:{name.replace('/', '-')}\n"
        for name in sorted(set(_with_parents(catalogues)))
        if catalogue_id(name) not in before
    ]
    if lines:
        with replacing(file) as temporary:
            temporary.write_text(before + "".join(lines), **as_it_is)


def _with_parents(catalogues: Iterable[str]) -> Iterator[str]:
    for catalogue in filter(None, catalogues):
        parts = catalogue.split("/")
        yield from ("/".join(parts[: n + 1]) for n in range(len(parts)))
