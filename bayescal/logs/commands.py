"""Commands of motions as a table: `t_s`, `motion`, `q1_deg` ..., one row a step; at rest between motions."""

from __future__ import annotations

import io
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.storage.reading import LARGEST, decoded

Commands = tuple[str, np.ndarray, np.ndarray]
"""Name of a motion, times (N,), s, and readings (N, n), rad."""


def commands_text(motions: Iterable[Commands]) -> str:
    """The table of some motions."""
    lines: list[str] = []
    for name, time, q in motions:
        if not lines:
            lines.append(",".join(["t_s", "motion", *(f"q{j + 1}_deg" for j in range(q.shape[1]))]))
        rows = zip(time.tolist(), np.degrees(q).tolist(), strict=True)
        lines += [f"{t:.6g},{name}," + ",".join(f"{x:.5f}" for x in row) for t, row in rows]
    return "\n".join([*lines, ""])


def read_commands(path: Path) -> tuple[Commands, ...]:
    """The motions of a table of commands.

    Raises
    ------
    BayescalError
        With the line, for columns that are missing, cells that are no numbers, and times that go back.
    """
    import pandas as pd

    table = pd.read_csv(io.StringIO(decoded(path, LARGEST)[0]), dtype=str)
    joints = [f"q{j + 1}_deg" for j in range(len(table.columns) - 2)]
    if list(table.columns) != ["t_s", "motion", *joints] or not joints or table.empty:
        remedy = "write `t_s`, `motion`, and `q1_deg` ... of every joint"
        raise BayescalError("the columns are not those of commands", f"{path}:1", remedy)
    values = table[["t_s", *joints]].apply(pd.to_numeric, errors="coerce").to_numpy(float)
    wrong = ~np.isfinite(values).all(axis=1) | (np.diff(values[:, 0], prepend=-np.inf) <= 0.0)
    if wrong.any():
        what = "a cell is no number, or `t_s` does not increase"
        raise BayescalError(what, f"{path}:{int(np.argmax(wrong)) + 2}", "correct the row")
    labels = table["motion"].to_numpy()
    first = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), len(labels)]
    return tuple((str(labels[a]), values[a:b, 0], np.radians(values[a:b, 1:])) for a, b in pairwise(first))
