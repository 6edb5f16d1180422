"""YAML that users write: the line of every value, keys with their unit; files that are written together."""

import difflib
import json
import math
import re
import secrets
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from operator import getitem
from pathlib import Path as File
from typing import Annotated, Any, NoReturn, Self, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from bayescal.errors import BayescalError, listed
from bayescal.storage.locks import OTHER_OUT, PART, beside, remove_leftovers, write_synchronised
from bayescal.storage.reading import CONTROL, decoded, explained, table_beside
from bayescal.storage.stopping import completed

_UNITS = table_beside(__file__, "units.toml")
UNITS = {unit: factor for unit, (factor, _, _) in _UNITS.items()}
"""Unit suffixes of keys and columns, and the factors to SI (degrees Celsius are kept)."""

FOREIGN = ("m", "cm", "um", "in", "inch", "radps", "mrad", "urad", "g", "k", "ms", "ncm", "mnm")
"""Suffixes of units that no file uses; an error message then names the correct suffix."""

ANGLES = ("deg", "rad", "mrad", "urad")

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
SMALLEST = 1e-9
"""Of a standard uncertainty that is not zero, in the unit of its key: less than any instrument has."""
Uncertain = Annotated[Positive, AfterValidator(lambda value: _not_tiny(value))]
MaybeKnown = Annotated[NotNegative, AfterValidator(lambda value: _not_tiny(value))]
Vector = tuple[Number, Number, Number]
Name = Annotated[str, Field(min_length=1, max_length=200)]
FILL_IN = "!FILL_IN"
"""Mark (a YAML tag) of a value that the user has still to write; a value behind it is only assumed."""
WRITE_OUT = "write the values out"
MORE_LINES = 6
"""Maximum number of further lines that an error message names."""
LARGEST_YAML = 5_000_000
"""Bytes of a YAML file; a session of 10,000 targets has 1 MB."""
DEEPEST = 30
"""Levels of a YAML file; the formats have five."""
MOST_VALUES = 100_000
"""Values of a YAML file, with those that its aliases repeat: a few lines can stand for 10^9."""
LONGEST_KEY, LONGEST_TEXT = 200, 20_000
"""Characters of a key, and of a value."""
RANGES = {unit: (float(low), float(high)) for unit, (_, low, high) in _UNITS.items()} | {"": (-1e9, 1e9)}
"""Numbers that are read, by the unit of their key."""
Path = tuple[str | int, ...]
M = TypeVar("M", bound=BaseModel)


def _not_tiny(value: float) -> float:
    if 0.0 < value < SMALLEST:
        raise PydanticCustomError("too_tiny", "too small", {"least": SMALLEST})
    return value


@lru_cache(maxsize=1024)
def stem_of(key: str) -> tuple[str, str]:
    """Split ``offset_mm`` into ``offset`` and ``mm``; the unit is empty where there is none."""
    for unit in sorted((*UNITS, *FOREIGN), key=len, reverse=True):
        if key.lower().endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""


def si(key: str) -> float:
    """Factor from a key's unit to SI; 1 where the key has none."""
    return UNITS.get(stem_of(key)[1], 1.0)


def in_si(key: str, value: Any) -> Any:
    """A value of a key in SI: a number, an array of a list; None of none."""
    if value is None:
        return None
    if isinstance(value, float):
        return value * si(key)
    import numpy as np  # commands that read no numbers do without it

    return np.array(value, float) * si(key)


def column_of(entries: Sequence[BaseModel], keys: Iterable[str]) -> Any:
    """Values (n, ...), SI, of a key of each of n entries ("" for none), nan where it is not stated.

    None without any.
    """
    import numpy as np

    keys = list(keys)
    values = [getattr(entry, key) if key else None for entry, key in zip(entries, keys, strict=True)]
    size = next((np.shape(value) for value in values if value is not None), None)
    if size is None:
        return None
    each = zip(values, keys, strict=True)
    return np.array([np.full(size, np.nan) if v is None else np.multiply(v, si(key)) for v, key in each])


