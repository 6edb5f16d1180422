"""Entries of other packages, each run by the Python of its own environment; see `worker`."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analysis.contest import session as sessions
from analysis.contest.learned import boosted, gaussian_process
from analysis.contest.ours import TOOLS, Answer, Given
from bayescal.arm import chain as reference
from bayescal.errors import BayescalError

TOP = Path(__file__).parents[2]
PEERS = {
    "pybotics": "pybotics",
    "FIGAROH": "figaroh",
    "robotkinecal": "robotkinecal",
    "gradient boosting": "boosting",
}
"""Tools that run in an environment of their own: name, and that of the worker."""


def run(python: Path, package: str, given: dict[str, Any]) -> np.ndarray:
    """What the worker of a package returns.

    Raises
    ------
    BayescalError
        If it fails, with its last line.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "given.json", Path(folder) / "found.json"
        source.write_text(json.dumps(given), encoding="utf-8")
        command = [str(python), "-m", "analysis.contest.worker", package, str(source), str(out)]
        environment = {**os.environ, "PYTHONPATH": str(TOP)}
        done = subprocess.run(command, cwd=TOP, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BayescalError(f"fails: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
        return np.array(json.loads(out.read_text(encoding="utf-8")))


def calibrated_by(given: Given, python: Path, package: str) -> Answer:
    """Calibration with the chain of a package."""
    robot, m = given.whole.robot, given.whole.measurements
    if robot.convention != "mdh" or not np.allclose(robot.flange, np.eye(4)) or np.any(robot.beta):
        raise BayescalError("the robot file has more than modified DH rows")
    used = np.unique(m.target[m.role == "calibrate"])
    read = all(given.whole.targets[t].kind == "instrument" for t in used)
    if package == "robotkinecal" and not (read and len(used) == len(np.unique(m.tool)) == 1):
        raise BayescalError("it calibrates from points that one instrument reads, with one tool")
    said, rows = sessions.files(given.folder)
    problem = {
        "said": said,
        "measurements": rows,
        "rows": np.column_stack([robot.alpha, robot.a, np.zeros(robot.n), robot.d]).tolist(),
        "base": robot.base.tolist(),
        "q": reference.link_angles(robot, m.readings).tolist(),
        "tool": m.tool.tolist(),
        "centres": [t.centre.tolist() for t in given.whole.tools],
    }
    if package == "figaroh" and robot.masses is not None:
        problem |= weights(given)
    return Answer(run(python, package, problem))


def weights(given: Given) -> dict[str, Any]:
    """Masses of the links, the last with the first tool, their centres before the length d, and gravity."""
    robot, tool = given.whole.robot, given.whole.tools[0]
    assert robot.masses is not None
    assert robot.centres_of_mass is not None
    mass, lever = robot.masses.copy(), robot.centres_of_mass + np.outer(robot.d, [0.0, 0.0, 1.0])
    if tool.mass:
        at = tool.centre_of_mass + np.array([0.0, 0.0, robot.d[-1]])
        lever[-1] = (mass[-1] * lever[-1] + tool.mass * at) / (mass[-1] + tool.mass)
        mass[-1] += tool.mass
    return {
        "mass": mass.tolist(),
        "lever": lever.tolist(),
        "gravity": np.asarray(given.whole.gravity).tolist(),
    }


def boosted_by(given: Given, python: Path) -> Answer:
    """Gradient boosting in the environment of scikit-learn."""

    def predict(x: np.ndarray, y: np.ndarray, new: np.ndarray) -> np.ndarray:
        return run(python, "boosting", {"x": x.tolist(), "y": y.tolist(), "new": new.tolist()})

    return boosted(given, predict)


def tools(environments: str) -> tuple[dict[str, Callable[[Given], Answer]], list[str]]:
    """All tools that can run here, and a line for each that cannot.

    Parameters
    ----------
    environments : str
        Prefix: the Python of a package is `<environments><package>/bin/python`.
    """
    out: dict[str, Callable[[Given], Answer]] = {**TOOLS, "bayescal + GP": gaussian_process}
    said = []
    for name, package in PEERS.items():
        python = Path(f"{environments}{package}") / "bin" / "python"
        if not python.exists():
            said.append(f"{name} is skipped: there is no {python}")
        elif package == "boosting":
            out[f"bayescal + {name}"] = partial(boosted_by, python=python)
        else:
            out[name] = partial(calibrated_by, python=python, package=package)
    return out, said
