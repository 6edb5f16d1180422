"""A robot program as text with positions in it: what a format finds, and how numbers are put back in place.

Everything but the numbers of the positions is kept, byte for byte: programs are read as Latin-1, in which
every byte is a character.

The simplest format stands here: CSV of RoboDK (its calibration targets, its lists of the joints of a program)
with joints in degrees in the first n columns, with or without a header; other columns are kept.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import BayescalError
from bayescal.programs.tools import ToolStatement

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
"""A number as programs write it; FANUC leaves the zero before the point out."""
LENGTH, ANGLE = 4, 5
"""Least decimals of mm and of deg: 0.1 µm, and at a metre 0.2 µm."""


@dataclass(frozen=True)
class Target:
    """A position that a table or a program states.

    Parameters
    ----------
    where : str
        For messages: the line, and the name of the position if it has one.
    id : str
        Of the row of a table; "" where it has none.
    pose : np.ndarray, shape (4, 4), optional
        Of the tool's frame in the frame of the targets, m.
    readings : np.ndarray, shape (n,), optional
        rad. Without a pose: nominal readings, which stand for the pose that the nominal model gives them.
        With a pose: readings to which the solution is the nearest.
    straight : bool
        The tool moves to it along a straight line, not by joint angles.
    velocity : np.ndarray, shape (n,), optional
        rad/s, of the readings on arrival; by default it follows from the target before.
    payload : float
        kg, beyond the tool.
    tool : str, optional
        Its name; default: that of the compensation.
    admits : callable, optional
        Whether readings (n,), rad, have the configuration that the program states.
    strict : bool
        A target without a solution that `admits` has none; otherwise the nearest is taken.
    """

    where: str
    pose: np.ndarray | None = None
    readings: np.ndarray | None = None
    straight: bool = False
    velocity: np.ndarray | None = None
    payload: float = 0.0
    tool: str | None = None
    id: str = ""
    admits: Callable[[np.ndarray], bool] | None = None
    strict: bool = True


@dataclass(frozen=True)
class Corrected:
    """What a compensation gives for a target; only `reason` where it has no solution."""

    reason: str = ""
    readings: np.ndarray | None = None  # (n,) rad, that put the tool there
    pose: np.ndarray | None = None  # (4, 4) in the frame of the targets: where the nominal model has these
    nominal: np.ndarray | None = None  # (n,) rad, of the nominal model
    solutions: int | None = None  # of the nominal model, up to whole turns; None where readings were given
    u: float = np.nan  # m: standard uncertainty of the TCP, length of the vector
    error: float = np.nan  # m: of the TCP at the nominal readings
    inside: bool = False  # the region that the session has probed
    expanded: float = np.nan  # m: length that the error of the TCP does not exceed (95.45 %)


@dataclass(frozen=True)
class Number:
    """A number to be written, with its least decimals; it keeps those that the program had."""

    value: float
    decimals: int


def degrees_of(readings: np.ndarray) -> list[Number]:
    """Readings (n,), rad, in degrees."""
    return [Number(x, ANGLE) for x in np.degrees(readings).tolist()]


@dataclass(frozen=True)
class Slot:
    """A position in the text of a program: its target, its name, and where each of its numbers stands.

    `whole` is the expression that becomes a list of joints, where a pose cannot be written. A position that
    the program does not use (`used`) may have no solution.
    """

    target: Target
    name: str
    spans: tuple[tuple[int, int], ...]
    whole: tuple[int, int] | None = None
    used: bool = True

    @property
    def place(self) -> int:
        """Where the position begins."""
        return self.whole[0] if self.whole is not None else self.spans[0][0]


@dataclass(frozen=True)
class Program:
    """Positions of a program in the order in which they are visited, and what was left as it is.

    `elsewhere`: what says that poses are not in the frame of the base, and its line; "" if nothing does.
    `tools`: the tools that the program states.
    """

    slots: tuple[Slot, ...]
    notes: tuple[str, ...] = ()
    elsewhere: str = ""
    tools: tuple[ToolStatement, ...] = ()


@dataclass(frozen=True)
class Dialect:
    """What differs between probing programs of controllers beside their templates (`probing`).

    Attributes
    ----------
    triggers : mapping of str to (str, str)
        Forms of ``--probe-input`` as patterns, and what is true of an input while the probe is pressed, and
        while it is not.
    first : str
        The input that is taken where none is stated.
    force : str
        As a trigger, by N; "" if the controller has no force.
    unsafe : str
        Characters that end a text or are not allowed in it.
    """

    triggers: Mapping[str, tuple[str, str]]
    first: str
    force: str = ""
    unsafe: str = r'["]'


@dataclass(frozen=True)
class Format:
    """A format of robot programs: how its positions are read and written, and its probing programs.

    Parameters
    ----------
    name : str
        In options and messages.
    suffixes : tuple of str
        Of files; small letters.
    read : callable
        Program of a text, for an arm of n joints.
    summary : str
        What is read.
    pose : callable, optional
        Numbers of a pose from (pose (4, 4), m; readings (n,), rad; the numbers of the program); without it
        every pose has a `whole` that becomes a list of joints.
    remarked : callable, optional
        The program with a comment; without it the format has none.
    dialect : Dialect, optional
        Of probing programs; without it there are none.
    joints : callable
        Numbers of a joint position in the order of its spans, from readings (n,), rad; by default in degrees.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[str, int], Program]
    summary: str
    pose: Callable[[np.ndarray, np.ndarray, Sequence[float]], Iterable[Number]] | None = None
    remarked: Callable[[str, str], str] | None = None
    dialect: Dialect | None = None
    joints: Callable[[np.ndarray], Iterable[Number]] = degrees_of


