"""One session: an arm fitted to it, targets compensated by it, and where the true arm puts them.

The true arm is that of `analysis.world`, which shares no code with the model: Pinocchio's chain and gravity,
hidden effects in forms of machines. Distances between targets are compared, since the frame of the base of an
arm that is calibrated on loosely placed artefacts is its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from analysis.world.build import Made, make
from analysis.world.mix import FIRST_OF, recipe
from bayescal.calibration import fit
from bayescal.compensating.solve import compensated
from bayescal.dataset import read_dataset
from bayescal.fitted.arm import FittedArm, of_fit, refitted
from bayescal.programs.text import Corrected, Target
from bayescal.programs.tools import nominal_arm

GENERATOR = 3
"""Version of the simulator: contacts on a cube and on spheres."""
COUNT = 60
"""Targets of a session."""
MOVED = np.radians(4.0)
"""rad: a target is a row of the session, its readings changed by up to this; so none was ever visited."""
SLOW = 1e-9
"""Speed on arrival over that of the session: its signs remain, and no reading is late."""
DRAWS = 400
NOT_OF_A_POSE = ("step", "lobing", "latency", "plane-form", "artefact", "thermal-drift")
"""Effects that move no pose of the arm, or depend on the time; sessions with these are left out."""


@dataclass(frozen=True)
class Level:
    """Errors of distances between targets, m, of an arm with some effects: as measured and as predicted."""

    effects: tuple[str, ...]
    targets: int
    nominal: np.ndarray  # (D,) at nominal readings
    left: np.ndarray  # (D,) at compensated readings
    sd: np.ndarray  # (D,) predicted
    maximum: np.ndarray  # (2,) median and 95 % quantile of the predicted maximum


@dataclass(frozen=True)
class Session:
    """A session of the simulator: its number, what is hidden, and the levels of models fitted to it."""

    number: int
    hidden: tuple[str, ...]
    levels: tuple[Level, ...]


def stands(made: Made, session: np.ndarray, rows: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """Where the true arm puts its tool (C, 3), m, at readings (C, n) in place of those of `rows` (C,).

    Direction of approach, payload and history are those of the rows; `session` (N, n) has all readings.
    """
    s = made.world.session
    own = replace(s, speed=SLOW * s.speed)
    world = replace(made.world, session=own)
    every = session.copy()
    every[rows] = readings
    return world.seen(every, made.acts)[0].ball[rows]


def targets_of(arm: FittedArm, seed: int, count: int = COUNT) -> tuple[np.ndarray, list[Target]]:
    """Rows of the session (C,), and nominal joint targets beside them, approached and loaded as these."""
    m, rng = arm.dataset.measurements, np.random.default_rng(seed)
    rows = rng.choice(len(m.ids), count, replace=False)
    readings = m.readings[rows] + rng.uniform(-MOVED, MOVED, (count, arm.dataset.robot.n))
    assert m.velocity is not None
    payload = np.zeros(count) if m.payload is None else m.payload[rows]
    return rows, [
        Target(m.ids[row], readings=readings[k], velocity=m.velocity[row], payload=float(payload[k]))
        for k, row in enumerate(rows)
    ]


def measured(made: Made, arm: FittedArm, seed: int) -> Level:
    """Distance errors of compensated targets on the true arm, and what the fit predicts for them."""
    rows, targets = targets_of(arm, seed)
    found = compensated(arm, targets)
    good = [k for k, own in enumerate(found) if not own.reason and own.inside]
    session = arm.dataset.measurements.readings
    own = [found[k] for k in good]
    nominal = nominal_arm(arm, arm.dataset.tools[0])
    before = np.array([f.nominal for f in own])
    goals = nominal.ball(nominal.frames(before))
    after = np.array([f.readings for f in own])
    at = [stands(made, session, rows[good], q) for q in (before, after)]
    one, other = np.triu_indices(len(own), 1)
    apart = goals[one] - goals[other]
    length = np.linalg.norm(apart, axis=1)
    errors = [np.linalg.norm(p[one] - p[other], axis=1) - length for p in at]
    by = _slopes(arm, own, [targets[k] for k in good])
    along = apart / length[:, None]
    slopes = np.einsum("dk,dkp->dp", along, by[one] - by[other])
    sd = np.sqrt(np.einsum("dp,pq,dq->d", slopes, arm.covariance, slopes, optimize=True))
    root = np.linalg.cholesky(arm.covariance + 1e-30 * np.eye(len(arm.covariance)))
    drawn = slopes @ root @ np.random.default_rng(0).standard_normal((len(root), DRAWS))
    most = np.quantile(np.abs(drawn).max(axis=0), [0.5, 0.95])
    return Level(arm.effects, len(own), errors[0], errors[1], sd, most)


def _slopes(arm: FittedArm, found: Sequence[Corrected], targets: Sequence[Target]) -> np.ndarray:
    """Slopes of the TCP positions by the arm's parameters, (C, 3, P)."""
    readings = np.array([f.readings for f in found])
    way, payload = np.array([t.velocity for t in targets]), np.array([t.payload for t in targets])
    return arm.at(readings, direction=way, payload_kg=payload).by_parameters


def session(seed: int, number: int) -> Session | None:
    """A session with its usual model, and with the hidden effects named; None if one of them is left out."""
    kind, makers = recipe(seed, number, GENERATOR)
    hidden = [FIRST_OF.get(maker, maker).__name__.replace("_", "-") for maker in makers]
    if kind == "outside" or set(hidden) & set(NOT_OF_A_POSE):
        return None
    made = make(seed, number, generator=GENERATOR)
    hidden = tuple(made.truth["effects"])
    with TemporaryDirectory() as folder:
        for name, text in made.texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        dataset = read_dataset(Path(folder))
    baseline = tuple(made.truth["baseline"])
    arm = of_fit(fit(dataset, baseline, samples=0))
    levels = [measured(made, arm, number)]
    further = [name for name in hidden if name not in baseline]
    if further:
        levels.append(measured(made, refitted(arm, further), number))
    return Session(number, hidden, tuple(levels))
