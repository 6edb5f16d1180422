"""From quantities to the rows of a dataset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.dataset import Measurements, Target, Tool
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.files import unknown
from bayescal.importing.columns import Columns, first
from bayescal.importing.orientations import measured


def readings(columns: Columns, n: int) -> np.ndarray:
    """Joint readings (N, n), rad; all joints of every row are needed."""
    block = _block(columns, [f"j{i + 1}" for i in range(n)])
    if block is None:
        raise BayescalError("no column holds `j1`", columns.name, f"map j1 to j{n}")
    bad = np.isnan(block)
    first(columns, bad.any(axis=1), lambda row: f"`j{np.argmax(bad[row]) + 1}` is empty", "fill in the cell")
    return block


def points(columns: Columns) -> np.ndarray | None:
    """What an instrument read (N, 3), m, nan in rows it did not; None where no column holds it."""
    return _block(columns, ["x", "y", "z"])


def names(columns: Columns, key: str) -> list[str]:
    """The names in a text column, each once, as they first come."""
    return list(dict.fromkeys(columns.texts[key].tolist())) if key in columns.texts else []


def measurements(
    columns: Columns, joints: np.ndarray, tools: Sequence[Tool], targets: Sequence[Target]
) -> Measurements:
    """The rows in SI units, with joint readings (N, n), rad.

    A row without an id is called by its line. Rows of several tools at one and the same reading of all
    joints were taken at one standstill.
    """
    n, count = joints.shape[1], columns.count
    number, text = columns.numbers.get, columns.texts.get
    tool = _index(columns, "tool", [t.name for t in tools])
    stop = text("stop")
    if stop is None and len(tools) > 1:
        stop = _standstills(joints)
    return Measurements(
        ids=tuple(map(str, columns.texts["id"]))
        if "id" in columns.texts
        else tuple(f"r{i}" for i in columns.line),
        role=columns.texts.get("role", np.full(count, "calibrate")),
        target=_index(columns, "target", _sought(columns, targets)),
        tool=tool,
        readings=joints,
        line=np.arange(2, count + 2),
        velocity=_block(columns, [f"j{i + 1}_velocity" for i in range(n)]),
        xyz=points(columns),
        rpy=measured(columns),
        length=number("length"),
        u=number("u"),
        stop=stop,
        command=_block(columns, [f"j{i + 1}_command" for i in range(n)]),
        torque=_block(columns, [f"j{i + 1}_torque" for i in range(n)]),
        time=number("time"),
        temperature=number("temperature"),
        payload=number("payload"),
        repeat=text("repeat"),
    )


def _block(columns: Columns, keys: list[str]) -> np.ndarray | None:
    """Quantities side by side (N, k), or None where none of them is given; some of them is an error."""
    missing = [key for key in keys if key not in columns.numbers]
    if not missing:
        return np.column_stack([columns.numbers[key] for key in keys])
    if len(missing) == len(keys):
        return None
    what = f"`{missing[0]}` is not mapped, `{next(k for k in keys if k not in missing)}` is"
    raise BayescalError(what, columns.name, f"map all of {', '.join(keys)}, or none")


def _sought(columns: Columns, targets: Sequence[Target]) -> list[str]:
    """Names of the targets that rows may be of: points without a name are an only instrument's."""
    if "target" in columns.texts or points(columns) is None:
        return [t.name for t in targets]
    instruments = [t.name for t in targets if KINDS[t.kind].reads == "xyz"]
    return instruments if len(instruments) == 1 else [t.name for t in targets]


def _index(columns: Columns, key: str, known: list[str]) -> np.ndarray:
    """Row by row the index into `known`; an only one needs no naming."""
    if key not in columns.texts:
        if len(known) > 1:
            some = ", ".join(known[:8])
            raise BayescalError(
                f"the {key} of the rows is not stated", columns.name, f"map `{key}`; there are {some}"
            )
        return np.zeros(columns.count, int)
    given = columns.texts[key]
    bad = ~np.isin(given, known)
    if bad.any():
        _, remedy = unknown(key, str(given[np.argmax(bad)]), known)
        first(columns, bad, lambda row: f"unknown {key} `{given[row]}`", remedy)
    place = {name: i for i, name in enumerate(known)}
    return np.array([place[name] for name in given.tolist()])


def _standstills(joints: np.ndarray) -> np.ndarray | None:
    """Names (N,) of the standstills, "" of rows alone at theirs; None where all are."""
    _, which, count = np.unique(joints, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    return (
        np.where(count[which] > 1, np.char.add("s", (which + 1).astype(str)), "")
        if (count > 1).any()
        else None
    )
