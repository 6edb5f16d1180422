"""How many fits may be used: simulated sessions of all built-in robots, fitted with the default model.

    python analysis/export_study.py [--sessions 10] [--rigid 3]

Of every robot: sessions of arms with errors of geometry and compliance, and sessions of rigid arms, whose
compliances are zero. The number of contacts, the noise and the share of outliers change with the session.
Counted are fits with a good verdict, and those of them that `exporting.gate` refuses, by reason. Where a fit
has set parameters to rigid, its errors of validation distances are compared with those without the bound.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np

import bayescal as bc
from bayescal.calibration import Fit
from bayescal.errors import BayescalError
from bayescal.estimate.bounds import UNCHANGED
from bayescal.fitted import gate
from bayescal.predict.crossvalidation import inside95
from bayescal.public import SimulatedSession
from bayescal.robots import load_robot, names

CONTACTS = (80, 150, 300)
NOISE = (5e-6, 20e-6)
"""m, of a contact."""
OUTLIERS = (0.0, 0.02)
SPHERES = {"mecademic-meca500": 0}
"""Of a small arm, which does not reach around three."""
TRUTH = {"elastic": "geometry, compliance", "rigid": "geometry"}


@dataclass
class Counts:
    """Results of the sessions of one kind."""

    fits: int = 0
    good: int = 0  # verdict
    allowed: int = 0  # of these
    at_bound: int = 0  # of all
    reasons: Counter[str] = field(default_factory=Counter)
    errors: list[tuple[float, float]] = field(default_factory=list)  # m, with and without the bound
    inside: list[tuple[bool, bool]] = field(default_factory=list)


def weighed(robot: str) -> bool:
    """Whether masses are known, so that a compliance can be fitted."""
    return load_robot(robot)[0].masses is not None


def simulated(robot: str, truth: str, seed: int) -> SimulatedSession:
    """A session; its size, noise and outliers follow from the seed."""
    effects = TRUTH[truth] if weighed(robot) else "geometry"
    return bc.simulate(
        robot, effects, seed=seed, contacts=CONTACTS[seed % 3], noise=NOISE[seed % 2],
        outliers=OUTLIERS[seed // 2 % 2], later=30, repeats=8, spheres=SPHERES.get(robot, 3), placements=2,
    )  # fmt: skip


def distances(fit: Fit) -> tuple[list[float], list[bool]]:
    """Errors of validation distances, m, and whether they are in their intervals."""
    each = fit.final.validation.distances
    return [d.error for d in each], [bool(inside95(d.error, d.predicted)) for d in each]


def count(into: Counts, session: SimulatedSession) -> str:
    """Fit a session and add its result; return a line about it."""
    model = "geometry, compliance" if session.dataset.robot.masses is not None else "geometry"
    found = bc.fit(session, model, samples=0).data
    use = gate.of_fit(found)
    into.fits += 1
    if found.acceptance.usable:
        into.good += 1
        into.allowed += use.allowed
    if found.acceptance.explains:
        into.reasons.update(reason.partition(":")[0] for reason in use.against)
    if found.rigid.parameters:
        into.at_bound += 1
        with patch("bayescal.calibration.bounded", lambda free: (free, UNCHANGED)):
            free = bc.fit(session, model, samples=0).data
        with_, without = distances(found), distances(free)
        into.errors += zip(with_[0], without[0], strict=True)
        into.inside += zip(with_[1], without[1], strict=True)
    return f"{found.acceptance.verdict}: {'; '.join(use.remarks) or 'allowed'}"


def main() -> None:
    """Run the study and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=10, help="of each robot, of elastic arms")
    parser.add_argument("--rigid", type=int, default=3, help="of each robot, of rigid arms")
    asked = parser.parse_args()
    results = {truth: Counts() for truth in TRUTH}
    for truth, sessions in zip(TRUTH, (asked.sessions, asked.rigid), strict=True):
        for robot in names():
            if truth == "rigid" and not weighed(robot):
                continue
            for seed in range(sessions):
                try:
                    line = count(results[truth], simulated(robot, truth, seed))
                except BayescalError as error:
                    line = f"no session or no fit: {error}"
                print(truth, robot, seed, line, flush=True)
    for truth, r in results.items():
        print(f"{truth} arms: {r.fits} fits, {r.good} with a good verdict, {r.allowed} of these allowed, "
              f"{r.at_bound} with a parameter at its bound")  # fmt: skip
        for reason, often in r.reasons.most_common():
            print(f"  {often} x {reason}")
        if r.errors:
            rms = 1e6 * np.sqrt(np.mean(np.square(r.errors), axis=0))
            share = 100 * np.mean(r.inside, axis=0)
            each = (f"RMS error {e:.1f} µm, {s:.0f} % within 95 %" for e, s in zip(rms, share, strict=True))
            print(f"  {len(r.errors)} distances of fits at a bound: {'; without it: '.join(each)}")


if __name__ == "__main__":
    main()
