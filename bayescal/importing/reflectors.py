"""Several reflectors or instruments at one standstill: a row for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns

MEASURED = ("x", "y", "z", "length")
"""Quantities of which a file with one holds measurements, not conditions."""

OWN = ("tool", "target")
"""Texts by which several rows of points with one id differ."""


def distinct(columns: Columns) -> Columns:
    """The rows with ids of their own: those of one id get the name of their tool, or target, or a number."""
    if "id" not in columns.texts:
        return columns
    ids = columns.texts["id"].tolist()
    for key in OWN:
        often = Counter(ids)
        if key in columns.texts and max(often.values()) > 1:
            names = columns.texts[key].tolist()
            ids = [f"{i}.{name}" if often[i] > 1 else i for i, name in zip(ids, names, strict=True)]
    return replace(columns, texts=columns.texts | {"id": np.array(ids)})


def stacked(parts: Sequence[Columns]) -> Columns:
    """Rows of several tools or instruments that were measured at the rows of one log, in its order.

    Raises
    ------
    BayescalError
        If the parts do not have the same quantities, or none says which tool or target it is.
    """
    one = parts[0]
    for other in parts[1:]:
        differ = one.numbers.keys() ^ other.numbers.keys() | one.texts.keys() ^ other.texts.keys()
        if differ:
            what = f"`{min(differ)}` is not in all files of points"
            raise BayescalError(what, other.name, "map the same quantities in each")
    if not any(key in one.texts for key in OWN):
        what = "several files hold points"
        raise BayescalError(what, one.name, "map `tool` (a reflector) or `target` (an instrument) in each")
    line = np.concatenate([p.line for p in parts])
    order = np.argsort(line, kind="stable")
    numbers = {k: np.concatenate([p.numbers[k] for p in parts])[order] for k in one.numbers}
    texts = {k: np.concatenate([p.texts[k] for p in parts])[order] for k in one.texts}
    return distinct(replace(one, line=line[order], numbers=numbers, texts=texts))


def unfolded(columns: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Points of several reflectors in one row (``x@A``, ``x@B``) as a row for each.

    Returns
    -------
    tuple of Columns and tuple of str
        And a note on reflectors that were not measured in some rows.
    """
    keys = [key for key in (*columns.numbers, *columns.said) if "@" in key]
    tools = list(dict.fromkeys(key.partition("@")[2] for key in keys))
    if not tools:
        return columns, ()
    if clash := next((k for k in ("tool", "x") if k in columns.texts or k in columns.numbers), None):
        what = f"`{clash}` and `{keys[0]}` are both mapped"
        raise BayescalError(what, columns.name, "keep those of the reflectors alone")
    parts, missing = [], 0
    for tool in tools:
        own = {k.partition("@")[0]: v for k, v in columns.numbers.items() if k.endswith(f"@{tool}")}
        numbers = {k: v for k, v in columns.numbers.items() if "@" not in k} | own
        said = {k.partition("@")[0]: c for k, c in columns.said.items() if k.partition("@")[2] in ("", tool)}
        texts = columns.texts | {"tool": np.full(columns.count, tool)}
        seen = np.any(
            [np.isfinite(own[k]) for k in MEASURED if k in own] or [np.zeros(columns.count, bool)], axis=0
        )
        missing += int((~seen).sum())
        parts.append(replace(columns, numbers=numbers, texts=texts, said=said).take(seen))
    note = f"{missing} points of {len(tools)} reflectors excluded: not measured"
    return stacked(parts), (note,) if missing else ()
