# SPDX-License-Identifier: Apache-2.0
"""What a client asks of the command line."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What to reconstruct; every path is absolute."""

    capture: Path  # folder or file of the capture
    out: Path  # result folder; an unfinished one is continued
    preset: str = "draft"  # how much work to do
    device: str = "auto"  # "auto", "cpu" or "cuda"
    masks: Path | None = None  # folder of masks, or None for the capture's own
    # where the object is if there are no masks, as the setting `capture.box`; empty to look for it
    box: tuple[float, ...] = ()
    skips_missing: bool = False  # whether photographs that are not there are done without
    left_out: tuple[str, ...] = ()  # photographs to do without, as the setting `capture.leave_out`
    mesh: Path | None = None  # mesh that takes the place of a surface of the engine's, or None
    settings: tuple[str, ...] = ()  # further items of `--set`
    # file of what is known of an asset that is to be made, or None for no asset
    asset: Path | None = None
    until: str = ""  # stage after which the run ends; empty for the last

    def words(self) -> list[str]:
        """The command line without the program."""
        masks = [] if self.masks is None else ["--masks", str(self.masks)]
        choices = ["--preset", self.preset, "--device", self.device]
        choices += [] if self.mesh is None else ["--mesh", str(self.mesh)]
        asset = [] if self.asset is None else ["--asset", str(self.asset)]
        until = ["--until", self.until] if self.until else []
        return [
            "reconstruct", str(self.capture), "-o", str(self.out), *choices, *masks, *asset, *until,
            *self.choice_words(), *(word for item in self.settings for word in ("--set", item)),
            "--resume", "--progress", "json",
        ]  # fmt: skip

    def choice_words(self) -> list[str]:
        """What says which photographs take part and where the object is; `check` takes it too."""
        names = json.dumps(self.left_out, ensure_ascii=False)
        return [
            *(["--set", f"capture.box={list(map(float, self.box))}"] if self.box else []),
            *(["--skip-missing"] if self.skips_missing else []),
            *(["--set", f"capture.leave_out={names}"] if self.left_out else []),
        ]
