"""What is wrong with a value of a file, and its remedy, in words, from the error of pydantic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic_core import ErrorDetails

Path = tuple[str | int, ...]

_TOLD: dict[str, Callable[[str, dict[str, Any], Any], tuple[str, str]]] = {
    "missing": lambda key, ctx, value: (f"missing {key}", "add it"),
    "float_parsing": lambda key, ctx, value: (f"{key} is not a number: {value!r}", "write a plain number"),
    "float_type": lambda key, ctx, value: (f"{key} is not a number", "write a plain number"),
    "finite_number": lambda key, ctx, value: (f"{key} is {value}, not a finite number", "write a number"),
    "greater_than": lambda key, ctx, value: (f"{key} is {value}", f"must be more than {ctx['gt']:g}"),
    "greater_than_equal": lambda key, ctx, value: (f"{key} is {value}", f"must be at least {ctx['ge']:g}"),
    "less_than_equal": lambda key, ctx, value: (f"{key} is {value}", f"must be at most {ctx['le']:g}"),
    "literal_error": lambda key, ctx, value: (f"{key} is {value!r}", f"must be {ctx['expected']}"),
    "union_tag_invalid": lambda key, ctx, value: (
        f"unknown kind {ctx['tag']!r} of {key}",
        f"must be one of {ctx['expected_tags']}",
    ),
    "union_tag_not_found": lambda key, ctx, value: (f"{key} has no `kind`", "add `kind: ...`"),
    "too_long": lambda key, ctx, value: (
        f"{key} has {ctx['actual_length']} entries",
        f"must have {ctx['max_length']}",
    ),
    "too_short": lambda key, ctx, value: (
        f"{key} has {ctx['actual_length']} entries",
        f"must have at least {ctx['min_length']}",
    ),
    "too_tiny": lambda key, ctx, value: (
        f"{key} is {value}",
        f"no uncertainty is less than {ctx['least']:g}",
    ),
    "not_a_date": lambda key, ctx, value: (f"{key} is {value!r}, not a date", "write it as YYYY-MM-DD"),
    "string_too_long": lambda key, ctx, value: (
        f"{key} has {len(value)} characters",
        f"must have at most {ctx['max_length']}",
    ),
    "string_too_short": lambda key, ctx, value: (f"{key} is empty", "write a name"),
    "string_type": lambda key, ctx, value: (f"{key} is not a text", "write one line of text"),
    "tuple_type": lambda key, ctx, value: (f"{key} is not a list", "write it as [.., .., ..]"),
    "model_type": lambda key, ctx, value: (f"{key} must hold keys and values", "write {key: value, ...}"),
}
_TOLD["dict_type"] = _TOLD["model_attributes_type"] = _TOLD["model_type"]
_TOLD["list_type"] = _TOLD["tuple_type"]


def told_of(error: ErrorDetails) -> tuple[Path, str, str]:
    """Path in the file, what is wrong and its remedy, of one pydantic error."""
    path, ctx = tuple(error["loc"]), dict(error.get("ctx") or {})
    if error["type"] == "of_key":
        return (*path, ctx["at"]), ctx["what"], ctx["remedy"]
    last = path[-1] if path else "the file"
    key = f"`{path[-2]}`, entry {last + 1}" if isinstance(last, int) and len(path) > 1 else f"`{last}`"
    told = _TOLD.get(error["type"], lambda key, ctx, value: (f"{key}: {error['msg']}", ""))
    return path, *told(key, ctx, error["input"])
