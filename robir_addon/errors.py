# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors whose message is meant for the user; the exit codes are those of the command line."""

from .engine.errors import Sentence


class AddonError(Exception):
    """Something is missing or cannot be used; the message says what and what to do."""

    exit_code = 1  # of a process that ends with this kind of error

    def __init__(self, text: str, /, **values: object) -> None:
        """Say it in English; `words.told` says the sentences in the user's language."""
        self.sentences = (Sentence(text, **values),)
        super().__init__(*self.sentences)


class RequestError(AddonError):
    """The request or a path given with it makes no sense."""

    exit_code = 2


class ResultError(AddonError):
    """The result folder lacks something or is damaged."""

    exit_code = 6
