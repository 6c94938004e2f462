# SPDX-License-Identifier: Apache-2.0
"""What a bench or a stability sweep runs, from a small TOML file.

captures = ["captures/truck-filmic", "captures/hotdog-standard"]   # relative to the file
methods = ["ours", "no visibility", "photo"]
seeds = [0]
settings = ["export.renders=false"]

[factors]                  # `robir stability` only: values of each factor, see perturb.py
views = [10, 5]
"pose noise" = [0.3, 1.0]
mask = ["dilate 2", "holes 6"]

[[rendered]]               # what only another render can change: a capture beside one of the above
of = "captures/truck-filmic"
factor = "ground"
value = "none"
capture = "captures/truck-noground"
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from robir.config import RunConfig, resolve
from robir.errors import ConfigError
from robir.settings import parse_assignment, read_toml, settings_from_table
from robir_bench.paper.config import VARIANTS
from robir_bench.stability.perturb import Perturbation

OURS = "ours"
PHOTO = "photo"
MITSUBA = "mitsuba"
MITSUBA_TOLD = "mitsuba, true curve and sun"

_WORD = re.compile(r"[^\w.]+")  # what no name of a folder should have

# methods that share nothing but capture and geometry, see photo.py and prb.py
BORROWERS = (PHOTO, MITSUBA, MITSUBA_TOLD)

# Each method as settings put over the defaults. Those of BORROWERS have none; neither have the
# published ones (see published.py), which share the capture alone.
METHODS: dict[str, tuple[str, ...]] = {
    OURS: (),
    "no visibility": ("transport.use_visibility=false",),
    "no indirect light": ("transport.use_indirect=false",),
    "srgb": ('appearance.families=["standard"]',),
    "no far pairs": ('constants=["appearance.light.solver._FAR=0.0"]',),
    "one sharp lobe": ("appearance.num_sharp_lobes=1",),
    "hull geometry": ("geometry.level_cells=[64]", "geometry.level_steps=[1]"),
    **dict.fromkeys((*BORROWERS, *VARIANTS), ()),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchPlan:
    """A bench as written by the user."""

    # folders of captures, relative to the plan's folder; those without truth are scored by their
    # held-out photographs alone
    captures: tuple[str, ...]
    methods: tuple[str, ...] = (OURS,)  # names in METHODS
    seeds: tuple[int, ...] = (0,)  # seeds of the reconstruction and of what spoils a capture
    settings: tuple[str, ...] = ("export.renders=false",)  # items as for `--set`, for every run

    def __post_init__(self) -> None:
        """Refuse names nobody knows, and methods that miss what they start from."""
        if unknown := sorted(set(self.methods) - set(METHODS)):
            known = ", ".join(METHODS)
            raise ConfigError(f"methods: {unknown[0]!r} is unknown; known: {known}")
        for method in (*BORROWERS, *VARIANTS):
            if method in self.methods and OURS not in self.methods:
                what = f"methods: {method!r} starts from stages of 'ours'; list that too"
                raise ConfigError(what)


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedEntry:
    """One entry `[[rendered]]` of a sweep's plan."""

    of: str  # capture of the plan that it is compared with
    factor: str  # what differs
    value: str  # how
    capture: str  # folder of the other capture with truth, relative to the plan's folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """A value of a factor that spoils no capture: one with a render of its own, or a setting."""

    source: Path  # capture it is compared with
    factor: str  # name for people
    label: str  # value for people

    def make(self, out: Path, seed: int) -> None:
        """Nothing: the capture is there, or the run says that it is not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """One result of a bench."""

    capture: Path  # folder of the capture
    method: str  # name in METHODS
    seed: int  # seed
    settings: tuple[str, ...]  # items for `--set`, those of the method last
    # what sets it apart from the run on the capture as it is, None of that run
    perturbation: Perturbation | Ready | None = None
    # whether it is shown under the second light too, where its capture has one
    is_relit: bool = True
    # stage and name of the step that it does without, if any
    left_out: tuple[str, str] | None = None
    oracle: str | None = None  # quantity that it takes from the truth, if any, see judge/oracles.py

    @property
    def name(self) -> str:
        """Name of the run's folder, unique within a plan whose captures have unique names."""
        words = [self.capture.name, _WORD.sub("-", self.method), str(self.seed)]
        if self.perturbation is not None and self.perturbation.source == self.capture:
            words += [self.perturbation.factor, _WORD.sub("-", self.perturbation.label)]
        return "_".join(words)

    @property
    def facts(self) -> dict[str, Any]:
        """What tells the run from others, for its record."""
        spoilt = self.perturbation
        scene = self.capture if spoilt is None else spoilt.source
        return {
            "name": self.name,
            "capture": scene.name,
            "method": self.method,
            "seed": self.seed,
            "factor": "" if spoilt is None else spoilt.factor,
            "value": "" if spoilt is None else spoilt.label,
        }


