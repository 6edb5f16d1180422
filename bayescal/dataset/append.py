"""Rows taken from a session, and rows appended to it: rows of it repeated under other conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from bayescal.dataset.types import Measurements


def taken(m: Measurements, rows: np.ndarray) -> Measurements:
    """Some rows (R,) of a session, in the given order."""
    table = {f.name: getattr(m, f.name) for f in fields(Measurements)}
    picked = {name: column[rows] for name, column in table.items() if name != "ids" and column is not None}
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

    The new rows have the role validate: a model of the fitted rows does not change by them.
    """
    table = {f.name: getattr(m, f.name) for f in fields(Measurements)}
    if m.payload is None and "payload" in changed:
        table["payload"] = np.zeros(len(m.role))
    table["ids"] = (*m.ids, *ids)
    for name, column in table.items():
        if name == "ids" or column is None:
            continue
        more = column[source]
        if name in changed:
            more = np.broadcast_to(changed[name], more.shape)
        table[name] = np.concatenate([column, more])
    table["role"][len(m.role) :] = "validate"
    return Measurements(**table)
