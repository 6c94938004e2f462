# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error of the engine: what is wrong, and what to do about it."""

from .sentences import Sentence


class EngineError(Exception):
    """The engine cannot be made, found, used or removed.

    Attributes:
        message: What is wrong, one sentence without a full stop.
        cure: What the user can do, likewise.
        sentences: Both.
        exit_code: Process exit code that stands for it, "no usable device" of the command line.
    """

    exit_code = 4

    def __init__(self, message: str, cure: str, /, **values: object) -> None:
        """Join both to the text of the exception."""
        self.message, self.cure = Sentence(message, **values), Sentence(cure, **values)
        self.sentences = (self.message, self.cure)
        super().__init__(f"{self.message}; {self.cure}")
