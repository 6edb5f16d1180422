"""Joint readings and measured points of two files, side by side."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, first


def by_row(log: Columns, points: Columns) -> tuple[Columns, str]:
    """The i-th row of one beside the i-th of the other; they must have as many."""
    if log.count != points.count:
        what = f"{log.count} rows in {log.name}, {points.count} in {points.name}"
        raise BayescalError(what, "--pair row", "map `id` in both files and pair them by id")
    return _joined(log, points), ""


def by_id(log: Columns, points: Columns) -> tuple[Columns, str]:
    """Rows of one id side by side, in the log's order; those without a partner are left out.

    Returns
    -------
    tuple of Columns and str
        The rows, and the excluded rows as text, or "".
    """
    for columns in (log, points):
        check_ids(columns)
    place = {name: row for row, name in enumerate(points.texts["id"].tolist())}
    known = np.array([name in place for name in log.texts["id"].tolist()])
    if not known.any():
        what = f"no id of {log.name} is in {points.name}"
        examples = f"`{log.texts['id'][0]}` and `{points.texts['id'][0]}` are the first ids"
        raise BayescalError(what, "--pair id", f"{examples}; map the right columns, or pair by row")
    log = log.take(known)
    partners = points.take(np.array([place[name] for name in log.texts["id"].tolist()]))
    lost, spare = int((~known).sum()), points.count - partners.count
    excluded = [
        f"{count} row{'s' * (count > 1)} of {name} without a partner"
        for count, name in ((lost, log.name), (spare, points.name))
        if count
    ]
    return _joined(log, partners), " and ".join(excluded)


def check_ids(columns: Columns) -> None:
    """Refuse a file without ids, or with one twice."""
    if "id" not in columns.texts:
        raise BayescalError("no column holds `id`", columns.name, "map it (`id=Name`), or pair by row")
    ids = columns.texts["id"].tolist()
    often = Counter(ids)
    twice = np.array([often[name] > 1 for name in ids])
    first(
        columns, twice, lambda row: f"id `{ids[row]}` is given twice", "keep a single row, or rename the id"
    )


PAIRS = {"row": by_row, "id": by_id}


def _joined(log: Columns, points: Columns) -> Columns:
    """All columns; the log's own id, if any, is kept."""
    both = (log.numbers.keys() & points.numbers.keys()) | (log.texts.keys() & points.texts.keys() - {"id"})
    if both:
        what = f"`{min(both)}` is in {log.name} and in {points.name}"
        raise BayescalError(what, points.name, "map it in one of them")
    return replace(
        log,
        numbers=log.numbers | points.numbers,
        texts=points.texts | log.texts,
        said=points.said | log.said,
    )
