# SPDX-License-Identifier: Apache-2.0
"""The scores of the levels as tables show them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# titles of the columns of `level_cells`
LEVEL_HEAD = ("level", "", "dB", "SSIM", "gradient", "dB, whole mask", "loss, dB")


def level_cells(levels: Mapping[str, Any]) -> list[list[str]]:
    """The table of `level_scores` as it is shown, a row a level."""

    def text(value: float | None, digits: int, sign: str = "") -> str:
        return "-" if value is None else f"{value:{sign}.{digits}f}"

    return [
        [
            row["letter"],
            row["title"],
            text(row["psnr"], 1),
            text(row["ssim"], 3),
            text(row["gradient"], 2),
            text(row["psnr_whole_mask"], 1),
            text(row["loss"], 1, "+"),
        ]
        for row in levels["chain"].values()
    ]


def level_notes(levels: Mapping[str, Any]) -> list[str]:
    """Sentences below the table: what was compared, and which stage is at fault."""
    share, chain = levels["seen_share"], levels["chain"]
    if share is None:
        return [levels["verdict"]]
    notes = [
        f"{levels['views']} held-out photographs, the same pixels for all: {share:.0%} of the "
        "masks, where the mesh is met and some photograph shows the point.",
        levels["verdict"],
    ]
    asset, mean = (chain[name]["psnr"] for name in ("material", "mean"))
    if asset is not None and mean is not None:
        side = "above" if asset > mean else "below"
        notes.append(f"The asset (e) lies {abs(asset - mean):.1f} dB {side} the plain mean (c').")
    return notes


def level_lines(levels: Mapping[str, Any]) -> list[str]:
    """The table and its sentences for a terminal."""
    lines = [list(LEVEL_HEAD), *level_cells(levels)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shown = [
        "  ".join(
            cell.ljust(width) if index < 2 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    return [*shown, *level_notes(levels)]
