# SPDX-License-Identifier: Apache-2.0
"""The library as Blender's asset browser sees it: facts for each asset, and the catalogues."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from robir.batch.plan import Plan
from robir.export.asset import catalogue_id
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import replacing
from robir.settings import toml_from_settings

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
