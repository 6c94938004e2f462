# SPDX-License-Identifier: Apache-2.0
"""How plain the English of our pages is: `python tests/plain.py [--limit] [--worst N] FILE...`.

Reads the prose and the tables of Markdown files; code blocks, headings and pictures are left out.
`--limit` exits with 1 where a page is beyond `LIMITS`. It finds habits, not meaning.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

LIMITS = {
    "words a sentence": 16.0,
    "% of sentences over 25 words": 12.0,
    "private words per 1000": 6.0,
    "decimals without their zero": 0.0,
    "cells over 160 characters": 0.0,
}
LONG_SENTENCE, LONG_CELL = 25, 160  # words, characters
PROSE_CELL = 12  # a table's cell of more words is read as prose

# Words that mean something here alone; beside each group, what the field says instead.
PRIVATE = re.compile(
    r"\b(?:"
    r"tells?|told|says|said|"  # indicates, reports, estimates
    r"(?:kept|set|keeps) aside|"  # held out
    r"witness(?:es)?|paints?|gloss|sheens?|"  # cue, dielectric, specular
    r"steps? (?:of exposure|darker|brighter)|"  # stops
    r"(?:is|are|was|were) (?:asked|taken for|sought|proven|evened)|"  # tested, classified as
    r"those (?:that|which|of)|what (?:is|was|it|one|an?|the|they|that)|"  # the noun itself
    r"of (?:these|which)|the same of|whichever|as it (?:is|was|stands)|"
    r"so much of|by (?:so )?much|comes? out|things?|in the mean"  # a number, an object
    r")\b",
    re.IGNORECASE,
)
SENTENCE_END = re.compile(r'(?<=[.!?:;])\s+(?=[A-Z"*(])')
PARAGRAPH_END = re.compile(r"\n\s*\n|\n\s*(?:[-*]|\d+[.)])\s")


def read(text: str) -> tuple[list[str], list[str]]:
    """Sentences of the prose of a Markdown page, and the cells of its tables."""
    text = re.sub(r"```.*?```|<[^>]+>|!\[[^\]]*\]\([^)]*\)", "", text, flags=re.DOTALL)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    lines = re.sub(r"`[^`]*`", "X", text).splitlines()
    rows = [line.strip().strip("|") for line in lines if line.lstrip().startswith("|")]
    cells = [cell.strip() for row in rows for cell in row.split("|")]
    kept = ["" if line.lstrip().startswith(("|", "#")) else line for line in lines]
    parts = PARAGRAPH_END.split("\n" + "\n".join(kept))
    parts += [cell for cell in cells if len(cell.split()) > PROSE_CELL]
    sentences = [s for part in parts for s in SENTENCE_END.split(" ".join(part.split()))]
    return [s for s in sentences if len(s.split()) > 2], cells


def measure(text: str) -> dict[str, float]:
    """The figures of one Markdown page, by the names of `LIMITS`."""
    sentences, cells = read(text)
    lengths = [len(sentence.split()) for sentence in sentences]
    words, count = max(sum(lengths), 1), max(len(lengths), 1)
    long = sum(length > LONG_SENTENCE for length in lengths)
    private = len(PRIVATE.findall(" ".join(sentences)))
    decimals = len(re.findall(r"(?<![\w.])\.\d", " ".join([*sentences, *cells])))
    cut = sum(len(cell) > LONG_CELL for cell in cells)
    figures = sum(lengths) / count, 100 * long / count, 1000 * private / words, decimals, cut
    return dict(zip(LIMITS, figures, strict=True))


def main() -> int:
    """Report each page; 1 where `--limit` is given and a page is beyond it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--limit", action="store_true", help="fail beyond the limits")
    parser.add_argument("--worst", type=int, default=0, help="show the N longest sentences")
    options = parser.parse_args()
    beyond = False
    for file in options.files:
        figures = measure(text := file.read_text(encoding="utf-8"))
        over = any(figure > LIMITS[name] for name, figure in figures.items())
        beyond |= over
        shown = ", ".join(f"{figure:.3g} {name}" for name, figure in figures.items())
        sys.stdout.write(f"{file}: {shown}{'  <- TOO MANY' if over else ''}\n")
        for sentence in sorted(read(text)[0], key=len, reverse=True)[: options.worst]:
            sys.stdout.write(f"    {sentence}\n")
    return int(beyond and options.limit)


if __name__ == "__main__":
    sys.exit(main())
