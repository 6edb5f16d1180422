"""KUKA: positions in KRL (.src, .dat): E6POS, POS, E6AXIS and AXIS in declarations, assignments, motions.

X, Y, Z in mm; A, B, C in degrees: R = Rz(A) Ry(B) Rx(C). A1 ... in degrees. A bit of the turn T is set where
an axis is negative: it selects the solution (of a PTP strictly: other motions ignore it), and is written for
the corrected readings. The status S is kept.
Relative motions (PTP_REL, LIN_REL) and frames ($BASE, $TOOL) are no positions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

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
    first,
    lengths_of,
    line_of,
    masked,
    values_at,
)
from bayescal.exporting.compensate.targets import Target

AGGREGATE = re.compile(r"\{\s*(?:(?:E6POS|POS|E6AXIS|AXIS|FRAME)\s*:)?([^{}]*)\}", re.IGNORECASE)
COMPONENT = re.compile(rf"\b([A-Z]\d?)\s+({NUMBER})", re.IGNORECASE)
DECLARED = re.compile(r"\b(?:E6POS|POS|E6AXIS|AXIS)\s+([\w\[\],$ ]+)", re.IGNORECASE)
ASSIGNED = re.compile(r"(\$?\w+)\s*(?:\[[^\]]*\])?\s*=\s*$")
MOTION = re.compile(r"\b(S?PTP|S?LIN|S?CIRC|SPL)\s+(?:(?:\{[^{}]*\}|\w+)\s*,\s*)?$", re.IGNORECASE)
OTHER_BASE = re.compile(r"\bBASE_NO\s+[1-9]\d*|\$BASE\s*=\s*(?!\$NULLFRAME)\S+", re.IGNORECASE)
NEAR_ZERO = np.radians(0.1)  # rad: there either bit of the turn is accepted


def _read(text: str, n: int) -> Program:
    code = masked(text, ";")
    declared = {name for match in DECLARED.finditer(code) for name in re.findall(r"\w+", match.group(1))}
    lines, points = (
        set(re.findall(rf"\bS?(?:{kinds})\s+(\w+)", code, re.IGNORECASE)) for kinds in ("LIN|CIRC", "PTP")
    )
    slots, notes = [], []
    for match in AGGREGATE.finditer(code):
        before = code[max(code.rfind("\n", 0, match.start()), 0) : match.start()]
        assigned, motion = ASSIGNED.search(before), MOTION.search(before)
        name = assigned.group(1) if assigned else ""
        if not motion and name not in declared:
            continue
        where = f"line {line_of(code, match.start())}" + (f", {name}" if name else "")
        parts = {
            m.group(1).upper(): m.span(2) for m in COMPONENT.finditer(code, match.start(1), match.end(1))
        }
        by_axes = name in points if motion is None else motion.group(1).upper().endswith("PTP")
        straight = name in lines if motion is None else not by_axes
        slot = _slot(code, parts, n, where, name, straight)
        if (
            slot is not None and not by_axes
        ):  # along a line, and where the motion is not known, T need not hold
            slot = replace(slot, target=replace(slot.target, strict=False))
        if slot is None:
            notes.append(f"{where}: not all components are given; kept")
        else:
            slots.append(slot)
    return Program(tuple(slots), tuple(notes), first(OTHER_BASE, code))


def _slot(
    code: str, parts: dict[str, tuple[int, int]], n: int, where: str, name: str, straight: bool
) -> Slot | None:
    """A position by its components, or None if some are missing."""
    axes = [f"A{k}" for k in range(1, n + 1)]
    if parts.keys() >= set(axes):
        spans = tuple(parts[key] for key in axes)
        return Slot(Target(where, readings=np.radians(values_at(code, spans))), name, spans)
    if not parts.keys() >= set("XYZABC"):
        return None
    spans = tuple(parts[key] for key in "XYZABC")
    x, y, z, a, b, c = values_at(code, spans)
    pose = rigid(rpy_matrix(np.radians([c, b, a])), 1e-3 * np.array([x, y, z]))
    admits = None
    if "T" in parts:
        spans = (*spans, parts["T"])
        admits = _turned(int(values_at(code, spans)[-1]))
    return Slot(Target(where, pose, straight=straight, admits=admits), name, spans)


def _turned(turn: int) -> Callable[[np.ndarray], bool]:
    """Whether readings (n,), rad, have the signs that a turn states."""

    def admits(readings: np.ndarray) -> bool:
        stated = np.array([turn >> k & 1 for k in range(len(readings))], bool)
        return bool(np.all((stated == (readings < 0)) | (np.abs(readings) < NEAR_ZERO)))

    return admits


def _pose(pose: np.ndarray, readings: np.ndarray, old: Sequence[float]) -> list[Number]:
    c, b, a = np.degrees(rpy_of(pose[:3, :3])).tolist()
    out = [*lengths_of(pose), *(Number(angle, ANGLE) for angle in (a, b, c))]
    if len(old) > 6:  # the bits of external axes are kept
        own = sum(1 << k for k, x in enumerate(readings) if x < 0)
        out.append(Number(int(old[6]) >> len(readings) << len(readings) | own, 0))
    return out


KUKA = Format(
    "kuka",
    (".src", ".dat"),
    _read,
    _pose,
    degrees_of,
    "KUKA .src and .dat: E6POS, POS, E6AXIS, AXIS in declarations, assignments and motions",
)
