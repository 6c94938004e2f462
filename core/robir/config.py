# SPDX-License-Identifier: Apache-2.0
"""All that decides a result: the rooms' settings and the seed, and their fingerprint.

Device, threads and progress are no part of it; they are asked for on the command line and never
enter a fingerprint.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robir.appearance.config import AppearanceConfig
from robir.capture.config import CaptureConfig
from robir.errors import ConfigError
from robir.export.config import ExportConfig
from robir.geometry.config import GeometryConfig
from robir.settings import (
    checked_table,
    merge,
    parse_assignment,
    read_toml,
    settings_from_table,
    table_from_settings,
)
from robir.transport.config import TransportConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Settings of a whole reconstruction.

    Attributes:
        seed: Seed of every random generator, >= 0.
        constants: Constants of modules that the bench changes, see `robir.constants`.
        capture: Reading and checking of the photographs.
        geometry: Signed distance field and mesh.
        transport: Visibility and one-bounce light.
        appearance: Tone curve, light and material.
        export: Asset, textures, renders and report.
    """

    seed: int = 0
    constants: tuple[str, ...] = ()
    capture: CaptureConfig = field(default_factory=CaptureConfig)
    geometry: GeometryConfig = field(default_factory=GeometryConfig)
    transport: TransportConfig = field(default_factory=TransportConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)
    export: ExportConfig = field(default_factory=ExportConfig)

    def __post_init__(self) -> None:
        """Refuse a seed that torch or numpy would refuse later."""
        if not 0 <= self.seed < 2**32:
            raise ConfigError(f"seed is {self.seed}; it must be in 0 .. 2**32 - 1")


def resolve(base: RunConfig, file: Path | None, assignments: Sequence[str]) -> RunConfig:
    """A configuration with a TOML file, then items such as "geometry.rays=900", put over it.

    `ConfigError` if a setting is unknown, of the wrong type or out of range.
    """
    table = table_from_settings(base)
    if file is not None:
        table = merge(table, checked_table(RunConfig, read_toml(file), str(file)))
    for assignment in assignments:
        changes = parse_assignment(assignment)
        table = merge(table, checked_table(RunConfig, changes, f"--set {assignment}"))
    return settings_from_table(RunConfig, table, "settings")


def fingerprint(*facts: Any) -> str:
    """SHA-256 of plain values, independent of the order of dictionary keys; 64 hex digits."""
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
