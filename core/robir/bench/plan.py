# SPDX-License-Identifier: Apache-2.0
"""What a bench runs: captures x presets x variants x seeds, from a small TOML file.

captures = ["captures/truck-filmic", "captures/hotdog-standard"]   # relative to the file
presets = ["draft"]
variants = ["full", "no visibility"]
seeds = [0]
settings = ["export.renders=false"]
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path

from robir.errors import ConfigError
from robir.presets import PRESETS
from robir.settings import read_toml, settings_from_table

VARIANTS: dict[str, tuple[str, ...]] = {
    "full": (),
    "no visibility": ("transport.use_visibility=false",),
    "no indirect light": ("transport.use_indirect=false",),
    "sRGB assumed": ('appearance.families=["standard"]',),
    "no parsimony prior": ("appearance.parsimony_weight=0",),
    "one sharp lobe": ("appearance.num_sharp_lobes=1",),
    "hull geometry": ("geometry.level_cells=[64]", "geometry.level_steps=[1]"),
}
"""The whole method and its ablations, each as settings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A bench as written by the user.

    Attributes:
        captures: Folders of captures with truth, relative to the plan's folder.
        presets: Names of presets.
        variants: Names in VARIANTS.
        seeds: Seeds of the reconstruction.
        settings: Items as for `--set`, for every run.
    """

    captures: tuple[str, ...]
    presets: tuple[str, ...] = ("draft",)
    variants: tuple[str, ...] = ("full",)
    seeds: tuple[int, ...] = (0,)
    settings: tuple[str, ...] = ("export.renders=false",)

    def __post_init__(self) -> None:
        """Refuse names nobody knows."""
        for given, known, what in (
            (self.presets, PRESETS, "presets"),
            (self.variants, VARIANTS, "variants"),
        ):
            unknown = sorted(set(given) - set(known))
            if unknown:
                raise ConfigError(f"{what}: {unknown[0]!r} is unknown; known: {', '.join(known)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """One reconstruction of a bench.

    Attributes:
        capture: Folder of the capture.
        preset: Preset.
        variant: Name in VARIANTS.
        seed: Seed.
        settings: Items for `--set`, those of the variant last.
    """

    capture: Path
    preset: str
    variant: str
    seed: int
    settings: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the run's folder, unique within a plan whose captures have unique names."""
        words = (self.capture.name, self.preset, self.variant.replace(" ", "-"), str(self.seed))
        return "_".join(words)


def read_plan(path: Path) -> list[BenchRun]:
    """All runs of a plan; the whole method comes before its ablations.

    Raises:
        ConfigError: If the file, a name or a type is wrong, or two captures share a name.
    """
    table = read_toml(path)
    if not table.get("captures"):
        raise ConfigError(f"{path}: captures is missing; list the folders of captures with truth")
    plan = settings_from_table(Plan, table, str(path))
    captures = [(path.parent / capture).resolve() for capture in plan.captures]
    names = [capture.name for capture in captures]
    twins = sorted({name for name in names if names.count(name) > 1})
    if twins:
        raise ConfigError(f"{path}: two captures are called {twins[0]!r}; rename one")
    variants = sorted(plan.variants, key=list(VARIANTS).index)
    return [
        BenchRun(
            capture=capture,
            preset=preset,
            variant=variant,
            seed=seed,
            settings=plan.settings + VARIANTS[variant],
        )
        for capture, preset, seed, variant in product(captures, plan.presets, plan.seeds, variants)
    ]
