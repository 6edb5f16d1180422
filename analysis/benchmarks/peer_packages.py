"""Our Levenberg-Marquardt against calibrations with pybotics 3 and FIGAROH 1, each in its own environment.

They fit fewer parameters: the lengths, twists and zeros of the rows, the tool and the faces. pybotics knows
neither stiffness nor Hayati's angle, and FIGAROH fits the same here. What they require excludes each other,
hence the environments; the contacts go there in a file.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from analysis.benchmarks.problem import Problem

TOP = Path(__file__).parents[2]
COLUMN = {"rx": 0, "tx": 1, "rz": 2, "tz": 3}  # of a row: alpha, a, theta, d


def export(problem: Problem) -> dict[str, Any]:
    """The problem as arrays; `entry` counts the rows' entries, then the tool's x, y, z."""
    model, chain = problem.model, problem.motion.chain
    robot, n = model.scene.dataset.robot, chain.n
    assert robot.convention == "mdh", "the chain is of modified DH rows"
    entry, sd, index = [], [], []
    for k, parameter in enumerate(model.parameters):
        (term, *more) = parameter.terms
        if more or parameter.centre != parameter.nominal or np.ndim(term.driver) or term.driver != 1.0:
            continue
        if term.frame == n + 1 and term.axis[0] == "t":
            entry.append(4 * n + "xyz".index(term.axis[1]))
        elif 1 <= term.frame <= n and term.axis in ("rz", "tz"):
            entry.append(4 * (term.frame - 1) + COLUMN[term.axis])
        elif 0 <= term.frame < n and term.axis in ("rx", "tx"):
            entry.append(4 * term.frame + COLUMN[term.axis])
        else:
            continue
        sd.append(parameter.sd)
        index.append(k)
    order = np.argsort(entry)
    rows = np.column_stack([robot.alpha, robot.a, np.zeros(n), robot.d])
    tools = problem.motion.tool
    assert np.all(tools == tools[0]), "one tool only"
    return {
        "rows": rows,
        "base": chain.base,
        "q": problem.motion.q,
        "tool": tools[0],
        "entry": np.array(entry, int)[order],
        "sd_of_entry": np.array(sd)[order],
        "index": np.array(index, int)[order],
        **vars(problem.walls(problem.sigma)),
    }


def python_of(package: str) -> Path:
    """The Python of the environment that `make bench` makes for a package."""
    return TOP / f".venv-{package}" / "bin" / "python"


def measure(problem: Problem, package: str, python: Path) -> dict[str, float] | None:
    """What `package_worker` reports when run by `python`, or None where that is not there."""
    if not python.exists():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        np.savez(path, **export(problem))
        command = [str(python), "-m", "analysis.benchmarks.package_worker", package, str(path)]
        environment = {**os.environ, "PYTHONPATH": str(TOP)}
        done = subprocess.run(command, cwd=TOP, env=environment, capture_output=True, text=True, check=True)
    out: dict[str, float] = json.loads(done.stdout)
    return out
