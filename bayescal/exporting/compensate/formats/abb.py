"""ABB: robtarget and jointtarget values in RAPID modules, wherever they are written out.

x, y, z in mm and the quaternion q1 ... q4 with its real part first; joints in degrees. cf1, cf4 and cf6 are
the quarter turns of axes 1, 4 and 6 (0: 0 to 90 deg, -1: -90 to 0 deg): they select the solution, and are
written for the corrected readings. cfx is kept.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid
from bayescal.exporting.compensate.formats.program import (
    NUMBER,
    Format,
    Number,
    Program,
    Slot,
    degrees_of,
    first,
    lengths_of,
    line_of,
    masked,
    numbers_in,
    values_at,
)
from bayescal.exporting.compensate.targets import Target

AXES = (0, 3, 5)
"""Axes whose quarter turns cf1, cf4 and cf6 state."""
QUATERNION = 9  # decimals
NEAR = np.radians(0.1)  # rad: this close to a quarter turn, both sides of it are accepted


def _list(count: int, keep: bool = True) -> str:
    number = rf"({NUMBER})" if keep else rf"(?:{NUMBER})"
    return r"\[\s*" + r"\s*,\s*".join([number] * count) + r"\s*\]"


ROBTARGET = re.compile(
    r"\[\s*" + r"\s*,\s*".join([_list(3), _list(4), _list(4), _list(6, keep=False)]) + r"\s*\]"
)
NAMED = re.compile(r"(\w+)\s*(?:\{[^}]*\})?\s*:=\s*$")
WORK_OBJECT = re.compile(r"\\WObj\s*:=\s*(?!wobj0\b)\w+", re.IGNORECASE)
MOVE = re.compile(r"\bMove(AbsJ|J|L|C)\w*\s+(?:\\\w+\s*,?\s*)*(\w+)?", re.IGNORECASE)


def _read(text: str, n: int) -> Program:
    code = masked(text, "!")
    jointtarget = re.compile(r"\[\s*" + _list(n) + r"\s*,\s*" + _list(6, keep=False) + r"\s*\]")
    first_use = {m.group(2): m for m in reversed(list(MOVE.finditer(code))) if m.group(2)}
    found: list[tuple[int, Slot]] = []
    for match in (*ROBTARGET.finditer(code), *jointtarget.finditer(code)):
        before = code[max(code.rfind("\n", 0, match.start()), 0) : match.start()]
        named = NAMED.search(before)
        name = named.group(1) if named else ""
        motion = first_use.get(name) if named else MOVE.search(before)
        where = f"line {line_of(code, match.start())}" + (f", {name}" if name else "")
        straight = motion is not None and motion.group(1).upper() in "LC"
        if match.re is ROBTARGET:
            slot = _robtarget(code, match, where, name, straight)
        else:
            spans = numbers_in(match, range(1, n + 1))
            slot = Slot(Target(where, readings=np.radians(values_at(code, spans))), name, spans)
        found.append((motion.start() if motion is not None and named else match.start(), slot))
    slots = tuple(slot for _, slot in sorted(found, key=lambda each: each[0]))
    return Program(slots, (), first(WORK_OBJECT, code))


def _robtarget(code: str, match: re.Match[str], where: str, name: str, straight: bool) -> Slot:
    spans = numbers_in(match, range(1, 11))  # x, y, z, q1 ... q4, cf1, cf4, cf6
    values = values_at(code, spans)
    q1, *rest = values[3:7]
    pose = rigid(Rotation.from_quat([*rest, q1]).as_matrix(), 1e-3 * np.array(values[:3]))
    admits = _quarters(values[7:10])
    return Slot(Target(where, pose, straight=straight, admits=admits), name, spans)


def _quarters(stated: Sequence[float]) -> Callable[[np.ndarray], bool]:
    """Whether readings (n,), rad, have the stated quarter turns of axes 1, 4 and 6."""

    def admits(readings: np.ndarray) -> bool:
        quarter = np.pi / 2
        return all(
            quarter * cf - NEAR <= readings[axis] <= quarter * (cf + 1) + NEAR
            for axis, cf in zip(AXES, stated, strict=True)
            if axis < len(readings)
        )

    return admits


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[Number]:
    *rest, real = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    q = np.array([real, *rest])
    q = q if q @ np.array(old[3:7]) >= 0 else -q  # both are the same rotation
    quarters = [
        np.floor(readings[axis] / (np.pi / 2)) if axis < len(readings) else cf
        for axis, cf in zip(AXES, old[7:10], strict=True)
    ]
    return [
        *lengths_of(pose),
        *(Number(x, QUATERNION) for x in q.tolist()),
        *(Number(float(cf), 0) for cf in quarters),
    ]


ABB = Format(
    "abb",
    (".mod", ".modx", ".prg", ".sys"),
    _read,
    _pose,
    degrees_of,
    "ABB RAPID: robtarget and jointtarget values",
)
