"""ABB: robtarget and jointtarget values in RAPID modules, wherever they are written out.

x, y, z in mm and the quaternion q1 ... q4 with its real part first; joints in degrees. cf1, cf4 and cf6 are
the quarter turns of axes 1, 4 and 6 (0: 0 to 90 deg, -1: -90 to 0 deg): they select the solution, and are
written for the corrected readings. cfx is kept. A position that is computed is kept: Offs, RelTool,
p10.trans.z := ...
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid
from bayescal.programs import text as texts
from bayescal.programs.tools import ToolStatement

AXES = (0, 3, 5)
"""Axes whose quarter turns cf1, cf4 and cf6 state."""
QUATERNION = 9  # decimals
NEAR = np.radians(0.1)  # rad: this close to a quarter turn, both sides of it are accepted


def _list(count: int, keep: bool = True) -> str:
    number = rf"({texts.NUMBER})" if keep else rf"(?:{texts.NUMBER})"
    return r"\[\s*" + r"\s*,\s*".join([number] * count) + r"\s*\]"


ROBTARGET = re.compile(
    r"\[\s*" + r"\s*,\s*".join([_list(3), _list(4), _list(4), _list(6, keep=False)]) + r"\s*\]"
)
NAMED = re.compile(r"(\w+)\s*(?:\{[^}]*\})?\s*:=\s*$")
ASSIGNED = re.compile(r"^[ \t]*(\w+)\s*(?:\{[^}]*\})?((?:\s*\.\s*\w+)*)\s*:=\s*(?=(.))", re.MULTILINE)
WORK_OBJECT = re.compile(r"\\WObj\s*:=\s*(?!wobj0\b)\w+", re.IGNORECASE)
MOVE = re.compile(r"\bMove(AbsJ|J|L|C)(\w*)\s([^;]*);", re.IGNORECASE)
FLAG = re.compile(r"\s*\\[^,]*")
TOOL_DATA = re.compile(
    r"\btooldata\s+(\w+)\s*:=\s*\[\s*(TRUE|FALSE)\s*,\s*\[\s*" + _list(3) + r"\s*,\s*" + _list(4),
    re.IGNORECASE,
)


def _read(text: str, n: int) -> texts.Program:
    code = texts.Code.of(text, "!")
    jointtarget = re.compile(r"\[\s*" + _list(n) + r"\s*,\s*" + _list(6, keep=False) + r"\s*\]")
    assigned = reversed(list(ASSIGNED.finditer(code)))  # the first counts
    computed = {m.group(1): m for m in assigned if m.group(2) or m.group(3) != "["}
    first_use: dict[str, re.Match[str]] = {}
    notes = []
    for move in MOVE.finditer(code):
        for a, b in _positions(code, move):
            position = code[a:b]
            if not position.isidentifier() and not position.startswith("["):
                what = " ".join(position.split())
                notes.append(f"{code.where(a)}: the position of a Move{move.group(1)} is computed "
                             f"({what}); kept")  # fmt: skip
            first_use.setdefault(position, move)
    placed: list[tuple[int, texts.Slot]] = []
    motion: re.Match[str] | None
    for match in (*ROBTARGET.finditer(code), *jointtarget.finditer(code)):
        before = code[max(code.rfind("\n", 0, match.start()), 0) : match.start()]
        named = NAMED.search(before)
        name = named.group(1) if named else ""
        where = code.where(match.start(), name)
        if name in computed:
            notes.append(f"{where}: it is computed in {code.where(computed[name].start(1))}; kept")
            continue
        motion = first_use.get(name) if named else _around(code, match.start())
        straight = motion is not None and motion.group(1).upper() in "LC"
        if match.re is ROBTARGET:
            slot = _robtarget(code, match, where, name, straight)
        else:
            spans = texts.numbers_in(match, n)
            slot = texts.Slot(texts.Target(where, readings=np.radians(code.values(spans))), name, spans)
        elsewhere = len(re.findall(rf"\b{name}\b", code)) > 1
        slot = replace(slot, used=motion is not None or not first_use or elsewhere)
        placed.append((motion.start() if motion is not None and named else match.start(), slot))
    slots = tuple(slot for _, slot in sorted(placed, key=lambda each: each[0]))
    posed = any(slot.target.pose is not None for slot in slots)
    if not posed:
        return texts.Program(slots, tuple(notes))
    return texts.Program(slots, tuple(notes), code.first(WORK_OBJECT), tuple(_tools(code)))


def _positions(code: texts.Code, motion: re.Match[str]) -> list[tuple[int, int]]:
    """Places of the positions of a motion: its first argument, of a circle the first two."""
    places = []
    for a, b in code.arguments(*motion.span(3)):
        flag = FLAG.match(code, a, b)
        if flag is None:
            places.append((a, b))
        elif position := code[flag.end() : b].strip(" \t,"):  # \\Conc, p10
            places.append((code.index(position, flag.end()), b))
    return places[: 2 if motion.group(1).upper() == "C" else 1]


def _around(code: texts.Code, place: int) -> re.Match[str] | None:
    """The motion that a place is an argument of."""
    return next((m for m in MOVE.finditer(code) if m.start() <= place < m.end()), None)


def _tools(code: texts.Code) -> Iterator[ToolStatement]:
    """Tools of the motions, with their poses where the same module has them."""
    stated = {m.group(1).lower(): m for m in TOOL_DATA.finditer(code)}
    for motion in MOVE.finditer(code):
        each = [FLAG.sub("", code[a:b]).strip() for a, b in code.arguments(*motion.span(3))]
        names = [name for name in each[2:] if name.isidentifier()]
        name = next((x for x in names if x.lower() in stated), names[-1] if names else "")
        where, data = code.where(motion.start()), stated.get(name.lower())
        if name.lower() == "tool0":
            yield ToolStatement(where, name, np.eye(4))
        elif data is None or data.group(2).upper() == "FALSE":
            yield ToolStatement(where, name if data is None else f"{name}, which the robot does not hold")
        else:
            x, y, z, q1, *imaginary = (float(v) for v in data.groups()[2:])
            turn = Rotation.from_quat([*imaginary, q1]).as_matrix()
            yield ToolStatement(where, name, rigid(turn, 1e-3 * np.array([x, y, z])))


def _robtarget(code: texts.Code, match: re.Match[str], where: str, name: str, straight: bool) -> texts.Slot:
    spans = texts.numbers_in(match, 10)  # x, y, z, q1 ... q4, cf1, cf4, cf6
    values = code.values(spans)
    q1, *imaginary = values[3:7]
    pose = rigid(Rotation.from_quat([*imaginary, q1]).as_matrix(), 1e-3 * np.array(values[:3]))
    admits = _quarters(values[7:10])
    return texts.Slot(texts.Target(where, pose, straight=straight, admits=admits), name, spans)


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


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[texts.Number]:
    *imaginary, real = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    q = np.array([real, *imaginary])
    q = q if q @ np.array(old[3:7]) >= 0 else -q  # both are the same rotation
    quadrants = dict(enumerate(np.floor(readings / (np.pi / 2)).tolist()))
    stated = zip(AXES, old[7:10], strict=True)
    quarters = [texts.Number(quadrants.get(axis, cf), 0) for axis, cf in stated]
    return [*texts.lengths_of(pose), *(texts.Number(x, QUATERNION) for x in q.tolist()), *quarters]


ABB = texts.Format(
    "abb",
    (".mod", ".modx", ".prg", ".sys"),
    _read,
    "ABB RAPID: robtarget and jointtarget values",
    _pose,
    texts.after_line(r"^[ \t]*MODULE\b", "  ! "),
    dialect=texts.Dialect({r"([A-Za-z]\w*)": ("{}", "{}")}, "diProbe"),
)
