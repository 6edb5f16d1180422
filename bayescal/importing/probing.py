"""What a probing program leaves behind: its log lines, and the readings of contacts that were not made.

A line ``bayescal, ID, rad, [STATE, q1, ..., qn]`` (or ``deg``), whatever stands before it, is a record. Where
a controller keeps readings in registers or in a data list, those of contacts that were not made have a first
joint that no joint can have: 1000 deg and the state.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.cells import text_of
from bayescal.importing.log import Log

RECORD = re.compile(r"\bbayescal,\s*([^,\n]+?),\s*(rad|deg),\s*\[([^\]\n]*)\]")
REGISTER = re.compile(r"(?:PR|AT)(\d+)")
"""Names of the registers (FANUC) and variables (KUKA) of a program, by the number of the contact."""
CONTACT = 1
STATES = {0: "not reached", 2: "no contact", 3: "early contact"}
"""Of contacts that were not made."""
UNMADE = 1000
"""deg, beside the state, in the first joint of a contact that was not made."""
SIGNS = (
    (RECORD, "probing"),
    (re.compile(r"\[\*POSREG\*\]"), "fanuc-va"),
    (re.compile(r"^DEFDAT bcplan\b", re.MULTILINE), "kuka-dat"),
)
"""By what the log of a program is known, and its format."""


def format_of(path: Path) -> str:
    """The format of a log of a probing program, or ``csv``."""
    if path.suffix.lower() == ".xlsx" or "#" in path.name:
        return "csv"
    text, _ = text_of(path)
    return next((name for sign, name in SIGNS if sign.search(text)), "csv")


def read_records(path: Path, n: int) -> Log:
    """The contacts of a log as a table with the columns ``id``, ``J1`` to ``Jn``, in deg.

    Of several records of a contact the last counts. Contacts that were not made are left out, with a note.

    Raises
    ------
    BayescalError
        If there are none, or a record does not have a state and `n` joints.
    """
    text, note = text_of(path)
    last: dict[str, tuple[int, int, list[float]]] = {}
    again = 0
    for found in RECORD.finditer(text):
        line = text.count("\n", 0, found.start()) + 1
        name, unit, listed = found.groups()
        try:
            state, *joints = map(float, listed.split(","))
        except ValueError:
            joints, state = [], -1.0
        if len(joints) != n or (state != CONTACT and state not in STATES) or not np.all(np.isfinite(joints)):
            what = f"the record of `{name}` does not have a state and {n} joints"
            raise BayescalError(what, f"{path.name}:{line}", "correct the line, or remove it")
        again += name in last
        last.pop(name, None)
        last[name] = line, int(state), np.degrees(joints).tolist() if unit == "rad" else joints
    made = {name: (line, joints) for name, (line, state, joints) in last.items() if state == CONTACT}
    if not made:
        what = "no record of a contact that was made"
        raise BayescalError(what, path.name, "give the log of a probing program of bayescal plan")
    notes = [note] if note else []
    if again:
        notes.append(
            f"{again} records of {path.name} left out: the contact was logged again, the last counts"
        )
    notes += unmade({name: state for name, (_, state, _) in last.items()})
    rows = tuple((name, *map(repr, joints)) for name, (_, joints) in made.items())
    header = ("id", *(f"J{k}" for k in range(1, n + 1)))
    lines = tuple(line for line, _ in made.values())
    return Log(path.name, header, rows, lines, (None,) * len(header), tuple(notes))


def unmade(states: dict[str, int]) -> list[str]:
    """Notes on contacts that were not made, by id and state."""
    out = []
    for state, words in STATES.items():
        ids = [name for name, own in states.items() if own == state]
        if ids:
            out.append(f"left out, {words}: {', '.join(ids)}")
    return out


def state_of(first: np.ndarray) -> np.ndarray:
    """States (N,) by the first joint (N,), rad, of registers; `CONTACT` where it is a reading."""
    degrees = np.degrees(first)
    return np.where(degrees > UNMADE - 0.5, np.round(degrees - UNMADE), CONTACT).astype(int)


def numbered(ids: np.ndarray, planned: Sequence[str]) -> np.ndarray:
    """Ids (N,) of a log with those of the plan in place of the registers of a program."""
    found = [REGISTER.fullmatch(name) for name in ids.tolist()]
    numbers = [int(m[1]) if m else 0 for m in found]
    return np.array(
        [
            planned[k - 1] if 0 < k <= len(planned) else name
            for k, name in zip(numbers, ids.tolist(), strict=True)
        ]
    )
