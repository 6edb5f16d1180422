"""Runs in the environment of a package: ``python -m analysis.contest.worker PACKAGE given.json found.json``.

pybotics and FIGAROH calibrate with the chain of the package, and the targets of `session`, located anew at
every step; Levenberg-Marquardt of SciPy. robotkinecal calibrates by its own solver, from points. boosting is
scikit-learn's `GradientBoostingRegressor` with its defaults.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from analysis.contest.session import certified, located, of, residuals_of

PATIENCE = 15.0  # s of CPU time, then the best so far
SD = {"length": 2e-3, "angle": 5e-3, "tool": 5e-3, "elasticity": 1e-3}
"""Of weak priors, m, rad and rad/(N m): they hold what no measurement determines."""


class _OutOfTime(Exception):
    pass


def chain(package: str, given: dict[str, Any]) -> np.ndarray:
    """Positions (N, 3), mm, after a calibration of all rows' lengths and angles and of the tools."""
    from analysis.benchmarks.package_worker import PACKAGES

    session = of(given["said"], given["measurements"], "")
    fitted, at = session.only("calibrate")
    rows, tool = np.array(given["rows"]), np.array(given["tool"])
    n, count = len(rows), len(given["centres"])
    sd = np.tile([SD["angle"], SD["length"], SD["angle"], SD["length"]], n)
    elastic = {key: given[key] for key in ("mass", "lever", "gravity") if key in given}
    last = n if elastic else 0
    sd = np.concatenate([sd, np.full(3 * count, SD["tool"]), np.full(last, SD["elasticity"])])
    every = np.arange(len(tool))

    def maker(some: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, Any]]:
        out = []
        for t in range(count):
            own = np.flatnonzero(tool[some] == t)
            if len(own):
                problem = {
                    "rows": rows, "base": np.array(given["base"]), "q": np.array(given["q"])[some[own]],
                    "tool": np.array(given["centres"][t]), "entry": np.arange(4 * n + 3 + last), **elastic,
                }  # fmt: skip
                index = np.r_[0 : 4 * n, 4 * n + 3 * t : 4 * n + 3 * t + 3, len(sd) - last : len(sd)]
                out.append((own, index, PACKAGES[package](problem)))
        return out

    def points(parts: list[tuple[np.ndarray, np.ndarray, Any]], z: np.ndarray, size: int) -> np.ndarray:
        out = np.empty((size, 3))
        for own, index, function in parts:
            out[own] = 1e3 * function((sd * z)[index]).T
        return out

    mine, start = maker(at), time.process_time()
    best = [np.inf, np.zeros(len(sd))]

    def residuals(z: np.ndarray) -> np.ndarray:
        if time.process_time() - start > PATIENCE:
            raise _OutOfTime
        p = points(mine, z, len(at))
        targets = located(fitted, p, trim=np.inf)
        parts = [
            (r / fitted.noise[own, None]).ravel() for own, r in residuals_of(fitted, p, targets, "calibrate")
        ]
        out = np.concatenate([*parts, [value for _, _, value in certified(fitted, targets)], z])
        if out @ out < best[0]:
            best[:] = out @ out, z.copy()
        return out

    with suppress(_OutOfTime):
        least_squares(residuals, np.zeros(len(sd)), method="lm", xtol=1e-6, ftol=1e-6)
    return points(maker(every), best[1], len(every))


def screws(given: dict[str, Any]) -> np.ndarray:
    """Positions (N, 3), mm, by the screw axes that robotkinecal fits to points in F0.

    The instrument stands where the nominal arm fits best: the screws absorb the difference.
    """
    from roboticstoolbox import PoERevolute, PoERobot
    from robotkinecal import SerialRobotKineCal
    from spatialmath import SE3

    session = of(given["said"], given["measurements"], "")
    fitted, at = session.only("calibrate")
    pose, links = SE3(np.array(given["base"])), []
    for alpha, a, _, d in given["rows"]:
        pose = pose * SE3.Rx(alpha) * SE3.Tx(a) * SE3.Tz(d)
        links.append(PoERevolute(pose.R[:, 2], pose.t))
    robot = PoERobot(list(links), pose * SE3(*given["centres"][given["tool"][0]]))
    calibration, q = SerialRobotKineCal(robot), np.array(given["q"])
    # the toolbox counts base and end effector as links
    calibration.joint_screw_axis = [s for s in calibration.joint_screw_axis if np.any(s)]
    calibration.N_JOINTS = len(links)

    def points() -> np.ndarray:
        return np.array([1e3 * calibration.forward_kinematics(len(links) + 1, one).t for one in q])

    nominal = points()[at]
    (target,) = located(fitted, nominal, trim=np.inf).values()
    read = 1e-3 * (fitted.xyz @ target["rotation"].T + target["origin"])
    calibration.set_observations(list(q[at]), list(read))
    calibration.solve()
    return points()


def boosting(given: dict[str, Any]) -> np.ndarray:
    """Predictions (N, k) of residuals (C, k)."""
    from sklearn.ensemble import GradientBoostingRegressor

    x, y, new = (np.array(given[key]) for key in ("x", "y", "new"))
    models = [GradientBoostingRegressor(random_state=0).fit(x, y[:, k]) for k in range(y.shape[1])]
    return np.column_stack([m.predict(new) for m in models])


if __name__ == "__main__":
    package, source, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    asked = json.loads(source.read_text(encoding="utf-8"))
    own = {"boosting": boosting, "robotkinecal": screws}
    found = own[package](asked) if package in own else chain(package, asked)
    out.write_text(json.dumps(found.tolist()), encoding="utf-8")
