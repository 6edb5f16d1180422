"""Joint positions in programs and registers of controllers, as tables.

The listings and their sources are described in ``docs/importing.md``. A position of Cartesian coordinates
does not state the joint readings: it is left out and counted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from bayescal.errors import BayescalError
from bayescal.importing.cells import text_of
from bayescal.importing.log import Log

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True)
class Listing:
    """How a file lists joint positions.

    Attributes
    ----------
    record : re.Pattern
        A position, with the groups `id` and `body`.
    joint : re.Pattern
        A joint in the body of a position, with its number and its value, or the value alone.
    cartesian : re.Pattern
        A position without joints.
    prefix : str
        Of the ids.
    comment : re.Pattern
        What is not read.
    """

    record: re.Pattern[str]
    joint: re.Pattern[str]
    cartesian: re.Pattern[str]
    prefix: str = ""
    comment: re.Pattern[str] = re.compile(r"(?!)")


LISTINGS = {
    "fanuc-ls": Listing(
        re.compile(
            r"^\s*P\[(?P<id>\d+)[^\]]*\]\s*\{(?P<body>.*?)(?:GP2\s*:.*?)?\}\s*;", re.DOTALL | re.MULTILINE
        ),
        re.compile(rf"\bJ(\d+)\s*=\s*({NUMBER})\s*deg"),
        re.compile(r"\bX\s*=\s*[-+.\d]+\s*mm"),
        prefix="P",
    ),
    "fanuc-va": Listing(
        re.compile(
            r"^\s*\[1,(?P<id>\d+)\]\s*=\s*'[^']*'(?P<body>.*?)(?=^\s*\[|\Z)", re.DOTALL | re.MULTILINE
        ),
        re.compile(rf"\bJ(\d+)\s*=\s*({NUMBER})\s*deg"),
        re.compile(r"\bX:\s*[-+.\d]+"),
        prefix="PR",
    ),
    "kuka-dat": Listing(
        re.compile(r"(?P<id>\w+)\s*=\s*\{(?:\s*E6AXIS\s*:|\s*AXIS\s*:)?(?P<body>\s*[AX]1?\s[^}]*)\}"),
        re.compile(rf"\bA(\d+)\s+({NUMBER})"),
        re.compile(r"\bX\s+[-+.\d]+"),
        comment=re.compile(r";[^\n]*|^\s*\$[^\n]*", re.MULTILINE),
    ),
    "abb-mod": Listing(
        re.compile(r"\b(?:joint|rob)target\s+(?P<id>\w+)\s*:=\s*\[(?P<body>\[[^;]*)\]\s*;", re.IGNORECASE),
        re.compile(rf"()({NUMBER})"),
        re.compile(r"^\[[^\]]*\]\s*,\s*\[[^\]]*\]\s*,\s*\[[^\]]*\]\s*,"),
        comment=re.compile(r"![^\n]*"),
    ),
}
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
    text = listing.comment.sub(lambda found: " " * len(found[0]), text)
    rows, lines, others = [], [], 0
    for found in listing.record.finditer(text):
        line = text.count("\n", 0, found.start("id")) + 1
        body = found["body"]
        if listing.cartesian.search(body):
            others += 1
            continue
        if name == "abb-mod":
            body = body.partition("]")[0]
        joints = {int(number or k): value for k, (number, value) in enumerate(listing.joint.findall(body), 1)}
        if not joints:
            continue
        if sorted(joints) != list(range(1, n + 1)):
            what = f"`{listing.prefix}{found['id']}` has {len(joints)} joints, the robot has {n}"
            raise BayescalError(what, f"{path.name}:{line}", "check --robot and --format")
        rows.append((listing.prefix + found["id"], *(joints[j] for j in range(1, n + 1))))
        lines.append(line)
    if not rows:
        what = (
            f"no joint positions ({others} Cartesian positions do not state the readings)"
            if others
            else ("no joint positions")
        )
        raise BayescalError(what, path.name, "save the positions as joints; check --format")
    notes = [note] if note else []
    if others:
        notes.append(f"{others} Cartesian positions of {path.name} left out: they do not state the readings")
    header = ("id", *(f"J{j}" for j in range(1, n + 1)))
    return Log(path.name, header, tuple(rows), tuple(lines), (None,) * len(header), tuple(notes))
