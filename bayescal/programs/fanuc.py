"""FANUC: programs as text (LS), whose positions P[n] are listed behind /POS.

X, Y, Z in mm; W, P, R in degrees about the fixed axes x, y, z; or joints J1 ... in degrees as the pendant
shows them. Only the first motion group is the arm. UF and UT are the user frame and the tool of a position: 0
is that of the robot, or the flange. The pose of another tool is not in a program. CONFIG is kept: of several
solutions that nearest to the position before is taken.
A position that a motion offsets (Offset, INC, ...) is kept, and so is one that a register selects.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.programs import text as texts
from bayescal.programs.tools import ToolStatement

POSITION = re.compile(r"P\[(\d+)(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL)
GROUP = re.compile(r"GP1\s*:(.*?)(?=GP\d+\s*:|\Z)", re.DOTALL)
POSE = re.compile(
    r"\s*,\s*".join(rf"\b{key}\s*=\s*({texts.NUMBER})\s*{unit}" for key, unit in
                 (("X", "mm"), ("Y", "mm"), ("Z", "mm"), ("W", "deg"), ("P", "deg"), ("R", "deg")))
)  # fmt: skip
OTHER = re.compile(r"\b(UF|UT)\s*:\s*(\w+)")
SELECTED = re.compile(r"^\s*\d+:\s*(UFRAME_NUM|UTOOL_NUM)\s*=\s*([^;\r\n]+?)\s*;", re.MULTILINE)
MOVE = re.compile(r"^\s*\d+:\s*([JLCAS])\s+([^;]*);", re.MULTILINE)
VISITED = re.compile(r"(?<!\w)P\[\s*(\w+)")
COMPUTED = re.compile(r"(?<!\w)(Offset|Tool_Offset|VOFFSET|INC)\b", re.IGNORECASE)
INDIRECT = re.compile(r"(?<!\w)(PR\[|P\[\s*[A-Z]*R\[)")


def _read(text: str, n: int) -> texts.Program:
    code = texts.Code(text)
    begin = code.find("/POS")
    moves = code if begin < 0 else texts.Code(code[:begin])
    kinds: dict[str, bool] = {}
    notes, offset = [], set()
    for match in MOVE.finditer(moves):
        line, (kind, to) = moves.where(match.start(1)), match.groups()
        target = to.partition(" ")[0]
        if INDIRECT.match(target):
            notes.append(f"{line}: a motion to a register ({target}) is kept")
        elif computed := COMPUTED.search(to):
            offset.update(VISITED.findall(to))
            notes.append(f"{line}: {target} is computed ({computed.group(1)}); kept")
        for number in VISITED.findall(to):
            kinds.setdefault(number, kind != "J")
    every = {slot.name: slot for slot in _slots(code, max(begin, 0), n, kinds)}
    listed = [f"P[{number}]" for number, _ in POSITION.findall(text, max(begin, 0))]
    unread = f"neither X ... R nor J1 ... J{n} of the first group; kept"
    notes += [f"{name}: {unread}" for name in listed if name not in every]
    slots = {name: slot for name, slot in every.items() if name[2:-1] not in offset}
    order = [name for name in dict.fromkeys([*(f"P[{k}]" for k in kinds), *slots]) if name in slots]
    posed = [slot for slot in slots.values() if slot.target.pose is not None]
    stated = [(slot.target.where, key, value) for slot in posed for key, value in _header(text, slot)]
    if posed:
        selected = SELECTED.finditer(moves)
        stated += [(moves.where(m.start(1)), m.group(1), m.group(2)) for m in selected]
    others = (one for one in stated if one[1][:2] == "UF" and one[2] not in "0F")
    frame = next((f"{line}: {key} : {value}" for line, key, value in others), "")
    tools = [
        ToolStatement(where, f"UT : {value}", np.eye(4) if value == "0" else None)
        for where, key, value in stated
        if key[:2] == "UT" and value != "F"
    ]
    visited = tuple(replace(slots[name], used=not kinds or name[2:-1] in kinds) for name in order)
    return texts.Program(visited, tuple(notes), frame, tuple(tools))


def _header(text: str, slot: texts.Slot) -> list[tuple[str, str]]:
    """User frame and tool of a position as it states them."""
    first = slot.spans[0][0]
    return OTHER.findall(text, text.rfind("{", 0, first), first)


def _remarked(text: str, comment: str) -> str:
    """With a remark as the first line of the program; the numbers of the others follow."""
    begin, end = text.find("/MN"), text.find("/POS")
    if begin < 0 or end < begin:
        return text
    begin = text.find("\n", begin) + 1
    lines = re.sub(r"(?m)^(\s*)(\d+):", lambda m: f"{m.group(1)}{int(m.group(2)) + 1}:", text[begin:end])
    return f"{text[:begin]}   1:  !{comment} ;{texts.newline_of(text)}{lines}{text[end:]}"


def _slots(text: texts.Code, begin: int, n: int, straight: Mapping[str, bool]) -> Iterator[texts.Slot]:
    joints = re.compile(r"\s*,\s*".join(rf"J{k}\s*=\s*({texts.NUMBER})\s*deg" for k in range(1, n + 1)))
    for match in POSITION.finditer(text, begin):
        group = GROUP.search(text, *match.span(2))
        low, high = group.span(1) if group else match.span(2)
        name, by_line = f"P[{match.group(1)}]", straight.get(match.group(1), False)
        where = text.where(match.start(), name)
        if match_ := POSE.search(text, low, high):
            spans = texts.numbers_in(match_, 6)
            *xyz, w, p, r = text.values(spans)
            pose = rigid(rpy_matrix(np.radians([w, p, r])), 1e-3 * np.array(xyz))
            yield texts.Slot(texts.Target(where, pose, straight=by_line), name, spans)
        elif match_ := joints.search(text, low, high):
            spans = texts.numbers_in(match_, n)
            readings = np.radians(text.values(spans))
            yield texts.Slot(texts.Target(where, readings=readings, straight=by_line), name, spans)


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[texts.Number]:
    return [
        *texts.lengths_of(pose),
        *(texts.Number(x, texts.ANGLE) for x in np.degrees(rpy_of(pose[:3, :3])).tolist()),
    ]


FANUC = texts.Format(
    "fanuc",
    (".ls",),
    _read,
    "FANUC LS: P[n] as X, Y, Z, W, P, R or J1 ... Jn of the first motion group",
    _pose,
    _remarked,
    dialect=texts.Dialect(
        {r"(\d+)": ("DI[{}]=ON", "DI[{}]=OFF"), r"tool:(\d+)": ("RI[{}]=ON", "RI[{}]=OFF")},
        "1",
        unsafe=r"[\];:\"]",
    ),
)
