"""Joint positions in programs and registers of controllers, as tables.

The listings and their sources are described in ``docs/importing.md``. A position of Cartesian coordinates
does not state the joint readings: it is left out and counted.

What a probing program leaves behind: its log lines, and the readings of contacts that were not made.

A line ``bayescal, ID, rad, [STATE, q1, ..., qn]`` (or ``deg``), whatever stands before it, is a record. Where
a controller keeps readings in registers or in a data list, those of contacts that were not made have a first
joint that no joint can have: 1000 deg and the state.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.importing.joint_formats import FORMATS
from bayescal.importing.log import Log, text_of


@dataclass(frozen=True)
class Listing:
    """How a file lists joint positions, as regular expressions.

    Attributes
    ----------
    record : str
        A position, with the groups `id` and `body`.
    joint : str
        A joint in the body of a position, with its number and its value, or the value alone.
    cartesian : str
        A position without joints.
    prefix : str
        Of the ids.
    comment : str
        What is not read.
    """

    record: str
    joint: str
    cartesian: str
    prefix: str = ""
    comment: str = r"(?!)"


LISTINGS = {name: Listing(**listing) for name, listing in FORMATS["listings"].items()}
"""By the name of their format."""


def read_listing(path: Path, name: str, n: int) -> Log:
    """The joint positions of a file as a table with the columns ``id``, ``J1`` to ``Jn``, in deg.

    Raises
    ------
    BayescalError
        If there are none, or a position has another number of joints.
    """
    listing = LISTINGS[name]
    text, note = text_of(path)
    text = re.sub(listing.comment, lambda comment: " " * len(comment[0]), text)
    notes, others = [note], 0
    rows: list[tuple[int, tuple[str, ...]]] = []
    for match in re.finditer(listing.record, text):
        line = text.count("\n", 0, match.start("id")) + 1
        body = match["body"]
        if re.search(listing.cartesian, body):
            others += 1
            continue
        if name == "abb-mod":
            body = body.partition("]")[0]
        each = re.findall(listing.joint, body)
        joints = {int(number or k): value for k, (number, value) in enumerate(each, 1)}
        if not joints:
            continue
        if sorted(joints) != list(range(1, n + 1)):
            what = f"`{listing.prefix}{match['id']}` has {len(joints)} joints, the robot has {n}"
            raise BayescalError(what, f"{path.name}:{line}", "check --robot and --format")
        rows.append((line, (listing.prefix + match["id"], *(joints[j] for j in range(1, n + 1)))))
    if not rows:
        cartesian = f" ({others} Cartesian positions do not state the readings)" if others else ""
        what = f"no joint positions{cartesian}"
        raise BayescalError(what, path.name, "save the positions as joints; check --format")
    if others:
        notes.append(f"{others} Cartesian positions of {path.name} left out: they do not state the readings")
    return _joint_table(path, n, rows, notes)


def _joint_table(path: Path, n: int, rows: list[tuple[int, tuple[str, ...]]], notes: list[str]) -> Log:
    """A table of ids and joints from its rows, each with its line in the file."""
    header = ("id", *(f"J{k + 1}" for k in range(n)))
    lines, cells = zip(*rows, strict=True)
    return Log(path.name, header, cells, lines, (None,) * len(header), tuple(filter(None, notes)))


RECORD = re.compile(r"\bbayescal,\s*([^,\n]+?),\s*(rad|deg),\s*\[([^\]\n]*)\]")
REGISTER = re.compile(r"(?:PR|AT)(\d+)")
"""Names of the registers (FANUC) and variables (KUKA) of a program, by the number of the contact."""
CONTACT = 1
STATES = {0: "not reached", 2: "no contact", 3: "early contact"}
"""Of contacts that were not made."""
UNMADE = 1000
"""deg, beside the state, in the first joint of a contact that was not made."""
SIGNS = ((RECORD, "probing"), (r"\[\*POSREG\*\]", "fanuc-va"), (r"(?m)^DEFDAT bcplan\b", "kuka-dat"))
"""By what the log of a program is known, and its format."""


def format_of(path: Path) -> str:
    """The format of a log of a probing program, or ``csv``."""
    if path.suffix.lower() == ".xlsx" or "#" in path.name:
        return "csv"
    text, _ = text_of(path)
    return next((name for sign, name in SIGNS if re.search(sign, text)), "csv")


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
    for match in RECORD.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        name, unit, listed = match.groups()
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
    made = ((name, line, joints) for name, (line, state, joints) in last.items() if state == CONTACT)
    rows = [(line, (name, *map(repr, joints))) for name, line, joints in made]
    if not rows:
        what = "no record of a contact that was made"
        raise BayescalError(what, path.name, "give the log of a probing program of bayescal plan")
    notes = [note]
    if again:
        what = "the contact was logged again, the last counts"
        notes.append(f"{again} records of {path.name} left out: {what}")
    notes += unmade({name: state for name, (_, state, _) in last.items()})
    return _joint_table(path, n, rows, notes)


def unmade(states: dict[str, int]) -> list[str]:
    """Notes on contacts that were not made, by id and state."""
    by_state = {words: [i for i, other in states.items() if other == s] for s, words in STATES.items()}
    return [f"left out, {words}: {', '.join(ids)}" for words, ids in by_state.items() if ids]


def state_of(first: np.ndarray) -> np.ndarray:
    """States (N,) by the first joint (N,), rad, of registers; `CONTACT` where it is a reading."""
    degrees = np.degrees(first)
    return np.where(degrees > UNMADE - 0.5, np.round(degrees - UNMADE), CONTACT).astype(int)


def numbered(ids: np.ndarray, planned: Sequence[str]) -> np.ndarray:
    """Ids (N,) of a log with those of the plan in place of the registers of a program."""
    by_number = {str(k): name for k, name in enumerate(planned, 1)}
    names = ids.tolist()
    registers = [REGISTER.fullmatch(name) for name in names]
    numbers = [str(int(register[1])) if register else "" for register in registers]
    return np.array([by_number.get(number, name) for number, name in zip(numbers, names, strict=True)])