UNREAD = {f"u_{axis}_mm": "state the largest of the three as `u_mm`" for axis in "xyz"}
UNREAD |= dict.fromkeys(("levelled", "u_level_rad", *(f"base_tilt_{of}_rad" for of in "xyu")), "leave it out")
"""Keys and columns of the format that are not read, and what to do instead."""


def unknown(noun: str, key: str, keys: Iterable[str]) -> tuple[str, str]:
    """Error and remedy for an unknown key or column."""
    if key in UNREAD:
        return f"{noun} `{key}` is not supported", UNREAD[key]
    keys = list(keys)
    stem, unit = stem_of(key)
    same = [k for k in keys if stem_of(k)[0] == stem and stem_of(k)[1]]
    same.sort(key=lambda k: bool(unit) and (stem_of(k)[1] in ANGLES) != (unit in ANGLES))
    if same and not unit:
        return f"{noun} `{key}` has no unit in its name", f"write `{same[0]}`"
    if same:
        return f"{noun} `{key}` has a wrong unit", f"write `{same[0]}`, and its value in that unit"
    near = difflib.get_close_matches(key, keys, 1, 0.6)
    return f"unknown {noun} `{key}`", f"is it `{near[0]}`?" if near else f"known are: {listed(keys, 12)}"


def range_of(key: str) -> tuple[float, float]:
    """Least and greatest number of a key or column, in its unit."""
    return RANGES.get(stem_of(key)[1], RANGES[""])


def outside(key: str, values: Iterable[float]) -> str:
    """What is wrong with numbers of a key or column, or ""; one that is not finite is wrong elsewhere."""
    unit = stem_of(key)[1]
    low, high = range_of(key)
    bad = [v for v in values if math.isfinite(v) and not low <= v <= high]
    if not bad:
        return ""
    side, limit = ("below", low) if bad[0] < low else ("above", high)
    return f"`{key}` holds {bad[0]:g}: {side} {limit:g} {unit}".rstrip()


class Keys(BaseModel):
    """A mapping of known keys: every other one is refused by name."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown(cls, data: Any) -> Any:
        keys = [f.alias or name for name, f in cls.model_fields.items()]
        for key in data if isinstance(data, dict) else ():
            if key not in keys:
                what, remedy = unknown("key", key, keys)
                context = {"key": key, "what": what, "remedy": remedy}
                raise PydanticCustomError("of_key", "unknown key", context)
        return data

    @model_validator(mode="after")
    def _refuse_outside(self) -> Self:
        for name in type(self).model_fields:
            if what := outside(name, _numbers_in(getattr(self, name))):
                context = {"key": name, "what": what, "remedy": "check the number and its unit"}
                raise PydanticCustomError("of_key", "out of range", context)
        return self


def _numbers_in(value: Any) -> Iterable[float]:
    """The numbers of a value: one, or those of lists in lists."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from _numbers_in(item)


@dataclass(frozen=True)
class Document:
    """A YAML file: plain `data` (scalars as text), the line of every value, and the `content` to hash.

    `unfilled` are the paths of values marked with `FILL_IN`, with the line of each mark.
    """

    name: str
    data: Any
    lines: dict[Path, int]
    content: bytes
    unfilled: dict[Path, int] = field(default_factory=dict)

    def where(self, path: Iterable[str | int]) -> str:
        """``file:line`` of the deepest part of `path` that the file holds."""
        deepest: Path = ()
        for part in path:  # pydantic's own parts, such as a union's tag, are not in the file
            if (*deepest, part) in self.lines:
                deepest = (*deepest, part)
        return f"{self.name}:{self.lines[deepest]}"

    def parse(self, model: type[M], assume: Collection[str] = ()) -> M:
        """Read as `model`, or tell of the first thing wrong.

        Values marked with `FILL_IN` are refused; below the keys `assume` only those without a value.
        """
        empty = [p for p in self.unfilled if reduce(getitem, p, self.data) in (None, [])]
        self._refuse_unfilled(empty if assume else [], " and has no value that could be assumed")
        self._refuse_unfilled([p for p in self.unfilled if p[:1] not in {(key,) for key in assume}])
        try:
            return model.model_validate(self.data)
        except ValidationError as error:
            errors = [explained(e) for e in error.errors(include_url=False)]
        path, what, remedy = min(errors, key=lambda e: int(self.where(e[0]).rpartition(":")[2]))
        raise BayescalError(what, self.where(path), remedy)

    def _refuse_unfilled(self, paths: list[Path], why: str = "") -> None:
        if not paths:
            return
        lines = sorted({self.unfilled[p] for p in paths})
        first = min(paths, key=lambda p: self.unfilled[p])
        further = [*map(str, lines[1 : 1 + MORE_LINES]), *(["..."] if len(lines) > 1 + MORE_LINES else [])]
        what = f"`{first[-1]}` is not filled in: it is marked {FILL_IN}"
        if further:
            plural = "s" * (len(lines) > 2)
            what += f", as are values in {len(lines) - 1} more line{plural} ({', '.join(further)})"
        raise BayescalError(what + why, f"{self.name}:{lines[0]}", "write your value and delete the mark")


