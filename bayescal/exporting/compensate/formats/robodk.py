"""RoboDK: CSV of joints in degrees in the first n columns, with or without a header; other columns are kept.

So are its tables of calibration targets and its lists of the joints of a program.
"""

from __future__ import annotations

import re

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.compensate.formats.program import (
    NUMBER,
    Format,
    Program,
    Slot,
    degrees_of,
    numbers_in,
    values_at,
)
from bayescal.exporting.compensate.targets import Target


def _read(text: str, n: int) -> Program:
    row = re.compile(r"\s*,\s*".join([rf"\s*({NUMBER})"] * n) + r"\s*(?=,|;|$)")
    slots: list[Slot] = []
    at = 0
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        bare = line.rstrip("\r\n")
        match = row.match(text, at, at + len(bare))
        if match:
            spans = numbers_in(match, range(1, n + 1))
            target = Target(f"line {number}", readings=np.radians(values_at(text, spans)))
            slots.append(Slot(target, f"{number}", spans))
        elif bare.strip() and slots:
            what = f"the first {n} cells are not numbers"
            raise BayescalError(what, f"line {number}", "a RoboDK table has the joints in degrees there")
        at += len(line)
    return Program(tuple(slots))


ROBODK = Format("robodk", (".csv",), _read, degrees_of, "RoboDK CSV: joints in degrees in the first columns")
