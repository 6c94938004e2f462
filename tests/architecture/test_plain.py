# SPDX-License-Identifier: Apache-2.0
"""The measure of plain English notices each habit; `make lint` holds the pages to it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import plain
import pytest

PLAIN = "# Title\n\nThe program reads photographs. It writes a mesh.\n\n| 0.5 dB | mean |\n"
BAD = {
    "words a sentence": "It reads " + "one more photograph and " * 6 + "stops.",
    "% of sentences over 25 words": PLAIN + "It reads " + "one photograph and " * 9 + "stops.",
    "private words per 1000": "What is told of paint is the thing.",
    "decimals without their zero": "It gains .5 dB here.",
    "cells over 160 characters": "| " + "word " * 40 + "|",
}


@pytest.mark.parametrize("name", BAD)
def test_each_habit_is_counted(name: str) -> None:
    assert all(figure <= plain.LIMITS[n] for n, figure in plain.measure(PLAIN).items())
    assert plain.measure(BAD[name])[name] > plain.LIMITS[name]


def test_code_headings_and_links_are_no_prose() -> None:
    page = "# Told .5\n\n```\n` told .5 of it\n```\n\nSee [the page](told .5.md) first.\n"
    assert plain.read(page) == (["See the page first."], [])


def test_the_limit_fails_a_page_with_a_sentence_that_is_too_long(tmp_path: Path) -> None:
    page = tmp_path / "page.md"

    def outcome(text: str, *options: str) -> int:
        page.write_text(text, encoding="utf-8")
        command = [sys.executable, plain.__file__, *options, page]
        return subprocess.run(command, capture_output=True, check=False).returncode

    assert outcome(PLAIN, "--limit") == 0
    assert outcome(BAD["words a sentence"], "--limit") == 1
    assert outcome(BAD["words a sentence"]) == 0
