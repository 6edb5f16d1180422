"""From quantities to the rows of a dataset, and their roles by a stated rule: whole stops, without chance."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from math import ceil

import numpy as np

from bayescal.dataset import Dataset, Measurements, Target, Tool
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, first
from bayescal.importing.orientations import measured
from bayescal.storage.files import unknown

REMEDY = "write every:5, stop (as every:5), last:20%, targets 'ball.*' or stops 'b*'"
"""Rules that are known."""

SINGLE = {"length": "mm", "u": "mm", "time": "s", "temperature": "°C", "payload": "kg"}
"""Quantities of one number a row, called alike in the rows of a dataset, and their units in notes."""


def stops_of(rows: Measurements) -> np.ndarray:
    """Number (N,) of the standstill of each row, in the order of their first rows."""
    from bayescal.estimate.families import poses  # slow to import, and most logs state no rule

    pose = poses(rows, np.arange(len(rows.ids)))
    _, first_row, number = np.unique(pose, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first_row))[number]


def with_roles(dataset: Dataset, rule: str, where: str) -> tuple[Dataset, str]:
    """Give the rows that a rule selects the role `validate`, the others `calibrate`.

    Parameters
    ----------
    dataset : Dataset
    rule : str
        ``every:5`` (every fifth stop), ``stop`` (the same), ``last:20%`` (of the stops), ``targets 'ball.*'``
        or ``stops 'b*'`` (names, with ``*`` and ``?``; several with commas).
    where : str
        Where the rule is stated, for messages.

    Returns
    -------
    tuple of Dataset and str
        And the rule with its result, in words.

    Raises
    ------
    BayescalError
        For an unknown rule, for one that selects no row or all rows, and for one that splits a stop.
    """
    rows = dataset.measurements
    stops = stops_of(rows)
    chosen, words = _chosen(dataset, stops, rule, where)
    shared = np.bincount(stops, chosen) * np.bincount(stops, ~chosen) > 0
    if shared.any():
        which = np.flatnonzero(stops == np.argmax(shared))
        one, other = rows.ids[which[chosen[which]][0]], rows.ids[which[~chosen[which]][0]]
        what = f"'{rule}' selects `{one}` but not `{other}`, which was measured at the same stop"
        raise BayescalError(what, where, "name the targets of whole stops")
    count = int(chosen.sum())
    if not 0 < count < len(chosen):
        what = f"'{rule}' selects {'all' if count else 'none'} of the {len(chosen)} rows"
        raise BayescalError(what, where, "leave rows to fit and rows to validate; " + REMEDY)
    role = np.where(chosen, "validate", "calibrate")
    note = f"validation measurements: {count} of {len(chosen)} rows ({words})"
    return replace(dataset, measurements=replace(rows, role=role)), note


def role_note(dataset: Dataset) -> str:
    """The validation measurements that the log or the plan states, or what states some."""
    role = dataset.measurements.role
    count = int((role == "validate").sum())
    if count:
        return f"validation measurements: {count} of {len(role)} rows, as stated"
    remedy = "`--validate every:5` makes every fifth stop a validation stop"
    return f"validation data: none, all {len(role)} rows are fitted; {remedy}"


@dataclass(frozen=True)
class Rule:
    """A rule that selects some of what is numbered from 0: ``every:5``, ``last:20%`` or ``NAME 'a*, b*'``."""

    name: str
    value: str

    @classmethod
    def read(cls, text: str) -> Rule:
        """The rule in a text; of no name where it is none."""
        parts = re.fullmatch(r"([a-z]+)(?:[:\s]\s*(.+))?", text.strip())
        return cls(parts[1], parts[2] or "") if parts else cls("", "")

    def by_number(self, number: np.ndarray) -> np.ndarray | None:
        """Which of the numbers (N,) are selected, bool; None where numbers do not matter."""
        total, percent = int(number.max()) + 1, re.fullmatch(r"([\d.]+)\s*%", self.value)
        if self.name == "every" and re.fullmatch(r"\d+", self.value) and int(self.value) > 1:
            return np.asarray((number + 1) % int(self.value) == 0)
        if self.name == "last" and percent and 0 < float(percent[1]) < 100:
            return np.asarray(number >= total - ceil(round(total * float(percent[1]) / 100, 9)))
        return None

    @property
    def patterns(self) -> list[str]:
        """Names, with ``*`` and ``?``."""
        return [p for part in self.value.split(",") if (p := part.strip().strip("'\""))]


def _chosen(dataset: Dataset, stops: np.ndarray, text: str, where: str) -> tuple[np.ndarray, str]:
    """Rows that a rule selects (N,), bool, and the rule in words."""
    total, rule = int(stops.max()) + 1, Rule.read(text)
    if rule == Rule("stop", ""):
        rule = Rule("every", "5")
    if (chosen := rule.by_number(stops)) is not None:
        every = f"stop {rule.value} of every {rule.value}, {total} stops"
        last = f"the last {len(set(stops[chosen].tolist()))} of {total} stops"
        return chosen, every if rule.name == "every" else last
    if rule.name in ("targets", "stops") and rule.patterns:
        return _named(dataset, rule.name, rule.patterns, where), f"{rule.name} {', '.join(rule.patterns)}"
    raise BayescalError(f"'{text}' is not a rule for validation measurements", where, REMEDY)


def _named(dataset: Dataset, noun: str, patterns: Sequence[str], where: str) -> np.ndarray:
    """Rows whose target or stop has one of the names."""
    rows = dataset.measurements
    if noun == "targets":
        names = np.array([t.name for t in dataset.targets])[rows.target]
    elif rows.stop is not None:
        names = rows.stop
    else:
        raise BayescalError("the rows do not state their stops", where, "map `stop`; " + REMEDY)
    selected = np.zeros(len(names), bool)
    for pattern in patterns:
        matches = np.array([fnmatchcase(name, pattern) for name in names.tolist()])
        if not matches.any():
            some = ", ".join(dict.fromkeys(n for n in names.tolist()[:200] if n))
            raise BayescalError(f"no {noun[:-1]} of a row is called `{pattern}`", where, f"there are {some}")
        selected |= matches
    return selected


def readings(columns: Columns, n: int) -> np.ndarray:
    """Joint readings (N, n), rad; all joints of every row are needed."""
    block = columns.block(_joints(n))
    if block is None:
        raise BayescalError("no column holds `j1`", columns.name, f"map j1 to j{n}")
    bad = np.isnan(block)
    first(columns, bad.any(axis=1), lambda row: f"`j{np.argmax(bad[row]) + 1}` is empty", "fill in the cell")
    return block


def points(columns: Columns) -> np.ndarray | None:
    """What an instrument read (N, 3), m, nan in rows it did not; None where no column holds it."""
    return columns.block(("x", "y", "z"))


def names(columns: Columns, key: str) -> list[str]:
    """The names in a text column, each once, as they first come."""
    return list(dict.fromkeys(columns.cells[key].tolist())) if key in columns.cells else []


def measurements(
    columns: Columns, joints: np.ndarray, tools: Sequence[Tool], targets: Sequence[Target]
) -> Measurements:
    """The rows in SI units, with joint readings (N, n), rad.

    A row without an id is called by its line. Rows of several tools at one and the same reading of all
    joints were taken at one standstill.
    """
    n, count, text = joints.shape[1], columns.count, columns.cells.get
    tool = _index(columns, "tool", [t.name for t in tools])
    stop = text("stop")
    if stop is None and len(tools) > 1:
        stop = _standstills(joints)
    return Measurements(
        ids=tuple(map(str, text("id", [f"r{i}" for i in columns.line]))),
        role=text("role", np.full(count, "calibrate")),
        target=_index(columns, "target", _sought(columns, targets)), tool=tool, readings=joints,
        line=np.arange(2, count + 2), velocity=columns.block(_joints(n, "_velocity")), xyz=points(columns),
        rpy=measured(columns), stop=stop, command=columns.block(_joints(n, "_command")),
        torque=columns.block(_joints(n, "_torque")), repeat=text("repeat"),
        **{key: columns.cells.get(key) for key in SINGLE},
    )  # fmt: skip


def _joints(n: int, suffix: str = "") -> list[str]:
    return [f"j{i + 1}{suffix}" for i in range(n)]


def _sought(columns: Columns, targets: Sequence[Target]) -> list[str]:
    """Names of the targets that rows may be of: points without a name are an only instrument's."""
    instruments = [t.name for t in targets if KINDS[t.kind].reads == "xyz"]
    if "target" not in columns.cells and points(columns) is not None and len(instruments) == 1:
        return instruments
    return [t.name for t in targets]


def _index(columns: Columns, key: str, choices: list[str]) -> np.ndarray:
    """Row by row the index into `choices`; an only one needs no naming."""
    if key not in columns.cells:
        if len(choices) > 1:
            remedy = f"map `{key}`; there are {', '.join(choices[:8])}"
            raise BayescalError(f"the {key} of the rows is not stated", columns.name, remedy)
        return np.zeros(columns.count, int)
    given = columns.cells[key]
    bad = ~np.isin(given, choices)
    if bad.any():
        _, remedy = unknown(key, str(given[np.argmax(bad)]), choices)
        first(columns, bad, lambda row: f"unknown {key} `{given[row]}`", remedy)
    return np.array([choices.index(name) for name in given.tolist()])


def _standstills(joints: np.ndarray) -> np.ndarray | None:
    """Names (N,) of the standstills, "" of rows alone at theirs; None where all are."""
    _, which, count = np.unique(joints, axis=0, return_inverse=True, return_counts=True)
    if count.max() == 1:
        return None
    which = which.ravel()
    return np.where(count[which] > 1, np.char.add("s", (which + 1).astype(str)), "")
