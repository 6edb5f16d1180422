"""KUKA: positions in KRL (.src, .dat): E6POS, POS, E6AXIS and AXIS in declarations, assignments, motions.

X, Y, Z in mm; A, B, C in degrees: R = Rz(A) Ry(B) Rx(C). A1 ... in degrees. A bit of the turn T is set where
an axis is negative: it selects the solution (of a PTP strictly: other motions ignore it), and is written for
the corrected readings. The status S is kept.
Relative motions (PTP_REL, LIN_REL) and frames ($BASE, $TOOL) are no positions. A position whose components
are assigned (XP1.X = ...), or that a motion moves on (XP1 : F), is computed and kept.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from string import ascii_lowercase, ascii_uppercase

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.programs import text as texts
from bayescal.programs.tools import ToolStatement

AGGREGATE = re.compile(r"\{\s*(?:(?:E6POS|POS|E6AXIS|AXIS|FRAME)\s*:)?([^{}]*)\}", re.IGNORECASE)
COMPONENT = re.compile(rf"\b([A-Z]\d?)\s+({texts.NUMBER})", re.IGNORECASE)
DECLARED = re.compile(r"\b(?:E6POS|POS|E6AXIS|AXIS)\s+([\w\[\],$ ]+)", re.IGNORECASE)
ASSIGNED = re.compile(r"(\$?\w+)\s*(?:\[[^\]]*\])?\s*=\s*$")
MOTION = re.compile(r"\b(S?PTP|S?LIN|S?CIRC|SPL)\s+(?:(?:\{[^{}]*\}|\w+)\s*,\s*)?$", re.IGNORECASE)
OTHER_BASE = re.compile(
    r"\bBASE_NO\s+[1-9]\d*|#BASE\s*,\s*[1-9]\d*|\$BASE\s*=\s*(?!\$NULLFRAME)\S+", re.IGNORECASE
)
TOOL = re.compile(r"\$TOOL\s*=\s*(\{[^{}]*\}|\S+)|\b(TOOL_NO)\s+(\d+)|#TOOL\s*,\s*(\d+)", re.IGNORECASE)
TOOL_DATA = re.compile(r"\bTOOL_DATA\[\s*(\d+)\s*\]\s*=\s*(\{[^{}]*\})", re.IGNORECASE)
NUMBERED = re.compile(r"TOOL_DATA\[\s*(\d+)\s*\]", re.IGNORECASE)
RELATIVE = re.compile(r"\bS?(?:PTP|LIN|CIRC)_REL\b", re.IGNORECASE)
COMPUTED = re.compile(
    r"^[ \t]*(\w+)\s*(?:\[[^\]]*\])?\s*(?:\.\s*\w+\s*=|=\s*(?!\s*\{))", re.IGNORECASE | re.MULTILINE
)
MOVED_ON = re.compile(r"\b(?:S?PTP|S?LIN|S?CIRC|SPL)\s+([^\r\n]*:[^\r\n]*)", re.IGNORECASE)
CAPITALS = str.maketrans(ascii_lowercase, ascii_uppercase)
NEAR_ZERO = np.radians(0.1)  # rad: there either bit of the turn is accepted


def _read(text: str, n: int) -> texts.Program:
    code = texts.Code(texts.Code.of(text, ";").translate(CAPITALS))  # names have no case
    declared = {name for match in DECLARED.finditer(code) for name in re.findall(r"\w+", match.group(1))}
    lines, points = (
        set(re.findall(rf"\bS?(?:{kinds})\s+(\w+)", code, re.IGNORECASE)) for kinds in ("LIN|CIRC", "PTP")
    )
    notes = [f"{code.where(m.start())}: a {m.group()} is kept" for m in RELATIVE.finditer(code)]
    computed = {m.group(1): m for m in reversed(list(COMPUTED.finditer(code))) if m.group(1) in declared}
    for match in MOVED_ON.finditer(code):
        outside = re.sub(r"\{[^{}]*\}", "", match.group(1))  # a type of an aggregate has a colon too
        names = declared & set(re.findall(r"\w+", outside)) if ":" in outside else set()
        computed = {**dict.fromkeys(names, match), **computed}
    notes += [f"{code.where(m.start(1))}: {name} is computed; kept" for name, m in computed.items()]
    slots = []
    moves = bool(re.search(r"\b(?:S?PTP|S?LIN|S?CIRC|SPL)\b", code, re.IGNORECASE))
    for match in AGGREGATE.finditer(code):
        before = code[max(code.rfind("\n", 0, match.start()), 0) : match.start()]
        assigned, motion = ASSIGNED.search(before), MOTION.search(before)
        name = assigned.group(1) if assigned else ""
        if name in computed or (not motion and name not in declared):
            continue
        where = code.where(match.start(), name)
        parts = {m.group(1).upper(): m.span(2) for m in COMPONENT.finditer(code, *match.span(1))}
        by_axes = name in points if motion is None else motion.group(1).upper().endswith("PTP")
        straight = name in lines if motion is None else not by_axes
        slot = _slot(code, parts, n, where, name, straight)
        if motion and code[match.end() :].lstrip(" \t")[:1] == ":":
            notes.append(f"{where}: the position is computed; kept")
            continue
        if slot is None:
            notes.append(f"{where}: not all components are given; kept")
            continue
        used = motion is not None or not moves or name in points | lines
        # along a line, and where the motion is not known, T need not hold
        target = slot.target if by_axes else replace(slot.target, strict=False)
        slots.append(replace(slot, target=target, used=used))
    posed = any(slot.target.pose is not None for slot in slots)
    tools = tuple(_tools(code)) if posed else ()
    return texts.Program(tuple(slots), tuple(notes), code.first(OTHER_BASE) if posed else "", tools)


def _tools(code: texts.Code) -> Iterator[ToolStatement]:
    """Tools that a program selects, with their poses where the same file has them."""
    stated = {int(m.group(1)): m.group(2) for m in TOOL_DATA.finditer(code)}
    for match in TOOL.finditer(code):
        value, number = match.group(1) or "", match.group(3) or match.group(4)
        if by_number := NUMBERED.match(value):
            number = by_number.group(1)
        text = value if number is None else stated.get(int(number), "{}" if int(number) == 0 else "")
        parts = {m.group(1).upper(): float(m.group(2)) for m in COMPONENT.finditer(text)}
        pose = None
        if value.upper().startswith("$NULLFRAME") or text == "{}":
            pose = np.eye(4)
        elif parts.keys() >= set("XYZABC"):
            x, y, z, a, b, c = (parts[key] for key in "XYZABC")
            pose = rigid(rpy_matrix(np.radians([c, b, a])), 1e-3 * np.array([x, y, z]))
        yield ToolStatement(code.where(match.start()), " ".join(match.group().split()), pose)


def _slot(
    code: texts.Code, parts: dict[str, tuple[int, int]], n: int, where: str, name: str, straight: bool
) -> texts.Slot | None:
    """A position by its components, or None if some are missing."""
    axes = [f"A{k}" for k in range(1, n + 1)]
    if parts.keys() >= set(axes):
        spans = tuple(parts[key] for key in axes)
        return texts.Slot(texts.Target(where, readings=np.radians(code.values(spans))), name, spans)
    if not parts.keys() >= set("XYZABC"):
        return None
    spans = tuple(parts[key] for key in "XYZABC")
    x, y, z, a, b, c = code.values(spans)
    pose = rigid(rpy_matrix(np.radians([c, b, a])), 1e-3 * np.array([x, y, z]))
    admits = None
    if "T" in parts:
        spans = (*spans, parts["T"])
        admits = _turned(int(code.values(spans)[-1]))
    return texts.Slot(texts.Target(where, pose, straight=straight, admits=admits), name, spans)


def _turned(turn: int) -> Callable[[np.ndarray], bool]:
    """Whether readings (n,), rad, have the signs that a turn states."""

    def admits(readings: np.ndarray) -> bool:
        stated = np.array([turn >> k & 1 for k in range(len(readings))], bool)
        return bool(np.all((stated == (readings < 0)) | (np.abs(readings) < NEAR_ZERO)))

    return admits


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[texts.Number]:
    c, b, a = np.degrees(rpy_of(pose[:3, :3])).tolist()
    out = [*texts.lengths_of(pose), *(texts.Number(angle, texts.ANGLE) for angle in (a, b, c))]
    if len(old) > 6:  # the bits of external axes are kept
        bits = sum(1 << k for k, x in enumerate(readings) if x < 0)
        out.append(texts.Number(int(old[6]) >> len(readings) << len(readings) | bits, 0))
    return out


KUKA = texts.Format(
    "kuka",
    (".src", ".dat"),
    _read,
    "KUKA .src and .dat: E6POS, POS, E6AXIS, AXIS in declarations, assignments and motions",
    _pose,
    texts.after_line(r"^[ \t]*(?:GLOBAL\s+)?(?:DEF|DEFFCT|DEFDAT)\b", "; "),
    dialect=texts.Dialect(
        {
            r"(\d+)": ("$IN[{}]==TRUE", "$IN[{}]==FALSE"),
            r"measure:(\d+)": ("$MEAS_PULSE[{}]==TRUE", "$MEAS_PULSE[{}]==FALSE"),
        },
        "1",
    ),
)
