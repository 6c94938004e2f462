# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors whose message is for the user, exit codes as the command line's; their sentences."""


class EngineError(Exception):
    """The engine cannot be made, found, used or removed: what is wrong, and a cure."""

    exit_code = 4  # "no usable device" of the command line

    def __init__(self, message: str, cure: str, /, **values: object) -> None:
        """Join both to the text of the exception."""
        self.message, self.cure = Sentence(message, **values), Sentence(cure, **values)
        self.sentences = (self.message, self.cure)
        super().__init__(f"{self.message}; {self.cure}")


class Sentence(str):
    """English text whose fields are filled; this package itself knows no other language."""

    text: str  # with its fields in braces, as catalogues know it
    values: dict[str, object]  # what the fields are filled with, by name

    def __new__(cls, text: str, /, **values: object) -> "Sentence":
        """Fill the fields; a text without values may hold braces of its own."""
        sentence = super().__new__(cls, text.format(**values) if values else text)
        sentence.text, sentence.values = text, values
        return sentence


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