def read_plan(path: Path) -> list[BenchRun]:
    """All runs of a bench; the whole method comes before its ablations.

    Raises:
        ConfigError: If the file, a name or a type is wrong, or two captures share a name.
    """
    return list(_runs(path, dict(read_toml(path))))


def read_sweep(path: Path, out: Path) -> list[BenchRun]:
    """All runs of a stability sweep, unperturbed ones first, then factor by factor.

    A factor with a dot in its name is a setting, and its values are those of the setting.

    Args:
        path: The plan.
        out: Result folder; spoilt captures are made in its folder `captures`.

    Raises:
        ConfigError: As `read_plan`, or if there are no factors or their values are wrong.
    """
    table = dict(read_toml(path))
    factors, rendered = table.pop("factors", {}), table.pop("rendered", [])
    if not isinstance(factors, Mapping) or not (factors or rendered):
        raise ConfigError(f"{path}: factors is missing; give a table [factors] of lists of values")
    whole = list(_runs(path, table))
    spoilt = [
        _spoilt(run, factor, value, out / "captures")
        for factor, values in factors.items()
        for value in (values if isinstance(values, list) else [values])
        for run in whole
    ]
    entries = [_entry(path, entry) for entry in rendered]
    return whole + spoilt + [run for entry in entries for run in _rendered(path, entry, whole)]


def with_constants(runs: Sequence[BenchRun], constants: Sequence[str]) -> list[BenchRun]:
    """The runs with constants changed, items as for `robir.constants`."""
    setting = (f"constants={json.dumps(list(constants))}",) if constants else ()
    return [replace(run, settings=_joined(run.settings + setting)) for run in runs]


def _joined(settings: tuple[str, ...]) -> tuple[str, ...]:
    """Settings with all constants in one list: of several lists the last would be the only one."""
    lists = [item for item in settings if item.partition("=")[0].strip() == "constants"]
    if len(lists) < 2:
        return settings
    every = [change for item in lists for change in parse_assignment(item)["constants"]]
    return (*(i for i in settings if i not in lists), f"constants={json.dumps(every)}")


def _runs(path: Path, table: dict[str, Any]) -> Iterator[BenchRun]:
    if not table.get("captures"):
        raise ConfigError(f"{path}: captures is missing; list the folders of captures")
    plan = settings_from_table(BenchPlan, table, str(path))
    captures = [(path.parent / capture).resolve() for capture in plan.captures]
    names = [capture.name for capture in captures]
    twins = sorted({name for name in names if names.count(name) > 1})
    if twins:
        raise ConfigError(f"{path}: two captures are called {twins[0]!r}; rename one")
    methods = sorted(plan.methods, key=list(METHODS).index)
    for capture, seed, method in product(captures, plan.seeds, methods):
        yield BenchRun(
            capture=capture,
            method=method,
            seed=seed,
            settings=_joined(plan.settings + METHODS[method]),
        )


def _spoilt(run: BenchRun, factor: str, value: Any, captures: Path) -> BenchRun:
    if "." in factor:
        item = f"{factor}={json.dumps(value)}"
        resolve(RunConfig(), None, (item,))  # a wrong name or value is told before any run
        changed = Ready(source=run.capture, factor=factor, label=str(value))
        return replace(run, settings=_joined((*run.settings, item)), perturbation=changed)
    number = float(value) if type(value) is int else value
    perturbation = Perturbation(source=run.capture, factor=factor, value=number)
    words = (run.capture.name, factor, perturbation.label, f"s{run.seed}")
    folder = captures / "_".join(words).replace(" ", "-")
    return replace(run, capture=folder.resolve(), perturbation=perturbation)


def _entry(path: Path, table: Mapping[str, Any]) -> RenderedEntry:
    missing = [field.name for field in fields(RenderedEntry) if field.name not in table]
    if missing:
        raise ConfigError(f"{path}: an entry [[rendered]] lacks {missing[0]}")
    return settings_from_table(RenderedEntry, table, f"{path}: rendered")


def _rendered(path: Path, entry: RenderedEntry, whole: list[BenchRun]) -> list[BenchRun]:
    source = (path.parent / entry.of).resolve()
    runs = [run for run in whole if run.capture == source]
    if not runs:
        raise ConfigError(f"{path}: rendered: {entry.of!r} is none of the captures; list it there")
    mark = Ready(source=source, factor=entry.factor, label=entry.value)
    capture = (path.parent / entry.capture).resolve()
    return [replace(run, capture=capture, perturbation=mark) for run in runs]
