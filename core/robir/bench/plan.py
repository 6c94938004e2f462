# SPDX-License-Identifier: Apache-2.0
"""What a bench or a stability sweep runs, from a small TOML file.

captures = ["captures/truck-filmic", "captures/hotdog-standard"]   # relative to the file
presets = ["draft"]
methods = ["ours", "no visibility", "photo"]
seeds = [0]
settings = ["export.renders=false"]

[factors]                  # `robir stability` only: values of each factor, see perturb.py
views = [10, 5]
"pose noise" = [0.3, 1.0]
mask = ["dilate 2", "holes 6"]
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from robir.bench.perturb import Perturbation
from robir.errors import ConfigError
from robir.presets import PRESETS
from robir.settings import read_toml, settings_from_table

OURS = "ours"
PHOTO = "photo"

METHODS: dict[str, tuple[str, ...]] = {
    OURS: (),
    "no visibility": ("transport.use_visibility=false",),
    "no indirect light": ("transport.use_indirect=false",),
    "srgb": ('appearance.families=["standard"]',),
    "log": ('appearance.families=["log"]',),
    "no parsimony prior": ("appearance.parsimony_weight=0",),
    "one sharp lobe": ("appearance.num_sharp_lobes=1",),
    "hull geometry": ("geometry.level_cells=[64]", "geometry.level_steps=[1]"),
    PHOTO: (),
}
"""Each method as settings put over the preset; `photo` (see photo.py) shares only the geometry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A bench as written by the user.

    Attributes:
        captures: Folders of captures with truth, relative to the plan's folder.
        presets: Names of presets.
        methods: Names in METHODS.
        seeds: Seeds of the reconstruction and of what spoils a capture.
        settings: Items as for `--set`, for every run.
    """

    captures: tuple[str, ...]
    presets: tuple[str, ...] = ("draft",)
    methods: tuple[str, ...] = (OURS,)
    seeds: tuple[int, ...] = (0,)
    settings: tuple[str, ...] = ("export.renders=false",)

    def __post_init__(self) -> None:
        """Refuse names nobody knows, and methods that miss what they start from."""
        for given, known, what in (
            (self.presets, PRESETS, "presets"),
            (self.methods, METHODS, "methods"),
        ):
            unknown = sorted(set(given) - set(known))
            if unknown:
                raise ConfigError(f"{what}: {unknown[0]!r} is unknown; known: {', '.join(known)}")
        if PHOTO in self.methods and OURS not in self.methods:
            raise ConfigError("methods: 'photo' textures the surface of 'ours'; list that too")


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """One result of a bench.

    Attributes:
        capture: Folder of the capture.
        preset: Preset.
        method: Name in METHODS.
        seed: Seed.
        settings: Items for `--set`, those of the method last.
        perturbation: How to make the capture where it is one made worse, else None.
    """

    capture: Path
    preset: str
    method: str
    seed: int
    settings: tuple[str, ...]
    perturbation: Perturbation | None = None

    @property
    def name(self) -> str:
        """Name of the run's folder, unique within a plan whose captures have unique names."""
        words = (self.capture.name, self.preset, self.method.replace(" ", "-"), str(self.seed))
        return "_".join(words)

    @property
    def facts(self) -> dict[str, Any]:
        """What tells the run from others, for its record."""
        spoilt = self.perturbation
        scene = self.capture if spoilt is None else spoilt.source
        return {
            "name": self.name,
            "capture": scene.name,
            "preset": self.preset,
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

    Args:
        path: The plan.
        out: Result folder; spoilt captures are made in its folder `captures`.

    Raises:
        ConfigError: As `read_plan`, or if there are no factors or their values are wrong.
    """
    table = dict(read_toml(path))
    factors = table.pop("factors", None)
    if not isinstance(factors, Mapping) or not factors:
        raise ConfigError(f"{path}: factors is missing; give a table [factors] of lists of values")
    whole = list(_runs(path, table))
    spoilt = [
        _spoilt(run, factor, value, out / "captures")
        for factor, values in factors.items()
        for value in (values if isinstance(values, list) else [values])
        for run in whole
    ]
    return whole + spoilt


def _runs(path: Path, table: dict[str, Any]) -> Iterator[BenchRun]:
    if not table.get("captures"):
        raise ConfigError(f"{path}: captures is missing; list the folders of captures with truth")
    plan = settings_from_table(Plan, table, str(path))
    captures = [(path.parent / capture).resolve() for capture in plan.captures]
    names = [capture.name for capture in captures]
    twins = sorted({name for name in names if names.count(name) > 1})
    if twins:
        raise ConfigError(f"{path}: two captures are called {twins[0]!r}; rename one")
    methods = sorted(plan.methods, key=list(METHODS).index)
    for capture, preset, seed, method in product(captures, plan.presets, plan.seeds, methods):
        yield BenchRun(
            capture=capture,
            preset=preset,
            method=method,
            seed=seed,
            settings=plan.settings + METHODS[method],
        )


def _spoilt(run: BenchRun, factor: str, value: Any, captures: Path) -> BenchRun:
    number = float(value) if type(value) is int else value
    perturbation = Perturbation(source=run.capture, factor=factor, value=number)
    words = (run.capture.name, factor, perturbation.label, f"s{run.seed}")
    folder = captures / "_".join(words).replace(" ", "-")
    return replace(run, capture=folder.resolve(), perturbation=perturbation)
