"""What a format writes: its file, what is in it, and what it could hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayescal.effects import UNITS
from bayescal.fitted.arm import FittedArm

IN_F0 = "in_f0"
"""Name of the body, or link, of two arms whose frame is F0."""


@dataclass(frozen=True)
class Options:
    """What a user asks of an export.

    `state` is the row of the session whose state is written: time, temperature and events. `into` is the
    user's own file, which is patched in a copy.
    """

    state: int
    name: str = "arm"
    into: str = ""
    readings: str = "plain"


@dataclass(frozen=True)
class Item:
    """A fitted parameter in a file: value and u in `unit`, and the place where it acts."""

    parameter: str
    value: float
    u: float
    unit: str
    element: str
    attribute: str


Placed = Callable[[Path], str]
"""The content of a file that is written to a folder: what it names by relative paths is found from there."""


@dataclass(frozen=True)
class Written:
    """The content of an exported file.

    `beside` are further files by the suffix that is added to the name of the first one; `details` are further
    entries of the sidecar. `placed`, where the content depends on the folder, is that of a folder; else the
    content is right beside the file of the user.
    """

    content: str | bytes
    items: Sequence[Item] = ()
    beside: Mapping[str, str | bytes] = field(default_factory=dict)
    notes: Sequence[str] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    placed: Placed | None = None


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Parameters
    ----------
    suffix : str
    write : callable
        The file of an arm.
    holds : callable
        Whether the file can hold a parameter, by its number; one that changes with time counts as held
        if the file can hold it at one state.
    limits : str
        What it cannot hold, as the reason for the user: 'a URDF has constant geometry only'.
    into : bool
        Whether it can patch a file of the user.
    readings : tuple of str
        How it can hold errors of the readings: 'plain' in the file, 'script' in a script beside it.
    prismatic : bool
        Whether a new file holds prismatic joints.
    two_arms : tuple of str
        Where it holds a chain through two arms: 'plain', in a new file, and 'into', in one of the user.
    """

    suffix: str
    write: Callable[[FittedArm, Options], Written]
    holds: Callable[[FittedArm, int], bool]
    limits: str
    into: bool = False
    readings: tuple[str, ...] = ("plain",)
    prismatic: bool = False
    two_arms: tuple[str, ...] = ()


def item(arm: FittedArm, k: int, element: str, attribute: str) -> Item:
    """Parameter number `k` of an arm as it stands in a file."""
    p = arm.model.parameters[k]
    unit, factor = UNITS[p.unit]
    value = (p.nominal + float(arm.values[k])) * factor
    return Item(p.name, value, float(arm.covariance[k, k]) ** 0.5 * factor, unit, element, attribute)


def path_of(into: str) -> tuple[Path, str]:
    """File and link of ``arm.urdf#tool0``; the link is "" where none is given."""
    file, _, tip = into.partition("#")
    return Path(file), tip
