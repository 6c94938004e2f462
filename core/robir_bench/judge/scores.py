# SPDX-License-Identifier: Apache-2.0
"""Scores of a population that outlive its captures, so that runs of another day compare in pairs.

A seed draws the same capture every time, so a small file of figures by capture is all that has to
be kept of a state of the program. `robir bench --population DIR -o OUT --keep FILE` writes one;
`robir bench --compare BEFORE AFTER` compares two over the captures that both have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robir.errors import UsageError
from robir.jobs.paths import read_json, write_json
from robir_bench.distribution import estimate, mean
from robir_bench.population import figure
from robir_bench.table import Record, Table, split
from robir_bench.truth.scores import (
    ALBEDO,
    HUE,
    LEVEL,
    NORMALS,
    RAW_ALBEDO,
    RELIT,
    RERENDER,
    ROUGHNESS,
    SECONDS,
    SHADOW,
    SUN,
    Score,
)

FORMAT_VERSION = 1

# what is kept, by the name in the file
FIGURES: dict[str, Score] = {
    "albedo_db": ALBEDO,
    "raw_albedo_db": RAW_ALBEDO,
    "shadow_off_1": SHADOW,
    "roughness_rmse": ROUGHNESS,
    "normals_degrees": NORMALS,
    "level_ln": LEVEL,
    "hue_ln": HUE,
    "sun_degrees": SUN,
    "relit_db": RELIT,
    "rerender_db": RERENDER,
    "cpu_seconds": SECONDS,
}


def keep(
    path: Path, state: str, records: Sequence[Record], classes: Mapping[str, Mapping[str, str]]
) -> None:
    """Write the figures of a population.

    Args:
        path: File to write.
        state: What the program was, such as a commit.
        records: Of the runs, the whole method alone.
        classes: Of their captures.
    """
    done, failed = split(records)
    captures: dict[str, Any] = {
        record["capture"]: {
            "classes": dict(classes[record["capture"]]),
            "figures": {
                name: None if value is None else round(value, 4)
                for name, score in FIGURES.items()
                for value in [figure(score, record, classes[record["capture"]])]
            },
            "is_trusted": (record.get("trust") or {}).get("is_trusted"),
            "signs": {
                name: round(sign["value"], 4)
                for name, sign in ((record.get("trust") or {}).get("signs") or {}).items()
            },
        }
        for record in sorted(done, key=lambda record: record["capture"])
    }
    captures |= {record["capture"]: {"error": record["error"]} for record in failed}
    write_json(path, {"format_version": FORMAT_VERSION, "state": state, "captures": captures})


def compared(before: Path, after: Path) -> Table:
    """How much better each figure is in the second of two files, over the captures of both.

    Raises:
        UsageError: If a file is none of these, or they have no capture in common.
    """
    first, second = _read(before), _read(after)
    common = sorted(
        name
        for name in first["captures"].keys() & second["captures"].keys()
        if {"figures"} <= first["captures"][name].keys() & second["captures"][name].keys()
    )
    if not common:
        raise UsageError(f"{before} and {after} have no scored capture in common")
    rows = []
    for name, score in FIGURES.items():
        pairs = [
            (first["captures"][c]["figures"].get(name), second["captures"][c]["figures"].get(name))
            for c in common
        ]
        sign = 1.0 if score.best == "high" else -1.0
        gained = [sign * (b - a) for a, b in pairs if a is not None and b is not None]
        found = estimate(gained, mean)
        if found is not None:
            better = sum(gain > 0 for gain in gained)
            rows.append([score.title, str(found.count), found.text(3), f"{better}"])
    return Table(
        title=f"{second['state']} against {first['state']}: better by",
        head=["figure", "captures", "mean", "better on"],
        rows=rows,
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path)
    except (OSError, ValueError) as fault:
        raise UsageError(f"{path} cannot be read: {fault}") from fault
    if not isinstance(content, dict) or content.get("format_version") != FORMAT_VERSION:
        raise UsageError(
            f"{path} holds no scores of `robir bench --keep`, version {FORMAT_VERSION}"
        )
    return content
