"""Text that is written from templates of Jinja, in the folder `templates` beside a module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined


def templates_beside(module: str, filters: Mapping[str, Callable[..., Any]], **syntax: Any) -> Environment:
    """The templates beside the file of a module; `syntax` as of `jinja2.Environment`."""
    usual = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    loader = FileSystemLoader(Path(module).parent / "templates")
    out = Environment(loader=loader, undefined=StrictUndefined, **usual | syntax)
    out.filters |= filters
    return out
