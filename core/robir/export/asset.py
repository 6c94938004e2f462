# SPDX-License-Identifier: Apache-2.0
"""A finished result as one asset of Blender's library, and as USD."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

from robir.errors import ConfigError
from robir.export.blender import missing_blender, run_headless
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir.jobs.records import read_record
from robir.settings import read_toml, settings_from_table, table_from_settings

REVISION = 1  # raised when assets come out differently: all are then made again
Made = Literal["blend", "usd"]

MADE: tuple[Made, ...] = get_args(Made)  # where they are asked for; GLB every result has
_MANIFEST = {"fingerprint": str}
_REPORT = {"trust": {"is_trusted": bool}, "metal_share": float}

_MOST_LETTERS, _MOST_TAGS = 1000, 100

# tag of an object by the least share of its surface that is metal
_KINDS = ((0.5, "metal"), (0.05, "partly metal"), (0.0, "no metal"))


@dataclass(frozen=True, slots=True, kw_only=True)
class AssetFacts:
    """What is known of an asset, besides what its result says."""

    author: str = ""  # who made it
    licence: str = ""  # under which it may be used
    tags: tuple[str, ...] = ()  # words to find it by
    catalogue: str = ""  # place in the library, "/" between levels; empty for none
    textures: Literal["packed", "relative"] = "packed"  # into the .blend, or beside it
    formats: tuple[Made, ...] = ("blend",)  # "blend" for Blender's library, "usd"

    def __post_init__(self) -> None:
        """Refuse what the file of catalogues cannot say, and what is no line of text."""
        for text in (self.author, self.licence, *self.tags):
            if len(text) > _MOST_LETTERS or not text.isprintable():
                raise ConfigError(f"{text[:40]!a} is no line of up to {_MOST_LETTERS} letters")
        if len(self.tags) > _MOST_TAGS:
            raise ConfigError(f"{len(self.tags)} tags are more than {_MOST_TAGS}")
        parts = self.catalogue.split("/")
        is_whole = self.catalogue == "" or all(part.strip() == part != "" for part in parts)
        if not is_whole or ":" in self.catalogue or not self.catalogue.isprintable():
            raise ConfigError(
                f"the catalogue {self.catalogue!r} is none; write it as furniture/chairs"
            )


def read_facts(path: Path) -> AssetFacts:
    """What a TOML file says of an asset, or a `ConfigError`."""
    return settings_from_table(AssetFacts, read_toml(path), str(path))


def catalogue_id(catalogue: str) -> str:
    """The catalogue's UUID, the same wherever it is asked for."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"robir:{catalogue}"))


def possible(facts: AssetFacts) -> AssetFacts:
    """The same with those formats only that this machine can make."""
    if missing_blender() is None:
        return facts
    return replace(facts, formats=tuple(kind for kind in facts.formats if kind != "blend"))


def is_current(paths: JobPaths, facts: AssetFacts) -> bool:
    """Whether a finished result has this asset already, in these formats or more."""
    files = {"blend": paths.library_asset, "usd": paths.usd}
    if not facts.formats:
        return True
    try:
        made, wanted = read_record(paths.library_facts, {"formats": [str]}), _made_of(paths, facts)
    except (OSError, ValueError):
        return False
    return (
        set(made.pop("formats")) >= set(wanted.pop("formats"))
        and made == wanted
        and all(files[kind].is_file() for kind in facts.formats)
    )


def make_asset(paths: JobPaths, facts: AssetFacts, progress: Callable[[float, str], None]) -> None:
    """Write the formats of a finished result that are asked for, Blender's last; or RobirError."""
    others = tuple(kind for kind in facts.formats if kind != "blend")
    paths.library_facts.unlink(missing_ok=True)
    if "usd" in others:
        progress(0.0, "writing USD")
        from robir.export.gltf import write_usd  # numpy and the stages' files

        write_usd(paths, {"author": facts.author, "licence": facts.licence})
        write_json(paths.library_facts, _made_of(paths, replace(facts, formats=others)))
    if "blend" in facts.formats:
        _make_blend(paths, facts, progress)
        write_json(paths.library_facts, _made_of(paths, facts))


def _make_blend(paths: JobPaths, facts: AssetFacts, progress: Callable[[float, str], None]) -> None:
    report = read_record(paths.report_json, _REPORT)
    kind = next(kind for least, kind in _KINDS if report["metal_share"] >= least)
    words = ["asset", str(paths.root), f"--author={facts.author}", f"--licence={facts.licence}"]
    if facts.catalogue:
        words.append(f"--catalogue={catalogue_id(facts.catalogue)}")
    tags = (*facts.tags, kind, "trusted" if report["trust"]["is_trusted"] else "doubtful")
    words += [f"--tag={tag}" for tag in tags]
    if facts.textures == "packed":
        words.append("--pack")
    run_headless(words, progress)


def _made_of(paths: JobPaths, facts: AssetFacts) -> dict[str, Any]:
    manifest = read_record(paths.manifest(STAGES[-1]), _MANIFEST)
    about = {"revision": REVISION, "export": manifest["fingerprint"]}
    return table_from_settings(facts) | about