def read_document(path: File) -> Document:
    """Read a YAML file; refuse duplicate keys, and anything that is not a mapping.

    Scalars remain text: a name such as ``on`` or ``12`` is not converted to a boolean or a number. The
    pydantic model parses numbers from the text.
    """
    text, content = decoded(path, LARGEST_YAML)
    reader = _Reader(path.name)
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        _check_size(yaml.parse(text, Loader=loader), path.name)
        node = yaml.compose(text, Loader=loader)
        data = reader.plain(node, (), frozenset())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path.name}:{mark.line + 1}" if mark else path.name
        raise BayescalError(f"not YAML: {error.problem}", where, "check indents and brackets") from None
    except yaml.YAMLError as error:
        raise BayescalError(f"not YAML: {error}", path.name) from None
    if not isinstance(data, dict):
        raise BayescalError("expected keys and values", f"{path.name}:1", "start with `schema: ...`")
    return Document(path.name, data, reader.lines, content, reader.unfilled)


def _check_size(events: Iterable[yaml.Event], name: str) -> None:
    """Refuse a file of too many levels or values, before a recursion descends into it."""
    depth = 0
    for number, event in enumerate(events):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST or number > 2 * MOST_VALUES:
            line = event.start_mark.line + 1 if event.start_mark else 1
            what = f"more than {DEEPEST} levels" if depth > DEEPEST else f"more than {MOST_VALUES} values"
            raise BayescalError(what, f"{name}:{line}", "check brackets and indents")


OF_SCHEMAS = {
    "bayescal-motion": "a joint log",
    "bayescal-dataset": "a session",
    "bayescal-robot": "a robot",
    "bayescal-artefact": "an artefact",
}
"""What files of a schema hold."""


def check_schema(document: Document, schema: str) -> None:
    """Refuse a document whose ``schema`` is missing or another than `schema`."""
    given = document.data.get("schema")
    if given == schema:
        return
    family = schema.partition("/")[0]
    if not isinstance(given, str):
        raise BayescalError("missing key `schema`", document.where(()), f"add `schema: {schema}`")
    if of := OF_SCHEMAS.get(given.partition("/")[0] if not given.startswith(family) else ""):
        what = f"schema `{given}` is that of {of}"
        raise BayescalError(what, document.where(("schema",)), f"expected is `{schema}`")
    what = f"schema `{given}` is " + ("of another version" if given.startswith(family) else "not known here")
    raise BayescalError(what, document.where(("schema",)), f"this version reads `{schema}`")


