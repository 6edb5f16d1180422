"""URScript: poses p[x, y, z, rx, ry, rz] (m, rotation vector in rad) and joints [q1, ..., q6] (rad).

Of movej, movel, movep, movec, servoj and servol: written out there, also in get_inverse_kin, or assigned to a
name that is used there. What follows `qnear` is where the arm comes from: it selects the solution and is
kept. Other lists (set_tcp, pose_trans, speeds) are no positions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid
from bayescal.exporting.compensate.formats.program import (
    NUMBER,
    Format,
    Number,
    Program,
    Slot,
    line_of,
    masked,
    numbers_in,
    values_at,
)
from bayescal.exporting.compensate.targets import Target

METRES, RADIANS = 7, 7  # decimals: 0.1 µm each at a metre
MOVE = re.compile(r"\b(movej|movel|movep|movec|servoj|servol)\s*\(")
NEAR = re.compile(r"\bqnear\s*=\s*(\w+|\[[^\]]*\])")
CALL = re.compile(r"\b(?!get_inverse_kin\b|move[jlpc]\b|servo[jl]\b)[A-Za-z_]\w*\s*\(")
CARTESIAN = re.compile(r"p\[\s*" + r"\s*,\s*".join([rf"({NUMBER})"] * 6) + r"\s*\]")


def _read(text: str, n: int) -> Program:
    code = masked(text, "#")
    list_ = re.compile(r"(?<![\w\]])\[\s*" + r"\s*,\s*".join([rf"({NUMBER})"] * n) + r"\s*\]")
    assigned = {
        name: match
        for pattern in (CARTESIAN, list_)
        for match in pattern.finditer(code)
        if (name := _name_before(code, match.start()))
    }
    slots: dict[tuple[int, int], Slot] = {}
    notes = []
    for kind, low, high in _calls(code):
        line = line_of(code, low)
        near = NEAR.search(code, low, high)
        close = None if near is None else _near(code, near, assigned, list_)
        inside = code[low:high]
        if near is not None:
            a, b = near.start() - low, near.end() - low
            inside = inside[:a] + " " * (b - a) + inside[b:]
        straight = kind not in ("movej", "servoj")
        if CALL.search(inside):
            notes.append(f"line {line}: the position of a {kind} is computed; kept")
            continue
        matches = [m for p in (CARTESIAN, list_) for m in p.finditer(code, low, high) if _outside(m, near)]
        used = re.findall(r"[A-Za-z_]\w*(?!\w*\s*=)", inside)
        matches += [assigned[name] for name in used if name in assigned]
        if not matches:
            notes.append(f"line {line}: a {kind} without a position in numbers; kept")
        for match in sorted(matches, key=lambda m: m.start()):
            slots.setdefault(match.span(), _slot(code, match, match.re is CARTESIAN, straight, close, n))
    return Program(tuple(slots.values()), tuple(notes))


def _name_before(code: str, at: int) -> str:
    """The name to which the value at a place is assigned, or ""."""
    match = re.search(r"([A-Za-z_]\w*)\s*=\s*$", code[code.rfind("\n", 0, at) + 1 : at])
    return match.group(1) if match else ""


def _calls(code: str) -> Iterator[tuple[str, int, int]]:
    """Motions: the function, and where its arguments begin and end."""
    for match in MOVE.finditer(code):
        depth, at = 1, match.end()
        while at < len(code) and depth:
            depth += {"(": 1, ")": -1}.get(code[at], 0)
            at += 1
        yield match.group(1), match.end(), at - 1


def _near(
    code: str, near: re.Match[str], assigned: dict[str, re.Match[str]], list_: re.Pattern[str]
) -> np.ndarray | None:
    """The readings that `qnear` states, rad."""
    match = list_.match(code, near.start(1)) or assigned.get(near.group(1))
    if match is None or match.re is CARTESIAN:
        return None
    return np.array([float(x) for x in match.groups()])


def _outside(match: re.Match[str], near: re.Match[str] | None) -> bool:
    return near is None or not near.start() <= match.start() < near.end()


def _slot(
    code: str, match: re.Match[str], cartesian: bool, straight: bool, near: np.ndarray | None, n: int
) -> Slot:
    name = _name_before(code, match.start())
    where = f"line {line_of(code, match.start())}" + (f", {name}" if name else "")
    spans = numbers_in(match, range(1, (6 if cartesian else n) + 1))
    values = np.array(values_at(code, spans))
    if not cartesian:
        return Slot(Target(where, readings=values, straight=straight), name, spans)
    pose = rigid(Rotation.from_rotvec(values[3:]).as_matrix(), values[:3])
    return Slot(Target(where, pose, near, straight), name, spans)


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[Number]:
    turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
    angle = np.linalg.norm(turn)
    other = turn * (1 - 2 * np.pi / angle) if angle > 0 else turn  # the same rotation the other way round
    had = np.array(old[3:])
    if np.linalg.norm(other - had) < np.linalg.norm(turn - had):
        turn = other
    return [
        *(Number(x, METRES) for x in pose[:3, 3].tolist()),
        *(Number(x, RADIANS) for x in turn.tolist()),
    ]


def _joints(readings: np.ndarray) -> list[Number]:
    return [Number(x, RADIANS) for x in readings.tolist()]


URSCRIPT = Format(
    "urscript",
    (".script", ".urscript"),
    _read,
    _pose,
    _joints,
    "URScript: p[...] and joint lists of movej, movel, movep, movec, servoj, servol",
)
