"""The built-in robots as a table: joints, reach, masses, and the sources of their numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.arm.chain import Robot, chain_of, frames
from bayescal.errors import BayescalError
from bayescal.robots.load import builtin_robots, load_robot

if TYPE_CHECKING:
    from pandas import DataFrame

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
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
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
