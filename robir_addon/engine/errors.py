# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error of the engine, and the sentences that errors are made of."""


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
