"""Whether two sessions are of the same robot, with the same mounting and conventions."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.dataset.types import Dataset
from bayescal.errors import BayescalError

RELATIVE, ABSOLUTE = 1e-8, 1e-9
"""How alike two robot files must be, SI: to the digits that files are written with."""
NOT_THE_ARM = ("limits", "reductions", "radii")
"""Fields of a robot that may be told otherwise, or not at all, of the same arm."""


def check_alike(first: Dataset, other: Dataset) -> None:
    """Refuse two sessions of different robots, mountings or conventions."""
    difference = arm_difference(first.robot, other.robot)
    if difference:
        what = f"not the robot of {first.name}: {difference}"
        raise BayescalError(what, str(other.folder), "fit the sessions of each arm apart")
    turns = [s.noise.orientation for s in (first, other) if s.noise.orientation is not None] or [0.0]
    pairs = (
        ("gravity_mps2", first.gravity, other.gravity),
        ("readings", first.readings, other.readings),
        ("torques", first.torques, other.torques),
        ("noise.joint_deg", np.degrees(first.noise.joint), np.degrees(other.noise.joint)),
        ("noise.orientation_deg", np.degrees(turns[0]), np.degrees(turns[-1])),
    )
    for key, here, there in pairs:
        same = here == there if isinstance(here, str) else bool(np.all(_close(here, there)))
        if not same:
            what = f"`{key}` is {_words(there)}, in {first.name} it is {_words(here)}"
            raise BayescalError(what, str(other.folder), "state what is true of both, or fit them apart")


def arm_difference(one: Robot, other: Robot) -> str:
    """The first thing in which two robot files differ, in words; "" where they are of one arm."""
    for field in fields(Robot):
        if field.name in NOT_THE_ARM:
            continue
        here, there = getattr(one, field.name), getattr(other, field.name)
        name = field.name.replace("_", " ")
        if here is None and there is None:
            continue
        if here is None or there is None:
            return f"{name} given for one of them only"
        if not isinstance(here, np.ndarray):
            if here != there:
                return f"{name} {there}, not {here}"
        elif here.shape != there.shape:
            return f"{len(there)} rows of {name}, not {len(here)}"
        elif not np.all(close := _close(here, there)):
            at = tuple(int(k) for k in np.argwhere(~close)[0])
            of = f" of {one.joint_names[at[0]]}" if len(here) == one.n else ""
            return f"{name}{of} {there[at]:.9g}, not {here[at]:.9g} (SI)"
    return ""


def _close(here: Any, there: Any) -> np.ndarray:
    return np.isclose(here, there, rtol=RELATIVE, atol=ABSOLUTE)


def _words(value: Any) -> str:
    return f"{np.round(value, 9)}" if np.ndim(value) else f"{value}"
