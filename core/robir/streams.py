# SPDX-License-Identifier: Apache-2.0
"""Standard streams that may be closed, full, or read by nobody: none of it ends or silences a run.

What cannot be said on standard error is lost; the run goes on. What cannot be given on standard
output is told where it is a fault, and not where its reader had enough.
"""

from __future__ import annotations

import errno
import os
import sys
from typing import Any, TextIO


class Patient:
    """A stream whose writing never raises; everything else is the stream's own."""

    def __init__(self, stream: TextIO) -> None:
        """Stand before a stream."""
        self._stream = stream
        self.fault: OSError | None = None

    def write(self, text: str) -> int:
        """Write, or note why not; as of any stream."""
        self._tried(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush, or note why not."""
        self._tried(self._stream.flush)

    def _tried(self, act: Any) -> None:
        if self.fault is not None:
            return
        try:
            act()
        except OSError as error:
            self.fault = error
            # what is left in the stream would be tried again, and told, at the program's end
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, self._stream.fileno())
            os.close(sink)

    def __getattr__(self, name: str) -> Any:
        """Everything else is the stream's."""
        return getattr(self._stream, name)


def make_patient() -> None:
    """Put patient streams in the places of the standard ones, and open those that are closed."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this
    for name, number in (("stdout", 1), ("stderr", 2)):
        stream = getattr(sys, name)
        if stream is None:
            stream = os.fdopen(number, "w", closefd=False)
        if not isinstance(stream, Patient):
            setattr(sys, name, Patient(stream))


def output_fault() -> str | None:
    """Why the result could not be given on standard output; None where it was, or nobody reads."""
    if not isinstance(sys.stdout, Patient):
        return None
    sys.stdout.flush()
    fault = sys.stdout.fault
    return None if fault is None or fault.errno == errno.EPIPE else fault.strerror
