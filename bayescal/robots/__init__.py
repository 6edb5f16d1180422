"""Robots: the built-in ones, and those in a robot.yaml, URDF or xacro file beside a dataset.

Functions
---------
load_robot
    A `Robot` by name or path.
builtin_robots
    Names of the built-in ones.
robot_to_yaml
    Text of a robot.yaml.
table
    The built-in ones: joints, reach, masses, sources.

A xacro file is expanded in a process of its own, where the user allowed it. xacro evaluates Python
expressions and has no sandbox: from `${...}` any object of the interpreter can be reached, so the file is a
program with the rights of the user. No filter of its text can change that. It is expanded only where the user
says so; the process has none of the user's environment (tokens, paths), and limits of time and memory against
a file that is only wrong.
"""

from __future__ import annotations

import difflib
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.chain import Robot, chain_of, frames
from bayescal.errors import BayescalError
from bayescal.robots.schema import SCHEMA, robot_from
from bayescal.robots.schema import robot_to_yaml as robot_to_yaml
from bayescal.robots.urdf import LARGEST, refuse_network, robot_from_urdf
from bayescal.storage.files import check_schema, read_document
from bayescal.storage.reading import check_inside, decoded

if TYPE_CHECKING:
    from pandas import DataFrame

Loaded = tuple[Robot, bytes]
"""A robot in SI units, and the content of its file (to hash), of xacro the URDF that it stands for."""
_HERE = Path(__file__).parent


def builtin_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(p.stem for p in _HERE.glob("*.yaml")))


def names() -> tuple[str, ...]:
    """Names of the built-in robots, of the public API.

    Examples
    --------
    >>> import bayescal as bc
    >>> "ur5e" in "".join(bc.robots.names())
    True
    """
    return builtin_robots()


def full_name(reference: str) -> str:
    """The only built-in robot that has this part in its name (``ur5e``); else the reference itself."""
    near = [name for name in builtin_robots() if reference.lower() in name.split("-")]
    return near[0] if len(near) == 1 else reference


def is_xacro(reference: str) -> bool:
    """Whether a reference is the path of a xacro file."""
    return Path(reference.partition("#")[0]).suffix.lower() == ".xacro"


def load_robot(
    reference: str, folder: Path | None = None, allow_xacro: bool = False, inside: bool = False
) -> Loaded:
    """Read a robot.

    Parameters
    ----------
    reference : str
        A built-in name (`builtin_robots`), or the path of a robot.yaml, URDF or xacro; of the latter two
        ``arm.urdf#tool0`` says which link is the flange (the end of the longest chain where left out), and
        ``cell.urdf#left_tool0..right_tool0`` that F0 is the flange of a first arm.
    folder : Path, optional
        What a path is relative to; the working directory where left out.
    allow_xacro : bool
        Whether a xacro file, which is a program, may be executed; refused otherwise.
    inside : bool
        Whether the file must be in `folder`: what a dataset names is part of the dataset.

    Returns
    -------
    Loaded

    Raises
    ------
    BayescalError
        With the file and line, if there is no such robot or its file cannot be used.
    """
    names = builtin_robots()
    refuse_network(reference, "")
    file, _, tip = reference.partition("#")
    is_markup = Path(file).suffix.lower() in (".urdf", ".xacro")
    path = (folder or Path()) / (file if is_markup else reference)
    named = is_markup or path.suffix.lower() in (".yaml", ".yml") or "/" in reference
    if reference not in names and (named or os.path.isfile(path)):
        if inside:
            check_inside(path, folder or Path(), f"robot `{reference}`")
        if is_markup:
            content = expanded(path, allow_xacro) if is_xacro(reference) else decoded(path, LARGEST)[1]
            return robot_from_urdf(content, path.name, tip), content
    elif reference in names:
        path = _HERE / f"{reference}.yaml"
    else:
        near = [name for name in names if reference.lower() in name.split("-")]
        near += difflib.get_close_matches(reference, names, 1)
        hint = f"did you mean `{near[0]}`" if near else "`bayescal robots` lists the built-in ones"
        remedy = f"{hint}; or give the path of a robot.yaml or URDF"
        raise BayescalError(f"no robot is called `{reference}`", "", remedy)
    document = read_document(path)
    check_schema(document, SCHEMA)
    return robot_from(document), document.content


def only_one_arm(robot: Robot, what: str, remedy: str = "") -> None:
    """Refuse a chain through two arms, for what does not know them.

    Raises
    ------
    BayescalError
    """
    if robot.ground is not None:
        between = robot.joint_names[robot.ground.link - 1]
        what = f"two arms, which stand on the link behind {between}: {what} know one arm only"
        raise BayescalError(what, robot.name, remedy)


def only_revolute(robot: Robot, what: str, remedy: str = "", two_arms: bool = False) -> None:
    """Refuse a robot with prismatic joints or (unless `two_arms`) of two arms, for what does not know them.

    Raises
    ------
    BayescalError
    """
    if not two_arms:
        only_one_arm(robot, what, remedy)
    if robot.slides.any():
        name = robot.joint_names[int(np.argmax(robot.slides))]
        raise BayescalError(f"{name} is prismatic: {what} know revolute joints only", robot.name, remedy)


