# SPDX-License-Identifier: Apache-2.0
"""What the add-on's source says to a user: the texts that a catalogue has to know.

A text is a pair of Blender's context and the English words. Names and descriptions of what is
registered are not looked for here; Blender tells them better (texts_session.py).
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ANY, OPERATOR = "*", "Operator"

# functions and the places of those arguments that are looked up, by them or by Blender
LOOKED_UP = {
    "words": (0,),
    "told": (0,),
    "Sentence": (0,),
    "AddonError": (0,),
    "RequestError": (0,),
    "ResultError": (0,),
    "EngineError": (0, 1),
    "Status": (1, 2),
    "unless": (1,),
    "report": (1,),
}

# functions that show what they are given, and the place of that argument
AS_IT_IS = {"paragraph": 2, "poll_message_set": 0, "show_problem": 0}

# fields of the state that panels show as they are
SHOWN = ("message", "error", "error_cure", "engine_text", "recognised")

BUTTONS = ("operator", "operator_menu_enum")
CONFIRMED = ("title", "message", "confirm_text")

# programs for the command line, and what runs before there are catalogues: English only
APART = (
    "headless.py",
    "command_line.py",
    "gateway.py",
    *(f"engine/{name}.py" for name in ("install", "pip", "remove")),
)


@dataclass
class Found:
    """What was found in the source."""

    # texts with the places that say them
    texts: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    # texts that cannot be translated: put together before they are looked up, or not looked up at
    # all; with their places
    faults: list[str] = field(default_factory=list)


def texts_of(folder: Path) -> Found:
    """Read all of an add-on's source."""
    trees = {
        file.relative_to(folder).as_posix(): ast.parse(file.read_text(encoding="utf-8"))
        for file in sorted(folder.rglob("*.py"))
    }
    constants = {}
    for tree in trees.values():
        constants |= _assigned(tree.body)
    found = Found()
    for name, tree in trees.items():
        if name not in APART:
            _Reader(name, constants, found).visit(tree)
    return found


def _assigned(body: list[ast.stmt]) -> dict[str, list[ast.expr]]:
    """Expressions by the names that statements give them."""
    values: dict[str, list[ast.expr]] = {}
    for node in body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            values.setdefault(node.targets[0].id, []).append(node.value)
    return values


class _Reader(ast.NodeVisitor):
    """Walks one file; knows what the names of the function at hand stand for."""

    def __init__(self, file: str, constants: dict[str, list[ast.expr]], found: Found) -> None:
        self._file, self._found = file, found
        self._names = [constants]

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        inner = [child for child in ast.walk(node) if isinstance(child, ast.stmt)]
        self._names.append(_assigned(inner))
        self.generic_visit(node)
        self._names.pop()

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            if isinstance(target, ast.Attribute) and target.attr in SHOWN:
                self._must_be_looked_up(node.value)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        for place in LOOKED_UP.get(name, ()):
            if place < len(node.args):
                self._take(ANY, node.args[place])
        if name in AS_IT_IS and AS_IT_IS[name] < len(node.args):
            self._must_be_looked_up(node.args[AS_IT_IS[name]])
        for keyword in node.keywords:
            if keyword.arg == "text" and isinstance(node.func, ast.Attribute):
                self._take(OPERATOR if name in BUTTONS else ANY, keyword.value)
            if name == "invoke_confirm" and keyword.arg in CONFIRMED:
                self._take(ANY, keyword.value)
        self.generic_visit(node)

    def _take(self, context: str, given: ast.expr) -> None:
        for literal in self._literals(given):
            if isinstance(literal, ast.JoinedStr):
                self._fault(literal, "put together before it is looked up")
            elif literal.value:
                self._found.texts.setdefault((context, literal.value), []).append(
                    self._place(given)
                )

    def _must_be_looked_up(self, given: ast.expr) -> None:
        for literal in self._literals(given):
            if isinstance(literal, ast.JoinedStr) or literal.value:
                self._fault(literal, "shown without being looked up")

    def _fault(self, node: ast.expr, why: str) -> None:
        self._found.faults.append(f"{self._place(node)}: {why}: {ast.unparse(node)}")

    def _place(self, node: ast.expr) -> str:
        return f"{self._file}:{node.lineno}"

    def _literals(self, node: ast.expr) -> Iterator[ast.Constant | ast.JoinedStr]:
        """Literal texts that an expression can be; those that only join others are none."""
        match node:
            case ast.Constant(value=str()):
                yield node
            case ast.JoinedStr(values=parts):
                own = [part.value for part in parts if isinstance(part, ast.Constant)]
                if any(letter.isalpha() for text in own for letter in text):
                    yield node
            case ast.IfExp(body=one, orelse=other):
                yield from self._literals(one)
                yield from self._literals(other)
            case ast.BoolOp(values=parts) | ast.Tuple(elts=parts) | ast.Dict(values=parts):
                for part in parts:
                    yield from self._literals(part)
            case ast.Subscript(value=inner) | ast.Call(func=ast.Attribute(value=inner, attr="get")):
                yield from self._literals(inner)
            case ast.Name(id=name):
                known = next((names[name] for names in self._names[::-1] if name in names), ())
                for value in known:
                    yield from self._literals(value)
