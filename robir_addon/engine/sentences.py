# SPDX-License-Identifier: GPL-3.0-or-later
"""A filled text that remembers what it was made of, so that it can be said in another language."""


class Sentence(str):
    """English text whose fields are filled; this package itself knows no other language.

    Attributes:
        text: With its fields in braces, as catalogues know it.
        values: What the fields are filled with, by name.
    """

    text: str
    values: dict[str, object]

    def __new__(cls, text: str, /, **values: object) -> "Sentence":
        """Fill the fields; a text without values may hold braces of its own."""
        sentence = super().__new__(cls, text.format(**values) if values else text)
        sentence.text, sentence.values = text, values
        return sentence
