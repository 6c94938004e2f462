# SPDX-License-Identifier: Apache-2.0
"""What a client asks of the command line."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What to reconstruct; every path is absolute.

    Attributes:
        capture: Folder or file of the capture.
        out: Result folder; an unfinished one is continued.
        preset: How much work to do.
        device: "auto", "cpu" or "cuda".
        masks: Folder of masks, or None for the capture's own.
        box: Where the object is if there are no masks, as the setting `capture.box`; empty to look
            for it.
        skips_missing: Whether photographs that are not there are done without.
        left_out: Photographs to do without, as the setting `capture.leave_out`.
        mesh: Mesh that takes the place of a surface of the engine's, or None.
        settings: Further items of `--set`.
        asset: File of what is known of an asset that is to be made, or None for no asset.
        until: Stage after which the run ends; empty for the last.
    """

    capture: Path
    out: Path
    preset: str = "draft"
    device: str = "auto"
    masks: Path | None = None
    box: tuple[float, ...] = ()
    skips_missing: bool = False
    left_out: tuple[str, ...] = ()
    mesh: Path | None = None
    settings: tuple[str, ...] = ()
    asset: Path | None = None
    until: str = ""

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
