"""Runs where the package is installed: `python -m analysis.benchmarks.package_worker NAME problem.npz`.

The chain is the package's own; faces, certificates and priors are the same few lines of NumPy that the other
peers have. Solved by SciPy's default, as in the packages' own examples. Where that takes too long, the time
of one Jacobian is scaled by the number of steps.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from analysis.benchmarks.walls import Walls, contact_residuals, place, tie_residuals

PATIENCE = 60.0  # s
STEPS = 8  # assumed where patience ends: what SciPy's default takes on this problem
Points = Callable[[np.ndarray], np.ndarray]
"""Ball centres (3, C), m, for errors (E,), SI, of the entries of a problem."""


class _OutOfTime(Exception):
    pass


def pybotics(given: dict[str, Any]) -> Points:
    """The chain of pybotics 3, through its `OptimizationHandler`."""
    from pybotics.optimization import OptimizationHandler
    from pybotics.robot import Robot

    rows, entry, q = given["rows"], given["entry"], given["q"]
    robot = Robot.from_parameters(rows)
    robot.world_frame = given["base"]
    robot.tool.position = given["tool"]
    chain_mask = np.isin(np.arange(rows.size), entry)
    tool_mask = np.isin(rows.size + np.arange(6), entry)
    handler = OptimizationHandler(robot, list(chain_mask), list(tool_mask))
    nominal = handler.generate_optimization_vector()

    def points(errors: np.ndarray) -> np.ndarray:
        handler.apply_optimization_vector(nominal + errors)
        return np.array([handler.robot.fk(one)[:3, 3] for one in q]).T

    return points


def figaroh(given: dict[str, Any]) -> Points:
    """The chain of FIGAROH 1: placement errors of the joints of a Pinocchio model, and a marker at the tool.

    The length along a joint's axis follows the joint, so that an error of a row's twist turns what a twist of
    modified Denavit-Hartenberg rows turns. With `mass` and `lever` of the links, in the frames before that
    length, there is also an elasticity of each joint, rad/(N m), behind the marker.
    """
    import pinocchio as pin
    from figaroh.calibration.calibration_tools import calc_updated_fkm

    rows, entry = given["rows"], given["entry"]
    model, parent, before = pin.Model(), 0, pin.SE3(given["base"])
    for k, (alpha, a, _, d) in enumerate(rows, start=1):
        link = pin.SE3(pin.utils.rotate("x", float(alpha)), np.array([float(a), 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRZ(), before * link, f"axis{k}")
        before = pin.SE3(np.eye(3), np.array([0.0, 0.0, float(d)]))
    model.addFrame(pin.Frame("flange", parent, 0, before, pin.FrameType.OP_FRAME))
    names = [f"{ERRORS[e % 4]}_axis{e // 4 + 1}" for e in range(rows.size)] + [f"pEE{a}_1" for a in "xyz"]
    elastic = len(rows) if "mass" in given else 0
    for k in range(1, elastic + 1):
        body = pin.Inertia(float(given["mass"][k - 1]), np.asarray(given["lever"][k - 1]), np.zeros((3, 3)))
        model.appendBodyToJoint(k, body, pin.SE3.Identity())
        model.gravity.linear = np.asarray(given["gravity"])
        names.append(f"k_RZ_axis{k}")
    nominal = np.concatenate([np.zeros(rows.size), given["tool"], np.zeros(elastic)])
    q = np.ascontiguousarray(given["q"])
    settings = {
        "calib_model": "full_params",
        "start_frame": "universe",
        "end_frame": "flange",
        "actJoint_idx": list(range(1, len(rows) + 1)),
        "param_name": names,
        "NbMarkers": 1,
        "NbSample": len(q),
        "measurability": [True, True, True, False, False, False],
        "calibration_index": 3,
        "non_geom": bool(elastic),
    }
    data = model.createData()

    def points(errors: np.ndarray) -> np.ndarray:
        values = nominal.copy()
        values[entry] += errors
        flat: np.ndarray = calc_updated_fkm(model, data, values, q, settings)
        return flat.reshape(3, len(q))

    return points


ERRORS = ("d_phix", "d_px", "d_phiz", "d_pz")
"""FIGAROH's names for errors of alpha, a, theta and d of a row."""
PACKAGES: dict[str, Callable[[dict[str, Any]], Points]] = {"pybotics": pybotics, "figaroh": figaroh}


def residual_function(package: str, given: dict[str, Any]) -> tuple[Callable[[np.ndarray], np.ndarray], int]:
    """Whitened residuals at z (entries, then faces), and the length of z."""
    walls = Walls(**{f.name: given[f.name] for f in fields(Walls)})
    points, sd = PACKAGES[package](given), given["sd_of_entry"]
    size = len(sd)

    def residuals(z: np.ndarray) -> np.ndarray:
        normal, shift = place(np, walls, z[size:].reshape(-1, 3))
        contacts = contact_residuals(np, walls, normal, shift, points(sd * z[:size]))
        return np.concatenate([contacts, tie_residuals(np, walls, normal, shift), z])

    return residuals, size + 3 * len(walls.normal)


def run(package: str, given: dict[str, Any]) -> dict[str, float]:
    """Duration of the calibration, s, its size, steps and half chi-squared, and whether it was scaled."""
    residuals, size = residual_function(package, given)
    start = time.perf_counter()
    calls = [0]

    def timed(z: np.ndarray) -> np.ndarray:
        calls[0] += 1
        if time.perf_counter() - start > PATIENCE:
            raise _OutOfTime
        return residuals(z)

    out = {"parameters": float(size)}
    try:
        found = least_squares(timed, np.zeros(size))
    except _OutOfTime:
        each = (time.perf_counter() - start) / calls[0]
        whole = each * (size + 1) * STEPS
        return out | {"seconds": whole, "steps": float(STEPS), "cost": np.nan, "scaled": 1.0}
    took = time.perf_counter() - start
    return out | {"seconds": took, "steps": float(found.nfev), "cost": float(found.cost), "scaled": 0.0}


if __name__ == "__main__":
    with np.load(sys.argv[2]) as file:
        print(json.dumps(run(sys.argv[1], dict(file))))
