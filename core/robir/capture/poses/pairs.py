# SPDX-License-Identifier: Apache-2.0
"""Which photographs are compared with which."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

Pair = tuple[str, str]  # names of two photographs
MAX_EXHAUSTIVE = 120  # up to this many photographs, all pairs are compared (7140 of them)
TILE = 12  # photographs in a row and a column of one portion; each is loaded once a portion
NEIGHBOURS = 10  # pictures before and after one in a sequence that it is compared with
# pictures of a sequence, evenly spaced, that are compared with each other to close loops
LOOP_PICTURES = 40


def all_pairs(names: Sequence[str]) -> list[list[Pair]]:
    """All pairs, in portions.

    Args:
        names: Photographs.
    """
    return _portions(names, set(combinations(range(len(names)), 2)))


def sequence_pairs(names: Sequence[str]) -> list[list[Pair]]:
    """Pairs of a sequence, in portions: neighbours, steps of powers of two, and closed loops.

    Args:
        names: Pictures in the order they were taken.
    """
    count = len(names)
    steps = {*range(1, NEIGHBOURS + 1), *(2**k for k in range(count.bit_length()))}
    pairs = {(i, i + step) for step in steps for i in range(count - step)}
    pairs.update(combinations(range(0, count, max(1, count // LOOP_PICTURES)), 2))
    return _portions(names, pairs)


def _portions(names: Sequence[str], pairs: set[tuple[int, int]]) -> list[list[Pair]]:
    tiles: dict[tuple[int, int], list[Pair]] = {}
    for i, j in sorted(pairs):
        tiles.setdefault((i // TILE, j // TILE), []).append((names[i], names[j]))
    return [tiles[key] for key in sorted(tiles)]
