"""What of an output follows from each number of an input: found by changing the numbers one after another."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from numbers import Number
from types import GeneratorType
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from bayescal.reporting.sheet import Sheet

FACTOR = 1.25
"""By which a number is changed; a count is changed by 1."""


class End(str):
    """The place of a number in a pair: an end of an interval, or a value and its u."""

    __slots__ = ()


ENDS = End("first"), End("second")


def leaves(value: Any, path: tuple = ()) -> Iterator[tuple[tuple, Any]]:
    """Numbers, texts and arrays of numbers in what is nested, with their paths; cells of tables are texts."""
    if isinstance(value, float | int | str | np.ndarray):
        yield path, value
    elif isinstance(value, Text):
        yield path, value.plain
    elif isinstance(value, Sheet):
        yield from leaves([value.headings, value.rows], path)
    elif isinstance(value, Table):
        yield from leaves([list(column.cells) for column in value.columns], path)
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from leaves(part, (*path, key))
    elif isinstance(value, list | tuple | GeneratorType):
        each = list(value)
        of_numbers = all(type(x) is float for x in each)
        if of_numbers and len(each) > len(ENDS):
            yield path, np.array(each)
            return
        keys = ENDS if of_numbers and len(each) == len(ENDS) else range(len(each))
        for key, part in zip(keys, each, strict=True):
            yield from leaves(part, (*path, key))
    elif is_dataclass(value):
        for f in fields(value):
            yield from leaves(getattr(value, f.name), (*path, f.name))


def name_of(path: tuple) -> str:
    """A path without the places in lists, but of pairs."""
    return ".".join(str(part) for part in path if not isinstance(part, int))


def changed(value: Any, path: tuple) -> Any:
    """The same with another number at a path."""
    if not path:
        if isinstance(value, list | tuple):
            return type(value)(FACTOR * x for x in value)
        return value + 1 if type(value) is int else FACTOR * value
    key, *rest = path
    if isinstance(value, Mapping):
        return {**value, key: changed(value[key], tuple(rest))}
    if isinstance(value, list | tuple):
        at = ENDS.index(key) if isinstance(key, End) else key
        return type(value)(changed(x, tuple(rest)) if k == at else x for k, x in enumerate(value))
    return replace(value, **{key: changed(getattr(value, key), tuple(rest))})


def _is_changeable(leaf: Any) -> bool:
    """Whether it is a number, or an array of numbers, that is neither 0 nor unknown; rows are kept."""
    number = type(leaf) is int or np.asarray(leaf).dtype.kind == "f"
    return number and bool(np.any(np.isfinite(leaf) & (leaf != 0)))


def _alike(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    return a == b or (isinstance(a, float) and isinstance(b, float) and np.isnan(a) and np.isnan(b))


def influences(function: Callable[[Any], Any], given: Any) -> dict[str, set[str]]:
    """Of each number of an input, by name, the names of what changes with it.

    All numbers of one name are changed together.
    """
    paths: dict[str, list[tuple]] = {}
    for path, leaf in leaves(given):
        if _is_changeable(leaf):
            paths.setdefault(name_of(path), []).append(path)
    before, out = dict(leaves(function(given))), {}
    for name, every in paths.items():
        other = given
        for path in every:
            other = changed(other, path)
        after = dict(leaves(function(other)))
        every_path = before.keys() | after.keys()
        out[name] = {name_of(p) for p in every_path if not _alike(before.get(p), after.get(p))}
    return out


def numbers(value: Any, name: str) -> np.ndarray:
    """All finite numbers of a name."""
    found = [np.ravel(x) for path, x in leaves(value) if name_of(path) == name and isinstance(x, NUMBERS)]
    every = np.concatenate([np.zeros(0), *found]).astype(float)
    return every[np.isfinite(every)]


NUMBERS = (Number, np.ndarray)


def unseen(shown: Callable[[Any], Any], record: Any, but: str) -> list[str]:
    """Numbers of a record that change nothing of what is shown, but those whose name is of a pattern."""
    every = influences(shown, record)
    return [name for name, found in every.items() if not found and not re.fullmatch(but, name)]


def check_written(
    record: Callable[[Any], Any],
    given: Any,
    *,
    but: str,
    called: Mapping[str, str],
    units: Mapping[str, Callable[[np.ndarray], np.ndarray]],
) -> None:
    """Every number of a result is in its record, under its name, in the unit of the key; each key is of one.

    Parameters
    ----------
    record : callable
        The record of a result.
    given : nested
        The result.
    but : str
        Pattern of numbers that are part of names.
    called : mapping
        The words in the key of a number, where they are not those of its own name (`name.second`: of a u).
    units : mapping
        What is written, by the pattern of the key: the first that is found. Others are written as they are.
    """
    written, owner = record(given), {}
    for field, found in influences(record, given).items():
        if re.fullmatch(but, field):
            continue
        keys = [key for key in found if len(numbers(written, key))]
        assert keys, f"{field} is not in the record"
        parts = field.split(".")
        name = next(part for part in reversed(parts) if part not in ENDS)
        words = set(called.get(".".join(parts[-2:]), called.get(name, name)).lower().split("_"))
        for key in keys:
            assert owner.setdefault(key, field) == field, f"{key} follows from {field} and {owner[key]}"
            assert words <= {"", *re.split(r"[._]", key.lower())}, f"{key} follows from {field}"
            if parts[-1] in ENDS and (end := key.split(".")[-1]) in ENDS:
                assert parts[-1] == end, f"{key} follows from {field}"
            unit = next((unit for pattern, unit in units.items() if re.search(pattern, key)), np.copy)
            found_there = numbers(written, key)
            apart = np.abs(found_there[:, None] - unit(numbers(given, field))).min(axis=1)
            assert np.all(apart < 1e-4 + 1e-6 * np.abs(found_there)), f"{key} is not {field} in its unit"