@dataclass(frozen=True)
class _Reader:
    """Turns the nodes of a YAML file to plain data, and collects the lines of values and of marks."""

    name: str
    lines: dict[Path, int] = field(default_factory=lambda: {(): 1})
    unfilled: dict[Path, int] = field(default_factory=dict)

    def plain(self, node: yaml.Node | None, path: Path, ancestors: frozenset[int]) -> Any:
        """Data of a node. `ancestors` holds the nodes being read: a loop of aliases is refused."""
        if node is None:
            return None
        if len(self.lines) > MOST_VALUES:
            self._refuse(node, f"more than {MOST_VALUES} values, with those that aliases repeat", WRITE_OUT)
        if node.tag == FILL_IN:
            self.unfilled[path] = node.start_mark.line + 1
        if isinstance(node, yaml.ScalarNode):
            self._check_text(node, "a value", LONGEST_TEXT)
            empty = ("",) if node.tag == FILL_IN else () if node.style else ("", "~", "null")
            return None if node.value in empty else node.value
        if id(node) in ancestors:
            self._refuse(node, "an alias contains itself", WRITE_OUT)
        inside = ancestors | {id(node)}
        if isinstance(node, yaml.SequenceNode):
            return [self._entry(item, item, (*path, i), inside) for i, item in enumerate(node.value)]
        values: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                self._refuse(key, "a key must be a plain name", "write `key: value`")
            self._check_text(key, "a key", LONGEST_KEY)
            if key.value in values:
                first = self.lines[(*path, key.value)]
                self._refuse(key, f"`{key.value}` is given twice", f"the first is in line {first}; keep one")
            values[key.value] = self._entry(key, value, (*path, key.value), inside)
        return values

    def _entry(self, start: yaml.Node, value: yaml.Node, path: Path, ancestors: frozenset[int]) -> Any:
        """Data of an entry of a list or mapping, which begins where `start` does."""
        self.lines[path] = start.start_mark.line + 1
        return self.plain(value, path, ancestors)

    def _check_text(self, node: yaml.ScalarNode, noun: str, longest: int) -> None:
        """Refuse a text too long to be meant, or with characters that an escape has written."""
        if len(node.value) > longest:
            what = f"{noun} of {len(node.value)} characters, at most {longest} are read"
            self._refuse(node, what, "shorten it")
        if match := CONTROL.search(node.value):
            character = match[0].encode("unicode_escape").decode()
            self._refuse(node, f"{noun} with the control character {character}", "delete it")

    def _refuse(self, node: yaml.Node, what: str, remedy: str) -> NoReturn:
        raise BayescalError(what, f"{self.name}:{node.start_mark.line + 1}", remedy)


def write_together(
    files: Mapping[File, str | bytes], before: Mapping[File, str | bytes] | None = None
) -> None:
    """Write files: first all of them under temporary names beside their places, then each is put in place.

    A folder that does not exist is created.

    Parameters
    ----------
    files : mapping
        Contents, in the order in which they are put in place.
    before : mapping, optional
        Contents that some of the files have until all others are in place, for a reader after a kill.

    Raises
    ------
    BayescalError
        If one cannot be written; then no file is changed.
    """
    every = [*(before or {}).items(), *files.items()]
    staged = [beside(path.absolute(), f"{secrets.token_hex(4)}.{PART}") for path, _ in every]
    for path in files:
        remove_leftovers(path.absolute())
    try:
        for (path, content), part in zip(every, staged, strict=True):  # noqa: B007  (named in the error)
            if not part.parent.exists():  # what is there and no folder is said when it is written to
                part.parent.mkdir(parents=True, exist_ok=True)
            write_synchronised(part, content.encode("utf-8") if isinstance(content, str) else content)
        for (path, _), part in zip(every, staged, strict=True):
            part.replace(path)
        completed(f"{', '.join(map(str, files))} written")
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be written", str(path), OTHER_OUT) from None
    finally:
        for part in staged:
            with suppress(OSError):
                part.unlink(missing_ok=True)


def json_text(record: Any, rows: bool = True) -> str:
    """A record as JSON text with an indent of one and all digits; `rows`: lists of numbers are on one line.

    Raises
    ------
    ValueError
        For a number that is not finite.
    """
    text = json.dumps(record, indent=1, allow_nan=False)
    if rows:
        text = re.sub(r"\[[-\d.eE+,\s]+\]", lambda numbers: " ".join(numbers[0].split()), text)
    return text + "\n"
