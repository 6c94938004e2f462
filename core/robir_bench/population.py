# SPDX-License-Identifier: Apache-2.0
"""A bench over a population of rendered captures: which there are, and what their scores are like.

`python -m blender_scenes population DIR` renders them; each says in truth/scene.json, as "classes",
what it is of each kind of class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from robir.errors import ConfigError
from robir.jobs.paths import read_json
from robir_bench.distribution import CONFIDENCE, PopulationFigure, estimate, mean, quantile
from robir_bench.plan import OURS, BenchPlan, BenchRun
from robir_bench.table import Record, Table, failures, split, value
from robir_bench.truth.files import has_truth
from robir_bench.truth.scores import (
    ABOVE_PHOTO,
    ALBEDO,
    HUE,
    LEVEL,
    NORMALS,
    RAW_ALBEDO,
    RELIT,
    RELIT_RAW,
    ROUGHNESS,
    SECONDS,
    SHADOW,
    SUN,
    Score,
)

# captures of seeds from here on are kept for verdicts; those below are for development
VERDICT_SEED = 1000

# kinds of classes that are told apart
KINDS = ("ground", "paint", "metal", "tone", "sun", "backdrop")

TAIL = 0.1  # share of captures that are worse than the "worst tenth"

MISSED_SUN = 90.0  # degrees that count where there is a sun and no lamp was found

_WITH_SUN = (SHADOW, SUN)  # figures that mean nothing where no sun casts a shadow


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """One figure over some captures."""

    # of the figure's distance from what is right, where it is a ratio or an error with a sign, else
    # of the figure itself
    median: PopulationFigure | None
    worst_tenth: PopulationFigure | None  # what one in ten is worse than


def read_population(folder: Path) -> list[BenchRun]:
    """A run of each capture of a population, by the whole method.

    Raises:
        ConfigError: If the folder holds no capture with truth.
    """
    captures = sorted(child for child in folder.resolve().glob("*") if has_truth(child))
    if not captures:
        raise ConfigError(
            f"{folder} holds no captures with truth; make some with: python -m blender_scenes "
            f"population {folder} --count 12 --seed 0"
        )
    plan = BenchPlan(captures=tuple(str(capture) for capture in captures))
    return [
        BenchRun(
            capture=capture,
            method=OURS,
            seed=plan.seeds[0],
            settings=plan.settings,
        )
        for capture in captures
    ]


def capture_classes(runs: Sequence[BenchRun]) -> dict[str, dict[str, str]]:
    """Class of each kind, by the capture's name."""
    return {
        run.capture.name: read_json(run.capture / "truth" / "scene.json").get("classes", {})
        for run in runs
    }


def verdicts(runs: Sequence[BenchRun]) -> int:
    """How many captures are of seeds for verdicts."""
    scenes = (read_json(run.capture / "truth" / "scene.json") for run in runs)
    return sum(scene["seed"] >= VERDICT_SEED for scene in scenes)


def figure(score: Score, record: Record, classes: Mapping[str, str]) -> float | None:
    """A figure of one capture as it enters the distribution; None where it means nothing there.

    Args:
        score: The figure.
        record: Of a run that was scored.
        classes: Of its capture.
    """
    if score in _WITH_SUN and classes.get("sun") != "sun":
        return None
    found = value(score, record)
    if found is None:
        return MISSED_SUN if score is SUN else None
    return score.badness(found) if score.best in ("one", "zero") else found


def spread(score: Score, members: Sequence[Record], classes: Mapping[str, Any]) -> Spread:
    """Median and worst tenth of a figure over runs that were scored."""
    values = [figure(score, record, classes[record["capture"]]) for record in members]
    known = [one for one in values if one is not None]
    worst = TAIL if score.best == "high" else 1.0 - TAIL
    return Spread(
        median=estimate(known, quantile(0.5)), worst_tenth=estimate(known, quantile(worst))
    )


def below_photo(members: Sequence[Record]) -> PopulationFigure | None:
    """Share of runs whose albedo is worse than the photograph's; a run without a result is."""
    gains = [None if "error" in record else value(ABOVE_PHOTO, record) for record in members]
    return estimate([float(gain is None or gain < 0.0) for gain in gains], mean)


# what is reported, in this order
FIGURES = (
    ALBEDO, RAW_ALBEDO, ABOVE_PHOTO, SHADOW, ROUGHNESS, NORMALS, LEVEL, HUE, SUN, RELIT, RELIT_RAW,
    SECONDS,
)  # fmt: skip


def groups(
    records: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> dict[str, list[Record]]:
    """Runs by class, "ground: none", after those of all captures."""
    found = {"all": list(records)}
    for kind in KINDS:
        for name in sorted({c[kind] for c in classes.values() if kind in c}):
            members = [r for r in records if classes[r["capture"]].get(kind) == name]
            if members:
                found[f"{kind}: {name}"] = members
    return found


def population_tables(
    records: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> list[Table]:
    """The distribution, then the same by class, then each capture and what failed."""
    done, failed = split(records)
    tables = [_whole(records, done, classes)]
    tables += [
        _by_class(f"By class: {words}", name, records, classes)
        for name, words in (("median", "median"), ("worst_tenth", "worst tenth"))
    ]
    tables.append(_captures(done, classes))
    return tables + ([failures(failed)] if failed else [])


def distribution(
    records: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> dict[str, Any]:
    """All estimates as JSON values, by class and figure's title."""
    return {
        "confidence": CONFIDENCE,
        "classes": {
            name: {
                "captures": len(members),
                "failed": len(split(members)[1]),
                "below the photo": _plain(below_photo(members)),
                **{s.title: asdict(spread(s, split(members)[0], classes)) for s in FIGURES},
            }
            for name, members in groups(records, classes).items()
        },
    }


def _plain(found: PopulationFigure | None) -> dict[str, Any] | None:
    return None if found is None else asdict(found)


def _whole(
    records: Sequence[Record], done: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> Table:
    share = below_photo(records)
    rows = [
        [
            "share below the photo",
            str(len(records)),
            "-" if share is None else share.text(2),
            "-",
        ]
    ]
    for score in FIGURES:
        found = spread(score, done, classes)
        count = 0 if found.median is None else found.median.count
        cells = [_text(score, one) for one in (found.median, found.worst_tenth)]
        rows.append([_heading(score), str(count), *cells])
    return Table(
        title="All captures", head=["figure", "captures", "median", "worst tenth"], rows=rows
    )


def _by_class(
    title: str, name: str, records: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> Table:
    rows = []
    for group, members in groups(records, classes).items():
        done, failed = split(members)
        share = below_photo(members)
        cells = [_text(s, getattr(spread(s, done, classes), name)) for s in FIGURES]
        below = "-" if share is None else share.text(2)
        rows.append([group, str(len(members)), str(len(failed)), below, *cells])
    head = ["class", "captures", "failed", "below the photo", *map(_heading, FIGURES)]
    return Table(title=title, head=head, rows=rows)


def _captures(done: Sequence[Record], classes: Mapping[str, Mapping[str, str]]) -> Table:
    rows = []
    for record in done:
        own = classes[record["capture"]]
        cells = [score.text(figure(score, record, own)) for score in FIGURES]
        rows.append([record["capture"], *(own.get(kind, "-") for kind in KINDS), *cells])
    head = ["capture", *KINDS, *map(_heading, FIGURES)]
    return Table(title="Captures", head=head, rows=rows)


def _heading(score: Score) -> str:
    return f"{score.title}, off 1" if score.best == "one" else score.title


def _text(score: Score, found: PopulationFigure | None) -> str:
    return "-" if found is None else found.text(score.digits)
