# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error of the engine: what is wrong, and what to do about it."""


class EngineError(Exception):
    """The engine cannot be made, found, used or removed.

    Attributes:
        message: What is wrong, one sentence without a full stop.
        cure: What the user can do, likewise.
        exit_code: Process exit code that stands for it, "no usable device" of the command line.
    """

    exit_code = 4

    def __init__(self, message: str, cure: str) -> None:
        """Join both to the text of the exception."""
        super().__init__(f"{message}; {cure}")
        self.message = message
        self.cure = cure
