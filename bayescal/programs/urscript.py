"""URScript: poses p[x, y, z, rx, ry, rz] (m, rotation vector in rad) and joints [q1, ..., q6] (rad).

Of movej, movel, movep, movec, servoj and servoc: written out there, also in get_inverse_kin, or assigned to a
name that is used there. The controller inverts a pose with the calibration of its own arm. So a corrected
pose is written as joints, which all these functions take, at the motion; the value of the name is kept. What
follows `qnear` is where the arm comes from: it selects the solution.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid
from bayescal.programs import text as texts
from bayescal.programs.tools import ToolStatement

RADIANS = 7  # decimals: 0.1 µm at a metre
MOVE = re.compile(r"\b(movej|movel|movep|movec|servoj|servoc|servol)\s*\(")
POSES_OF = {"movec": 2}
"""Positions among the first arguments, where there is more than one."""
BY_JOINTS = ("movej", "servoj")
ONLY_POSES = ("servol",)
"""Functions of older controllers that take no joints."""
INVERSE = re.compile(r"get_inverse_kin\s*\(")
ASSIGNED = re.compile(
    r"(?:^|[:;])[ \t]*(?:(?:global|local)[ \t]+)?([A-Za-z_]\w*)[ \t]*(?:\[[^\]\n]*\][ \t]*)?=(?!=)[ \t]*",
    re.MULTILINE,
)
KEYWORD = re.compile(r"[A-Za-z_]\w*\s*=(?!=)\s*")
NAME = re.compile(r"[A-Za-z_]\w*\Z")
CARTESIAN = re.compile(r"p\[\s*" + r"\s*,\s*".join([rf"({texts.NUMBER})"] * 6) + r"\s*\]")
SET_TCP = re.compile(r"\bset_tcp\s*\(")
OWN = "the controller would invert it with its own calibration"


@dataclass(frozen=True)
class Text:
    """A program without comments, and what its names are assigned; `joints` is the pattern of a list."""

    code: texts.Code
    joints: re.Pattern[str]
    values: dict[str, re.Match[str]]  # of names that are assigned once, in numbers

    @classmethod
    def of(cls, text: str, n: int) -> Text:
        """Read a program for an arm of `n` joints."""
        code = texts.Code.of(text, "#")
        joints = re.compile(r"(?<![\w\]])\[\s*" + r"\s*,\s*".join([rf"({texts.NUMBER})"] * n) + r"\s*\]")
        written = Counter(match.group(1) for match in ASSIGNED.finditer(code))
        values = {
            match.group(1): value
            for match in ASSIGNED.finditer(code)
            if "[" not in match.group()
            and (value := CARTESIAN.match(code, match.end()) or joints.match(code, match.end()))
            and written[match.group(1)] == 1
        }
        return cls(code, joints, values)

    def value(self, low: int, high: int) -> re.Match[str] | None:
        """The numbers of an argument: written out, or of its name; None where it is computed."""
        literal = CARTESIAN.fullmatch(self.code, low, high) or self.joints.fullmatch(self.code, low, high)
        return literal or self.values.get(self.code[low:high])


def _read(text: str, n: int) -> texts.Program:
    t = Text.of(text, n)
    slots: dict[tuple[int, int], texts.Slot] = {}
    notes = []
    for match in MOVE.finditer(t.code):
        kind, low, high = match.group(1), match.end(), _closing(t.code, match.end())
        line = t.code.where(low)
        for place in _positions(t.code, kind, low, high):
            slot = _slot(t, kind, *place)
            if isinstance(slot, texts.Slot):
                slots.setdefault(slot.whole or slot.spans[0], slot)
            else:
                notes.append(f"{line}: the position of a {kind} {slot}; kept: {OWN}")
    tools = tuple(_tools(t))
    if not tools:
        notes.append("no set_tcp: the program must run with the tool for which it is corrected")
    return texts.Program(tuple(slots.values()), tuple(notes), "", tools)


def _tools(t: Text) -> Iterator[ToolStatement]:
    for match in SET_TCP.finditer(t.code):
        end = _closing(t.code, match.end())
        for place in t.code.arguments(match.end(), end)[:1]:
            value, text = t.value(*place), " ".join(t.code[match.start() : end + 1].split())
            pose = None if value is None or value.re is not CARTESIAN else _pose_of(value)
            yield ToolStatement(t.code.where(match.start()), text, pose)


def _closing(code: texts.Code, end: int) -> int:
    """Where the bracket closes that is open at a place."""
    depth = 1
    while end < len(code) and depth:
        depth += {"(": 1, ")": -1}.get(code[end], 0)
        end += 1
    return end - 1


def _positions(code: texts.Code, kind: str, low: int, high: int) -> list[tuple[int, int]]:
    """Places of the positions among the arguments of a motion."""
    out = []
    for a, b in code.arguments(low, high)[: POSES_OF.get(kind, 1)]:
        keyword = KEYWORD.match(code, a, b)
        out.append((keyword.end() if keyword else a, b))
    return out


def _slot(t: Text, kind: str, low: int, high: int) -> texts.Slot | str:
    """The position of a motion, or why it is kept."""
    near, place = None, (low, high)
    if match := INVERSE.match(t.code, low, high):
        inner = t.code.arguments(match.end(), _closing(t.code, match.end()))
        place = inner[0] if inner else place
        if len(inner) > 1:
            keyword = KEYWORD.match(t.code, *inner[1])
            stated = t.value(keyword.end() if keyword else inner[1][0], inner[1][1])
            near = None if stated is None or stated.re is CARTESIAN else _numbers(stated)
    value, named = t.value(*place), t.code[slice(*place)]
    if value is None:
        return f"is computed ({named} is assigned more than once)" if NAME.match(named) else "is computed"
    name = named if NAME.match(named) else ""
    where = t.code.where(low, name)
    straight = kind not in BY_JOINTS
    if value.re is CARTESIAN:
        if kind in ONLY_POSES:
            return "must be a pose"
        return texts.Slot(texts.Target(where, _pose_of(value), near, straight), name, (), (low, high))
    spans = texts.numbers_in(value, len(value.groups()))
    return texts.Slot(texts.Target(where, readings=_numbers(value), straight=straight), name, spans)


def _numbers(match: re.Match[str]) -> np.ndarray:
    return np.array([float(x) for x in match.groups()])


def _pose_of(match: re.Match[str]) -> np.ndarray:
    values = _numbers(match)
    return rigid(Rotation.from_rotvec(values[3:]).as_matrix(), values[:3])


def _joints(readings: np.ndarray) -> list[texts.Number]:
    return [texts.Number(x, RADIANS) for x in readings.tolist()]


URSCRIPT = texts.Format(
    "urscript",
    (".script", ".urscript"),
    _read,
    "URScript: p[...] and joint lists of movej, movel, movep, movec, servoj, servoc",
    remarked=texts.after_line(r"^\s*def\b.*:", "  # "),
    dialect=texts.Dialect(
        {
            r"(\d+)": ("get_standard_digital_in({})", ""),
            r"tool:(\d+)": ("get_tool_digital_in({})", ""),
            r"configurable:(\d+)": ("get_configurable_digital_in({})", ""),
        },
        "0",
        force="bc_force() > {}",
    ),
    joints=_joints,
)
