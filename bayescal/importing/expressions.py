"""Columns of a log by name or number, and sums and multiples of them: ``A3 + A2``, ``U95 / 2``.

Only numbers, columns, ``+ - * /`` and parentheses are evaluated, by walking the syntax tree.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import BayescalError
from bayescal.files import unknown
from bayescal.importing.units import is_number, name_and_unit

OPERATORS: dict[type, Callable[..., np.ndarray]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}

TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|\{(?P<braced>[^{}]+)\}|(?P<hash>#[1-9]\d*)"
    r"|(?P<name>[^\W\d][\w.]*)|(?P<sign>[-+*/()]))"
)
"""Names with other characters than letters, digits, ``_`` and ``.`` are enclosed in braces."""

LONGEST = 300
"""Characters of an expression."""


@dataclass(frozen=True)
class Expression:
    """Columns by index from 0, and the tree that combines them, `None` of a column alone."""

    text: str
    columns: tuple[int, ...]
    tree: ast.expr | None = None

    def value(self, numbers: Callable[[int], np.ndarray], count: int) -> np.ndarray:
        """The values (N,) of all rows, from those of a column, `numbers(index)`."""
        if self.tree is None:
            return numbers(self.columns[0])
        values = {f"c{i}": numbers(i) for i in self.columns}
        with np.errstate(all="ignore"):
            return np.broadcast_to(_walk(self.tree, values), (count,)).astype(float)


def place(name: str, header: Sequence[str], width: int, where: str) -> int:
    """Index of the column with a name (its unit in brackets may be left out) or a number (``#3``).

    Raises
    ------
    BayescalError
        If there is no such column, or several.
    """
    if re.fullmatch(r"#[1-9]\d*", name) and name not in header:
        if int(name[1:]) <= width:
            return int(name[1:]) - 1
        what = f"there is no column {name[1:]}, the file has {width} columns"
        raise BayescalError(what, where, "columns are numbered from 1")
    found = [i for i, cell in enumerate(header) if cell == name]
    found = found or [i for i, cell in enumerate(header) if name_and_unit(cell)[0] == name]
    if len(found) == 1:
        return found[0]
    if found:
        numbers = " and ".join(f"#{i + 1}" for i in found)
        raise BayescalError(f"columns {numbers} are both called `{name}`", where, "give the number")
    _, remedy = unknown("column", name, header)
    hint = remedy if header else "the file has no header: use #1, #2, ... as column names"
    raise BayescalError(f"no column `{name}`", where, hint)


def parse(text: str, header: Sequence[str], width: int, where: str) -> Expression:
    """Read an expression on the columns of a header.

    Parameters
    ----------
    text : str
        The name of a column, or an expression.
    header : sequence of str
        Names of the columns; empty if there are none.
    width : int
        Number of columns.
    where : str
        For messages.

    Raises
    ------
    BayescalError
        For an unknown column, a text that is no expression, and a number that is the name of a column too.
    """
    is_name = text in header or any(name_and_unit(cell)[0] == text for cell in header)
    if is_name and is_number(text):
        what = f"`{text}` is the number {text} and the name of a column"
        raise BayescalError(what, where, f"write {{{text}}} for the column, {float(text)} for the number")
    tokens = None if is_name else _tokens(text)
    if tokens is None or (len(tokens) == 1 and tokens[0][0] != "number"):
        name = text if tokens is None else tokens[0][1]
        return Expression(text, (place(name, header, width, where),))
    columns: list[int] = []
    source = []
    for kind, token in tokens:
        if kind in ("number", "sign"):
            source.append(token)
        else:
            columns.append(place(token, header, width, where))
            source.append(f"c{columns[-1]}")
    try:
        tree = ast.parse(" ".join(source), mode="eval").body
        _check(tree)
    except (SyntaxError, ValueError, RecursionError):
        remedy = "use columns, numbers, + - * / and parentheses"
        raise BayescalError(f"'{text}' is no expression", where, remedy) from None
    return Expression(text, tuple(dict.fromkeys(columns)), tree)


def _tokens(text: str) -> list[tuple[str, str]] | None:
    """Kinds and texts of the tokens; None if the text has characters of no token."""
    out: list[tuple[str, str]] = []
    at = 0
    text = text.strip()
    while at < len(text):
        found = TOKEN.match(text, at)
        if found is None or len(text) > LONGEST:
            return None
        out.append(next((kind, token) for kind, token in found.groupdict().items() if token))
        at = found.end()
    operands = [kind == "sign" for kind, _ in out]
    return None if not any(operands) and len(out) > 1 else out  # words: the name of a column


def _check(tree: ast.AST) -> None:
    if isinstance(tree, ast.BinOp) and type(tree.op) in OPERATORS:
        _check(tree.left)
        _check(tree.right)
    elif isinstance(tree, ast.UnaryOp) and type(tree.op) in OPERATORS:
        _check(tree.operand)
    elif not isinstance(tree, ast.Name) and not (
        isinstance(tree, ast.Constant) and isinstance(tree.value, (int, float)) and math.isfinite(tree.value)
    ):
        raise ValueError


def _walk(tree: ast.AST, values: dict[str, np.ndarray]) -> np.ndarray:
    if isinstance(tree, ast.BinOp):
        return OPERATORS[type(tree.op)](_walk(tree.left, values), _walk(tree.right, values))
    if isinstance(tree, ast.UnaryOp):
        return OPERATORS[type(tree.op)](_walk(tree.operand, values))
    if isinstance(tree, ast.Name):
        return values[tree.id]
    assert isinstance(tree, ast.Constant)
    return np.asarray(float(str(tree.value)))
