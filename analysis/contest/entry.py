"""An entry: what one tool states about one task, read and refused by the schema of entries."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from bayescal.errors import BayescalError

SCHEMA = Path(__file__).with_name("entry.schema.json")
NAME = "bayescal-entry/1"
Names = dict[frozenset[str], float]
"""Probabilities of sets of effects."""


@dataclass(frozen=True)
class Entry:
    """Positions (N, 3), mm, of all rows of a task, in their order; u (N,), mm, nan where not stated."""

    tool: str
    seconds: float
    points: np.ndarray
    u: np.ndarray
    names: Names | None


@cache
def _validator() -> Draft202012Validator:
    return Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))


def read_entry(path: Path, task: str, ids: Sequence[str]) -> Entry:
    """Read an entry for a task with these rows.

    Raises
    ------
    BayescalError
        In one line, for what is not an entry of this task.
    """

    def refuse(what: str, remedy: str = "see docs/contest.md") -> NoReturn:
        raise BayescalError(what, str(path), remedy)

    def constant(text: str) -> NoReturn:
        refuse(f"has the value {text}", "state finite numbers")

    try:
        record = json.loads(path.read_text(encoding="utf-8"), parse_constant=constant)
    except (OSError, ValueError) as error:
        refuse(f"is no JSON text ({str(error).splitlines()[0]})")
    error = best_match(_validator().iter_errors(record))
    if error is not None:
        refuse(f"{error.json_path}: {error.message[:160]}")
    if record["task"] != task:
        refuse(f"is of the task {record['task']}, not of {task}")
    rows = {r["id"]: r for r in record["rows"]}
    if len(rows) < len(record["rows"]):
        refuse("states a row twice")
    if lacks := [name for name in ids if name not in rows]:
        refuse(f"lacks {len(lacks)} of {len(ids)} rows, the first is {lacks[0]}")
    if other := rows.keys() - set(ids):
        refuse(f"has a row {min(other)} that the task does not have")
    numbers = np.array([[*rows[name]["tcp_mm"], rows[name].get("u_mm", np.nan)] for name in ids], float)
    names = of_sets(record["names"]) if "names" in record else None
    if names is not None and sum(names.values()) > 1 + 1e-6:
        refuse("states probabilities of names that add up to more than 1")
    return Entry(record["tool"], record["seconds"], numbers[:, :3], numbers[:, 3], names)


def of_sets(said: Sequence[dict[str, Any]]) -> Names:
    """Probabilities by set; that of a class is divided evenly among its members."""
    out: Names = {}
    for item in said:
        effects = item["effects"]
        sets = [frozenset((name,)) for name in effects] if item.get("any") else [frozenset(effects)]
        for one in sets:
            out[one] = out.get(one, 0.0) + item["probability"] / len(sets)
    return out


def record_of(
    tool: str, task: str, ids: Sequence[str], points: np.ndarray, seconds: float,
    u: np.ndarray | None = None, names: Names | None = None,
) -> dict[str, Any]:  # fmt: skip
    """An entry as JSON data, of positions (N, 3) and u (N,), mm."""
    rows: list[dict[str, Any]] = [
        {"id": name, "tcp_mm": [round(float(x), 7) for x in p]} for name, p in zip(ids, points, strict=True)
    ]
    if u is not None:
        for row, value in zip(rows, u, strict=True):
            if np.isfinite(value):
                row["u_mm"] = round(float(value), 7)
    out = {"schema": NAME, "tool": tool, "task": task, "seconds": round(seconds, 3), "rows": rows}
    if names is not None:
        said = sorted(names.items(), key=lambda pair: (-pair[1], sorted(pair[0])))
        out["names"] = [{"effects": sorted(s), "probability": p} for s, p in said]
    return out