def line_of(text: str, place: int) -> int:
    """The line, from 1, of a character."""
    return text.count("\n", 0, place) + 1


class Code(str):
    """A program as text, and what readers ask of it."""

    @classmethod
    def of(cls, text: str, comment: str) -> Code:
        """A text with comments (`comment` to the end of the line) and strings as blanks, equally long."""
        pattern = re.compile(rf'"[^"\n]*"|{re.escape(comment)}[^\r\n]*')
        return cls(pattern.sub(lambda match: " " * len(match.group()), text))

    def where(self, place: int, name: str = "") -> str:
        """The line of a character, and the name of what begins there."""
        return f"line {line_of(self, place)}" + (f", {name}" if name else "")

    def first(self, pattern: re.Pattern[str]) -> str:
        """The first match of a pattern with its line, or ""."""
        match = pattern.search(self)
        return f"{self.where(match.start())}: {match.group()}" if match else ""

    def values(self, spans: Iterable[tuple[int, int]]) -> list[float]:
        """The numbers at some places."""
        return [float(self[low:high]) for low, high in spans]

    def arguments(self, low: int, high: int) -> list[tuple[int, int]]:
        """Places of the arguments of a call between two places: its commas outside of all brackets."""
        depth, start, out = 0, low, []
        for place in range(low, high):
            depth += {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}.get(self[place], 0)
            if self[place] == "," and depth == 0:
                out.append((start, place))
                start = place + 1
        each = [(a, b, self[a:b]) for a, b in [*out, (start, high)] if self[a:b].strip()]
        return [(b - len(argument.lstrip()), a + len(argument.rstrip())) for a, b, argument in each]


def numbers_in(match: re.Match[str], count: int) -> tuple[tuple[int, int], ...]:
    """Where the first groups of a match stand in the text."""
    return tuple(match.span(group) for group in range(1, count + 1))


def lengths_of(pose: np.ndarray) -> list[Number]:
    """x, y and z of a pose (4, 4), m, in mm."""
    return [Number(x, LENGTH) for x in (1e3 * pose[:3, 3]).tolist()]


def after_line(pattern: str, prefix: str) -> Callable[[str, str], str]:
    """Programs with a comment behind the first line that matches a pattern; at the top if none does."""

    def remarked(text: str, comment: str) -> str:
        match = re.search(pattern, text, re.IGNORECASE | re.MULTILINE)
        begin = 0 if match is None else text.find("\n", match.end()) + 1
        return f"{text[:begin]}{prefix}{comment}{newline_of(text)}{text[begin:]}"

    return remarked


def newline_of(text: str) -> str:
    """What ends the lines of a text."""
    return "\r\n" if "\r\n" in text else "\n"


def rewritten(text: str, format_: Format, slots: Sequence[Slot], corrected: Sequence[Corrected]) -> str:
    """The text with corrected numbers in place.

    Raises
    ------
    BayescalError
        If a position that the program uses has no solution: a program with a part of its positions corrected
        is not written.
    """
    pieces: list[tuple[int, int, str]] = []
    for slot, target in zip(slots, corrected, strict=True):
        if target.reason and not slot.used:
            continue
        if target.reason:
            remedy = "correct the position or leave it out; nothing is written"
            raise BayescalError(f"no solution: {target.reason}", slot.target.where, remedy)
        assert target.readings is not None
        assert target.pose is not None
        if slot.whole is not None:
            listed = ", ".join(digits(number) for number in format_.joints(target.readings))
            pieces.append((*slot.whole, f"[{listed}]"))
            continue
        if slot.target.pose is None:
            numbers = format_.joints(target.readings)
        else:
            assert format_.pose is not None, "a format without poses has whole expressions"
            numbers = format_.pose(target.pose, target.readings, Code(text).values(slot.spans))
        for (low, high), number in zip(slot.spans, numbers, strict=True):
            pieces.append((low, high, _written(number, text[low:high])))
    out, end = [], 0
    for low, high, new in sorted(pieces):
        out += [text[end:low], new]
        end = high
    return "".join([*out, text[end:]])


def digits(number: Number, decimals: int = 0) -> str:
    """A number with its least decimals, or more."""
    new = f"{number.value:.{max(number.decimals, decimals)}f}" if number.decimals else f"{number.value:.0f}"
    return new[1:] if float(new) == 0 and new.startswith("-") else new


def _written(number: Number, old: str) -> str:
    """A number with the decimals that the program had."""
    return digits(number, len(old.lower().partition("e")[0].partition(".")[2]))


def _read(text: str, n: int) -> Program:
    row = re.compile(r"\s*,\s*".join([rf"\s*({NUMBER})"] * n) + r"\s*(?=,|;|$)")
    slots: list[Slot] = []
    begin = 0
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        bare = line.rstrip("\r\n")
        match = row.match(text, begin, begin + len(bare))
        if match:
            spans = numbers_in(match, n)
            target = Target(f"line {number}", readings=np.radians(Code(text).values(spans)))
            slots.append(Slot(target, f"{number}", spans))
        elif bare.strip() and slots:
            what = f"the first {n} cells are not numbers"
            raise BayescalError(what, f"line {number}", "a RoboDK table has the joints in degrees there")
        begin += len(line)
    return Program(tuple(slots))


ROBODK = Format("robodk", (".csv",), _read, "RoboDK CSV: joints in degrees in the first columns")
