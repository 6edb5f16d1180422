"""Files of other people: regular ones of bounded size, whose text is printable.

What is wrong with a value of a file, and its remedy, in words, from the error of pydantic.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError, shown

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

LARGEST = 2**29
"""Bytes of a table, a log or a record: some million rows."""
Json = Mapping[str, Any]
"""The content of a record: fit.json, gap.json, ..."""
MOTION = ("Nm", "deg")
"""`unit` of the record of a joint log."""
TOGETHER = "together"
"""In its place, of a session and a log that were fitted together."""
DIGITS = 30
"""Characters of a whole number in a record: no count or seed has more."""
CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Characters that act on a terminal or reverse the direction of writing; no text of a session has them."""


def content_of(path: Path, largest: int = LARGEST) -> bytes:
    """Bytes of a regular file.

    Raises
    ------
    BayescalError
        If there is no such file, if it is larger than `largest`, and of a pipe, a socket, a device or a
        folder, which may be endless.
    """
    try:
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > largest:
                what = f"the file has {size / 1e6:.0f} MB, at most {largest / 1e6:.0f} MB are read"
                raise BayescalError(what, path.name, "divide it, or check that it is the right file")
            return stream.read(largest)
    except FileNotFoundError:
        raise BayescalError("no such file", path.name, f"looked in {path.parent}") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BayescalError(f"cannot be read: {why}", path.name, "give a readable file") from None


def table_beside(module: str, name: str) -> dict[str, Any]:
    """The content of a TOML file of the package, beside the file of a module."""
    return tomllib.loads(Path(module).with_name(name).read_text("utf-8"))


def library(name: str, what: str, where: str, remedy: str) -> Any:
    """A module of an optional package.

    Raises
    ------
    BayescalError
        Of these texts, if it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise BayescalError(what, where, remedy) from None


@contextmanager
def open_regular(path: Path) -> Iterator[BufferedReader]:
    """A regular file, to be read.

    Raises
    ------
    OSError
        As `open`.
    BayescalError
        Of a pipe, a socket, a device or a folder.
    """
    with open(path, "rb", opener=_without_waiting) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise BayescalError("is not a regular file", path.name, "give a file on disk")
        yield stream


def _without_waiting(path: str, flags: int) -> int:
    """Open a file; a pipe without a writer does not block."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def check_inside(path: Path, folder: Path, what: str) -> None:
    """Refuse a file outside a folder: a dataset is complete, and names no other file of its reader.

    Raises
    ------
    BayescalError
        For an absolute path, one that leaves the folder, and a link to a file elsewhere.
    """
    try:  # links that lead to one another: an error, and from Python 3.13 on what is left is a link
        real = path.resolve()
        circular = real.is_symlink()
    except (OSError, RuntimeError):
        circular = True
    if circular:
        raise BayescalError(f"{what} is a link to itself", path.name, "give a file on disk")
    if not real.is_relative_to(folder.resolve()):
        remedy = "copy the file into the folder, and name the copy"
        raise BayescalError(f"{what} is outside the dataset folder", path.name, remedy)


def decoded(path: Path, largest: int = LARGEST) -> tuple[str, bytes]:
    """Text and bytes of a UTF-8 file (a byte order mark is dropped).

    Raises
    ------
    BayescalError
        As `content_of`, and for a file that is empty, is not UTF-8 or has control characters.
    """
    content = content_of(path, largest)
    return text_of(content, path.name), content


def text_of(content: bytes, name: str) -> str:
    """The text of the bytes of a UTF-8 file; raises as `decoded`."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise BayescalError("not UTF-8 text", f"{name}:{line}", "save the file as UTF-8") from None
    if not text.strip():
        raise BayescalError("the file is empty", name, "`bayescal init` writes an example of what it holds")
    if match := CONTROL.search(text):
        line = text.count("\n", 0, match.start()) + 1
        what = f"control character {shown(match[0].encode('unicode_escape').decode())}"
        raise BayescalError(what, f"{name}:{line}", "delete it")
    return text


def read_json(path: Path, remedy: str) -> Any:
    """Content of a JSON file that a command wrote; numbers are finite.

    Raises
    ------
    BayescalError
        If it cannot be read, is no JSON, or has a number that is not finite.
    """
    try:
        text = content_of(path).decode("utf-8")
        return json.loads(text, parse_constant=_refuse, parse_float=_finite, parse_int=_whole)
    except BayescalError as error:
        raise BayescalError(error.what, str(path), remedy) from None
    except (ValueError, RecursionError) as error:
        why = "nested too deeply" if isinstance(error, RecursionError) else error
        raise BayescalError(f"invalid JSON: {why}", str(path), remedy) from None


def read_record(path: Path, schema: str, remedy: str) -> dict[str, Any]:
    """A record with its `schema`, as `read_json`.

    Raises
    ------
    BayescalError
        As `read_json`, and of another schema.
    """
    record = read_json(path, remedy)
    given = record.get("schema") if isinstance(record, dict) else None
    if not isinstance(record, dict) or given != schema:
        raise BayescalError(f"the schema is {given}, not {schema}", str(path), remedy)
    return record


def run_record(folder: Path, *kinds: str) -> tuple[str, dict[str, Any]]:
    """Which of some kinds of run a folder is, `fit` with fit.json and so on, and its record.

    Raises
    ------
    BayescalError
        As `read_record`, and of a folder without such a record.
    """
    kind = next((kind for kind in kinds if (folder / f"{kind}.json").is_file()), None)
    if kind is None:
        *some, last = kinds
        remedy = f"give a run folder of bayescal {', '.join(some)} or {last}"
        names = " or ".join(f"{kind}.json" for kind in kinds)
        raise BayescalError(f"there is no {names}", str(folder), remedy)
    path, schema = folder / f"{kind}.json", f"bayescal-{kind}/1"
    return kind, read_record(path, schema, "repeat the command with this version")


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a finite number")


def _whole(text: str) -> int:
    return int(text) if len(text) <= DIGITS else int(_refuse(text))


def _finite(text: str) -> float:
    value = float(text)
    return value if abs(value) < float("inf") else _refuse(text)


Where = tuple[str | int, ...]

_ERRORS = table_beside(__file__, "refusals.toml")
"""What is wrong and its remedy, by the type of the error."""


def explained(error: ErrorDetails) -> tuple[Where, str, str]:
    """Path in the file, what is wrong and its remedy, of one pydantic error."""
    path, value, context = tuple(error["loc"]), error["input"], error.get("ctx") or {}
    if error["type"] == "of_key":
        return (*path, context["key"]), context["what"], context["remedy"]
    last = path[-1] if path else "the file"
    key = f"`{path[-2]}`, entry {last + 1}" if isinstance(last, int) and len(path) > 1 else f"`{last}`"
    if error["type"] not in _ERRORS:
        return path, f"{key}: {error['msg']}", ""
    values = {**context, "key": key, "value": value, "length": len(str(value))}
    what, remedy = (text.format_map(values) for text in _ERRORS[error["type"]])
    return path, what, remedy
