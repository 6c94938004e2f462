# SPDX-License-Identifier: Apache-2.0
"""How a capture is refused: an error that carries its findings."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from robir.capture.capture import Finding, Level
from robir.errors import CaptureError

MAX_FILES = 12  # files a finding names at most; the message holds the count
SHOWN_FILES = 3  # files that a line of text names; the table of findings has all that are kept
MAX_LETTERS = 2000  # letters of a message or a name that are shown
# what reading a damaged file of arrays raises
DAMAGED_ARRAYS = (
    *(OSError, ValueError, LookupError, EOFError, SyntaxError, RuntimeError, MemoryError),
    *(OverflowError, zipfile.BadZipFile, zlib.error, tokenize.TokenError),
)


class CaptureRefusedError(CaptureError):
    """The capture cannot be reconstructed; its `findings` say why and what to do."""

    def __init__(self, findings: Iterable[Finding]) -> None:
        """Make the message from the errors among the findings."""
        self.findings = tuple(findings)
        errors = [finding for finding in self.findings if finding.level == "error"]
        super().__init__("\n".join(describe(finding) for finding in errors))


def grouped(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """One finding a kind: the first of those with one code and cure, which counts the others."""
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in findings:
        kinds.setdefault((finding.level, finding.code, finding.cure), []).append(finding)
    joined = []
    for first, *others in kinds.values():
        if others:
            names = dict.fromkeys(name for one in (first, *others) for name in one.files)
            message = f"{first.message}; so it is with {len(others)} more"
            first = replace(first, message=message, files=tuple(names)[:MAX_FILES])
        joined.append(first)
    return tuple(joined)


def describe(finding: Finding) -> str:
    """A finding as one line: message, files, cure."""
    shown = ", ".join(finding.files[:SHOWN_FILES])
    rest = ", ..." if len(finding.files) > SHOWN_FILES else ""
    files = f" ({shown}{rest})" if shown else ""
    cure = f" {finding.cure}" if finding.cure else ""
    return f"{finding.message}{files}.{cure}"


def refuse(code: str, message: str, cure: str, *files: str) -> CaptureRefusedError:
    """A refusal for one reason."""
    return CaptureRefusedError([error(code, message, cure, *files)])


def error(code: str, message: str, cure: str, *files: str) -> Finding:
    """A finding that refuses the capture."""
    return _finding("error", code, message, cure, files)


def warning(code: str, message: str, cure: str, *files: str, **numbers: Any) -> Finding:
    """A finding that lowers the result."""
    return _finding("warning", code, message, cure, files, numbers)


def note(code: str, message: str, *files: str, **numbers: Any) -> Finding:
    """A finding that informs."""
    return _finding("note", code, message, "", files, numbers)


def some(
    level: Level, code: str, names: Sequence[str], message: str, cure: str = ""
) -> list[Finding]:
    """A finding about files; none where there are no such files."""
    return [_finding(level, code, message, cure, names)] if names else []


def _finding(
    level: Level,
    code: str,
    message: str,
    cure: str,
    files: Sequence[str],
    numbers: dict[str, Any] | None = None,
) -> Finding:
    names, text = tuple(map(_printable, files[:MAX_FILES])), _printable(message)
    return Finding(
        level=level, code=code, message=text, cure=cure, files=names, numbers=numbers or {}
    )


def _printable(text: str) -> str:
    """Text that every terminal and file takes; names of files may hold anything."""
    whole = text if len(text) <= MAX_LETTERS else f"{text[:MAX_LETTERS]}..."
    safe = "".join(letter if letter.isprintable() or letter == "\n" else "?" for letter in whole)
    return safe.encode("utf-8", "backslashreplace").decode("utf-8")
