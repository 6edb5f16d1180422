"""Rows taken from a session, and rows appended to it: repeated under other conditions, or measured later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from bayescal.dataset.join import PAUSE, stacked
from bayescal.dataset.table import LABELS
from bayescal.dataset.types import Measurements


def taken(m: Measurements, rows: np.ndarray) -> Measurements:
    """Some rows (R,) of a session, in the given order."""
    table = {f.name: getattr(m, f.name) for f in fields(Measurements)}
    picked = {name: values[rows] for name, values in table.items() if name != "ids" and values is not None}
    return Measurements(**table | picked | {"ids": tuple(m.ids[k] for k in rows)})


def appended(
    m: Measurements, source: np.ndarray, changed: Mapping[str, Any], ids: Sequence[str]
) -> Measurements:
    """The rows of a session (N,), followed by rows (C,) that repeat some of them with other values.

    Parameters
    ----------
    m : Measurements
    source : np.ndarray of int, shape (C,)
        The row that each new row repeats.
    changed : mapping
        New values (C, ...), or one for all, of columns by their name; a column that the session lacks is not
        added, except a payload, which is 0 in its rows.
    ids : sequence of str
        Names of the new rows.

    The new rows have the role validate: a model of the fitted measurements does not change by them.
    """
    later = taken(m, source)
    if later.payload is None and "payload" in changed:
        later = replace(later, payload=np.zeros(len(source)))
    columns = {name: getattr(later, name) for name in changed}
    other = {name: np.broadcast_to(changed[name], v.shape) for name, v in columns.items() if v is not None}
    role = np.full(len(source), "validate")
    columns, _ = stacked([m, replace(later, ids=tuple(ids), role=role, **other)])
    return Measurements(**columns)


def followed(m: Measurements, later: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """The rows of a session, followed by rows that were measured later, on the same targets.

    Times that begin again continue `PAUSE` after the session. A label of the later rows that the session has
    too is another label.

    Returns
    -------
    Measurements
    tuple of str
        Columns that only one of both has and that have no empty cell: they are left out.
    """
    table, lost = stacked([m, later])
    for name in LABELS:
        if table[name] is not None:
            table[name] = _relabelled(table[name], len(m.ids))
    if table["time"] is not None and np.min(later.time) <= np.max(m.time):  # type: ignore[arg-type]
        table["time"][len(m.ids) :] += np.max(m.time) + PAUSE - np.min(later.time)  # type: ignore[arg-type]
    return Measurements(**table), lost


def _relabelled(labels: np.ndarray, before: int) -> np.ndarray:
    """Labels (N,) of which those from a row on differ from those before it."""
    earlier, later = labels[:before].tolist(), labels[before:].tolist()
    taken_names = set(earlier) - {""}
    return np.array([*earlier, *(f"{label}.later" if label in taken_names else label for label in later)])
