"""Where joint logs of other programs have each quantity (tables of data), and what is read from them.

Sources: message definitions of sensor_msgs, control_msgs, franka_msgs, ur_msgs; Universal Robots, RTDE guide
(output fields, written as ``NAME_0`` ... by csv_writer.py); LeRobot, dataset format v2.1 and v3; SAGE, README
('Data Format').
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.robots.servos import GRIPPER
from bayescal.storage.reading import library, table_beside

DEG = 180 / math.pi


SINGLE = {"temperature": "temperature_degC", "payload": "payload_kg"}
"""Columns of motion.csv beside those of joints."""
QUANTITIES = table_beside(__file__, "quantities.toml")
"""What the columns of a log may hold."""
LARGEST = {name: of["largest"] for name, of in QUANTITIES["joints"].items()}
LARGEST |= {"magnitude": 1e5, "temperature": 500.0, "payload": 1e5}
"""Larger values (SI) are corrupt."""
MEASURED = tuple(name for name, of in QUANTITIES["joints"].items() if "measured" in of)
"""Where all of them are zero, a driver does not measure them."""
AIDS = tuple(name for name, of in QUANTITIES["joints"].items() if "aid" in of)
"""Of each joint, read for constants and temperatures, not written."""
TEXTS = ("motion", "role", "kind")
OTHERS = (*SINGLE, *TEXTS)
"""What a row may have beside the joints: texts, and all of it."""


@dataclass(frozen=True)
class Message:
    """A ROS message: fields by quantity (one of several), that of the names, kind of torque, that of time."""

    joints: Mapping[str, Sequence[str]]
    names: str = ""
    torque: str = "motor"
    stamp: str = "header.stamp"


FORMATS = table_beside(__file__, "formats.toml")
UR_RTDE, SERIAL, EFFORTS = FORMATS["ur_rtde"], FORMATS["serial"], FORMATS["efforts"]
LEROBOT, SAGE = FORMATS["lerobot"], FORMATS["sage"]
MESSAGES = {kind: Message(**message) for kind, message in FORMATS["messages"].items()}
"""By type, the first that has all positions gives the rows. What the others are, says `formats.toml`."""


@dataclass(frozen=True)
class Stream:
    """Samples of one clock in SI: `time` (N,) s; `cells` by quantity, (N, n) of joints, else (N,), and texts.

    `line` (N,) is that of a text file, else the number of the sample. `held`: a value holds until the next.
    """

    name: str
    time: np.ndarray
    cells: Mapping[str, np.ndarray]
    line: np.ndarray | None = None
    held: bool = False

    @property
    def lines(self) -> np.ndarray:
        """Lines (N,), or numbers of the samples from 1 on."""
        return np.arange(1, len(self.time) + 1) if self.line is None else self.line


@dataclass(frozen=True)
class Record:
    """A file, bag or episode: the rows, streams with further quantities, and in words what was read.

    `kind` of the motion, where known; `torque` as in dataset.yaml, "" if unknown; `clock`: stamps from the
    `session` (rows of several records have one), of the `record`, or made of the `frame` number;
    `wrong`: what contradicts the stated unit of angles.
    """

    name: str
    rows: Stream
    others: tuple[Stream, ...] = ()
    kind: str = ""
    torque: str = ""
    clock: str = "record"
    notes: tuple[str, ...] = ()
    wrong: str = ""


def of_logs(name: str, file: str) -> Any:
    """A module of the extra `logs`; what is missing is refused with the command that installs it."""
    what = f"this log needs the package {name.partition('.')[0]}"
    return library(name, what, file, "install it: `pip install bayescal[logs]`")


def joint_order(names: Sequence[str], robot: Sequence[str], stated: str, where: str) -> tuple[list[int], str]:
    """Places of a robot's joints among the names of a log, and in words how they were found.

    Parameters
    ----------
    names : sequence of str
        Of the log.
    robot : sequence of str
        Joint names of the robot.
    stated : str
        Names of the log in the order of the robot, separated by commas; "" to find them.
    where : str
        For messages.

    Raises
    ------
    BayescalError
        If they do not follow from the names.
    """
    wanted = [part.strip() for part in stated.split(",") if part.strip()]
    if wanted and sorted(set(wanted) & set(names)) != sorted(wanted):
        lost = next((name for name in wanted if name not in names), "a name")
        what = f"no joint `{lost}`, or it is given twice"
        raise BayescalError(what, "--joints", f"the log has {listed(names, 12)}")
    if wanted and len(wanted) != len(robot):
        raise BayescalError(f"{len(wanted)} joints, the robot has {len(robot)}", "--joints", "name them all")
    arms = [name for name in names if not GRIPPER.search(name)]
    plain = {_plain(name): name for name in arms}
    numbered = {int(m[0]): name for name in arms if (m := re.search(r"\d+$", name))}
    n = len(robot)
    orders = [
        (wanted, "as stated"),
        ([name for name in robot if name in names], "by name"),
        ([plain[p] for r in robot if (p := _plain(r)) in plain], "by name"),
        *(([m for s in serial for m in _ending(arms, s)], "from the base on") for serial in SERIAL),
        ([numbered[k] for k in range(1, n + 1) if k in numbered and len(arms) == n], "by number"),
        ([numbered[k] for k in range(n) if k in numbered and len(arms) == n], "by number, from 0"),
    ]
    for order, how in orders:
        if len(order) == n:
            return [list(names).index(name) for name in order], f"joints {how}: {', '.join(order)}"
    what = f"the joints {listed(names, 12)} do not match those of the robot ({listed(robot, 12)})"
    remedy = "state them in the order of the robot: `--joints NAME,NAME,...`"
    if finger := next(filter(GRIPPER.search, robot), ""):
        remedy = f"`{finger}` is no joint of an arm: end it at the link before, `--robot FILE.urdf#LINK`"
    raise BayescalError(what, where, remedy)


def _plain(name: str) -> str:
    return re.sub(r"\.pos$|joint|main|[^a-z0-9]", "", name.lower())


def _ending(names: Sequence[str], name: str) -> list[str]:
    """The only name that is `name`, or `name` with any prefix, and the word joint behind it or not."""
    bare = {n: n.lower().removesuffix(".pos").removesuffix("_joint") for n in names}
    for ending in ([n for n in names if bare[n] == name], [n for n in names if bare[n].endswith(name)]):
        if len(ending) == 1:
            return ending
    return []


def places(
    names: Sequence[str], width: int, robot: Sequence[str], stated: str, where: str
) -> tuple[list[int], str]:
    """As `joint_order`, of lists of `width` values; without names the joints come first, in order."""
    if names:
        return joint_order(names, robot, stated, where)
    if stated:
        raise BayescalError("the log does not name its joints", "--joints", "remove it")
    if width < len(robot):
        what = f"{width} values a row, the robot has {len(robot)} joints"
        raise BayescalError(what, where, "check --robot")
    more = f", the first {len(robot)} of {width}" if width > len(robot) else ""
    return list(range(len(robot))), f"joints in their order{more} (assumed: the log does not name them)"
