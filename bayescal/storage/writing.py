"""YAML that is written: numbers and texts, entries on one line, and keys with a value or a block below each.

Values are texts already: what is between a key and the end of its line.

Text that is written from templates of Jinja, in the folder `templates` beside a module.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from bayescal.storage.files import si

if TYPE_CHECKING:
    from jinja2 import Environment

Keys = Iterable[tuple[str, str]]
"""Keys of an entry with their values as text."""
Block = Mapping[str, "str | list[str] | Block | None"]
"""Keys with a text, entries that have a line each, or a block; what is empty is left out."""


def number(value: float, digits: int = 14) -> str:
    """Shortest text of a number to so many significant digits; no minus zero."""
    text = f"{float(value):.{digits}g}"
    return "0" if text == "-0" else text


def scalar(text: str) -> str:
    """A text as a YAML scalar on one line, also inside brackets: quoted where it must be."""
    if re.fullmatch(r"[A-Za-z][\w.@+/-]*( [\w.@+/-]+)*", text, re.ASCII) and yaml.safe_load(text) == text:
        return text
    return yaml.safe_dump(text, default_style='"', allow_unicode=True, width=10**9).removesuffix("\n")


def flow_list(texts: Iterable[str]) -> str:
    """A list on one line."""
    return f"[{', '.join(texts)}]"


def flow(items: Keys) -> str:
    """An entry on one line."""
    return "{" + ", ".join(f"{key}: {text}" for key, text in items) + "}"


def in_file(key: str, value: np.ndarray | float, digits: int = 14) -> str:
    """A value in SI as `key` has it: a number, or a list on one line, in its unit."""
    values = np.asarray(value) / si(key)
    return flow_list(number(v, digits) for v in values) if values.ndim else number(float(values), digits)


def row_keys(columns: Mapping[str, np.ndarray | None], row: int, digits: int = 14) -> Keys:
    """Keys with the values of a row of their columns in SI; what is nan, or no column, is left out."""
    given = ((key, column[row]) for key, column in columns.items() if column is not None)
    return ((key, in_file(key, value, digits)) for key, value in given if not np.isnan(value).any())


def block_lines(block: Block, indent: str = "") -> Iterator[str]:
    """The lines of a block; its keys are those of a format, or names that the user gave."""
    for name, value in block.items():
        key = f"{indent}{scalar(name)}:"
        if isinstance(value, str) and value:
            yield f"{key} {value}"
        elif isinstance(value, Mapping) and value:
            yield from (key, *block_lines(value, f"{indent}  "))
        elif value:
            yield from (key, *(f"{indent}  - {entry}" for entry in value))


def templates_beside(module: str, filters: Mapping[str, Callable[..., Any]], **syntax: Any) -> Environment:
    """The templates beside the file of a module; `syntax` as of `jinja2.Environment`."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # slow to import

    usual = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    loader = FileSystemLoader(Path(module).parent / "templates")
    out = Environment(loader=loader, undefined=StrictUndefined, **usual | syntax)
    out.filters |= filters
    return out