STARTS = 256
"""Random configurations, of which the best are improved."""
IMPROVED = 2


def table(part: str = "") -> DataFrame:
    """The built-in robots, by name.

    Parameters
    ----------
    part : str
        Only names with this part; all where left out.

    Returns
    -------
    DataFrame
        Columns `joints`, `reach_mm` (largest distance of the flange from axis 1 within the joint limits),
        `masses` (whether those of the links are known) and `sources` (text).

    Raises
    ------
    BayescalError
        If no name has it.

    Examples
    --------
    >>> import bayescal as bc
    >>> bc.robots.table("ur5e").joints.to_dict()
    {'universal-robots-ur5e': 6}
    """
    from pandas import DataFrame

    names = [name for name in builtin_robots() if part.lower() in name]
    if not names:
        raise BayescalError(f"no built-in robot has `{part}` in its name", "", "bayescal robots lists all")
    rows = {}
    for name in names:
        robot, content = load_robot(name)
        rows[name] = robot.n, round(1e3 * reach(robot), 1), robot.masses is not None, _sources(content)
    columns = ["joints", "reach_mm", "masses", "sources"]
    return DataFrame(list(rows.values()), index=list(rows), columns=columns).rename_axis("name")


def reach(robot: Robot) -> float:
    """Largest distance, m, of the flange from axis 1 within the joint limits: a search from random starts."""
    from scipy.optimize import minimize

    chain, sign = chain_of(robot), np.sign(np.diag(robot.link_from_reading))
    low, high = robot.limits_within(np.pi).T
    foot = np.linalg.inv(robot.base)

    def distance(q: np.ndarray) -> np.ndarray:
        flange = frames(chain, np.atleast_2d(sign * q))[:, -1, :, 3] @ foot.T
        return np.hypot(flange[:, 0], flange[:, 1])

    def short(q: np.ndarray) -> float:
        return -float(distance(q)[0])

    starts = np.random.default_rng(0).uniform(low, high, (STARTS, robot.n))
    best = starts[np.argsort(-distance(starts))[:IMPROVED]]
    limits = list(zip(low, high, strict=True))
    return max(-float(minimize(short, q, bounds=limits).fun) for q in best)


def _sources(content: bytes) -> str:
    """The comment at the beginning of a robot's file, as one text."""
    lines = content.decode().splitlines()
    end = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    return " ".join(line.lstrip("# ").strip() for line in lines[:end])


SECONDS, WAITING = 8, 40
"""Of processor time, and of waiting on a busy machine. The largest descriptions of arms take one or two."""

BYTES = 2**30
"""Of memory. The interpreter and xacro take some 30 MB."""

KEPT = ("LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT")
"""Variables without which some interpreters do not start."""

LONGEST = 300
"""Characters that are shown of what xacro says."""


def expanded(path: Path, allowed: bool) -> bytes:
    """XML that a xacro file stands for, with its arguments' defaults.

    Parameters
    ----------
    path : Path
        Files that it includes are looked for beside it.
    allowed : bool
        Whether the user allowed this file to be executed.

    Raises
    ------
    BayescalError
        If it is not allowed, or xacro cannot expand it within the limits.
    """
    urdf = path.name[: -len(path.suffix)].removesuffix(".urdf") + ".urdf"
    by_hand = f"`xacro {shlex.quote(path.name)} > {shlex.quote(urdf)}`"
    if not allowed:
        remedy = f"expand it, {by_hand}, and name {urdf}; or, if you trust its author, give --allow-xacro"
        raise BayescalError("a xacro file is a program, which is not executed unasked", path.name, remedy)
    if not path.is_file():
        raise BayescalError("no such file", path.name, f"looked in {path.parent}")
    asked = {"file": path.name, "path": sys.path, "seconds": SECONDS, "bytes": BYTES}
    command = [sys.executable, "-I", str(Path(__file__).with_name("xacro_child.py")), json.dumps(asked)]
    environment = {name: os.environ[name] for name in KEPT if name in os.environ}
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:  # a pipe would hold any amount
        try:
            streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": err}
            done = subprocess.run(command, cwd=path.parent, env=environment, timeout=WAITING, **streams)
            code = done.returncode
        except subprocess.TimeoutExpired:
            code = -1
        out.seek(0)
        err.seek(0)
        content, message = out.read(), " ".join(err.read(BYTES).decode(errors="replace").split())
    if code == 0:
        return content
    if code < 0:
        message = f"it was stopped after {SECONDS} s"
    remedy = "include files by their path from this one and give arguments a default; or expand it where ROS "
    remedy += f"is installed, {by_hand}, and name {urdf}"
    raise BayescalError(f"xacro cannot expand it: {message[:LONGEST]}", path.name, remedy)
