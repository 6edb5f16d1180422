"""FANUC: programs as text (LS), whose positions P[n] are listed behind /POS.

X, Y, Z in mm; W, P, R in degrees about the fixed axes x, y, z; or joints J1 ... in degrees as the pendant
shows them. Only the first motion group is the arm. UF is the user frame of a position, 0 that of the robot.
CONFIG is kept: of several solutions that nearest to the position before is taken.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.exporting.compensate.formats.program import (
    ANGLE,
    NUMBER,
    Format,
    Number,
    Program,
    Slot,
    degrees_of,
    lengths_of,
    line_of,
    numbers_in,
    values_at,
)
from bayescal.exporting.compensate.targets import Target

POSITION = re.compile(r"P\[(\d+)(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL)
GROUP = re.compile(r"GP1\s*:(.*?)(?=GP\d+\s*:|\Z)", re.DOTALL)
POSE = re.compile(
    r"\s*,\s*".join(rf"\b{key}\s*=\s*({NUMBER})\s*{unit}" for key, unit in
                 (("X", "mm"), ("Y", "mm"), ("Z", "mm"), ("W", "deg"), ("P", "deg"), ("R", "deg")))
)  # fmt: skip
USER_FRAME = re.compile(r"UF\s*:\s*(?!0\b)\w+")
MOVE = re.compile(r"^\s*\d+:\s*([JLCA])\s+P\[(\d+)", re.MULTILINE)
REGISTER = re.compile(r"^\s*\d+:\s*[JLCA]\s+PR\[", re.MULTILINE)


def _read(text: str, n: int) -> Program:
    begin = text.find("/POS")
    moves = text if begin < 0 else text[:begin]
    listed = POSITION.findall(text, max(begin, 0))
    slots = {slot.name: slot for slot in _slots(text, max(begin, 0), n, dict(_kinds(moves)))}
    visited = [f"P[{number}]" for _, number in MOVE.findall(moves)]
    order = [name for name in dict.fromkeys([*visited, *slots]) if name in slots]
    notes = [
        f"line {line_of(moves, match.start())}: a motion to a position register is kept"
        for match in REGISTER.finditer(moves)
    ]
    unread = [f"P[{number}]" for number, _ in listed if f"P[{number}]" not in slots]
    notes += [f"{name}: neither X ... R nor J1 ... J{n} of the first group; kept" for name in unread]
    posed = [slot for slot in slots.values() if slot.target.pose is not None]
    framed = [(slot, _frame(text, slot)) for slot in posed]
    elsewhere = next((f"{slot.target.where}: {frame}" for slot, frame in framed if frame), "")
    return Program(tuple(slots[name] for name in order), tuple(notes), elsewhere)


def _frame(text: str, slot: Slot) -> str:
    """The user frame of a position if it is not that of the robot, or ""."""
    begin = text.rfind("{", 0, slot.spans[0][0])
    match = USER_FRAME.search(text, begin, slot.spans[0][0])
    return match.group() if match else ""


def _kinds(moves: str) -> Iterator[tuple[str, bool]]:
    """Positions by their number, and whether the first motion to each is along a line."""
    for kind, number in reversed(MOVE.findall(moves)):
        yield number, kind != "J"


def _slots(text: str, begin: int, n: int, straight: dict[str, bool]) -> Iterator[Slot]:
    joints = re.compile(r"\s*,\s*".join(rf"J{k}\s*=\s*({NUMBER})\s*deg" for k in range(1, n + 1)))
    for match in POSITION.finditer(text, begin):
        group = GROUP.search(text, *match.span(2))
        low, high = group.span(1) if group else match.span(2)
        number, name = match.group(1), f"P[{match.group(1)}]"
        where = f"line {line_of(text, match.start())}, {name}"
        if found := POSE.search(text, low, high):
            spans = numbers_in(found, range(1, 7))
            *xyz, w, p, r = values_at(text, spans)
            pose = rigid(rpy_matrix(np.radians([w, p, r])), 1e-3 * np.array(xyz))
            yield Slot(Target(where, pose, straight=straight.get(number, False)), name, spans)
        elif found := joints.search(text, low, high):
            spans = numbers_in(found, range(1, n + 1))
            readings = np.radians(values_at(text, spans))
            yield Slot(Target(where, readings=readings, straight=straight.get(number, False)), name, spans)


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[Number]:
    return [*lengths_of(pose), *(Number(x, ANGLE) for x in np.degrees(rpy_of(pose[:3, :3])).tolist())]


FANUC = Format(
    "fanuc",
    (".ls",),
    _read,
    _pose,
    degrees_of,
    "FANUC LS: P[n] as X, Y, Z, W, P, R or J1 ... Jn of the first motion group",
)
