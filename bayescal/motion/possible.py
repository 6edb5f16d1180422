"""Arms that could be built: a convex set of parameters, and draws of a normal distribution within it.

The arm with the named effects: what a mechanism can hold is in it, the others are torques beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from bayescal.arm.transforms import compiled
from bayescal.logs import Log, Mechanism
from bayescal.logs.types import CALIBRATE, LINK, SERVO, TRACKING, inertial, with_bodies
from bayescal.motion.dynamics import inertial_of, payload_of
from bayescal.motion.effects import AS_LINK, BODY_ON_IT, DENSE, EFFECTS, ELSEWHERE, EVERY, POINT, Scale
from bayescal.motion.estimate import Estimate
from bayescal.motion.fit_settings import CALIBRATION
from bayescal.motion.linear import Fit
from bayescal.motion.signals import Signals, each
from bayescal.motion.terms import ALL, BODY, Column, Operating, Term, by_joint, nominal
from bayescal.robots.schema import SIX

NOT_NEGATIVE = ("armature", "coulomb", "viscous")
SHRUNK = 40
"""Times that an arc is shrunk at most; its length is then below the resolution of numbers."""
_jit = compiled()


@dataclass(frozen=True)
class Possible:
    """The set of deviations (K,), in prior standard deviations, of arms that could be built."""

    pseudo: np.ndarray  # (n, 4, 4) of the nominal bodies, about their centres; any of links without mass
    by: np.ndarray  # (n, 4, 4, K)
    least: np.ndarray  # (K,) of rotors and friction, -inf of others

    @classmethod
    def of(cls, fit: Fit, start: Operating, log: Log) -> Possible:
        """The set of a fit."""
        n, sd, number = log.n, fit.sd, {name: k for k, name in enumerate(fit.names)}
        by, least = np.zeros((n, 4, 4, len(sd))), np.full(len(sd), -np.inf)
        for k in range(n):
            for p, name in enumerate(BODY):
                unit = ABOUT * np.eye(len(BODY))[p]
                for term in (f"{name} of link {k + 1}", *(f"{stem} {name}" for stem in stems(k, n))):
                    if (column := number.get(term)) is not None:
                        by[k, :, :, column] = pseudo_inertia(unit) * sd[column]
            away = np.eye(4)
            away[:3, 3] = -start.bodies[k, 1:4]
            for term, unit in added(log.mechanism, k, start.bodies[k]).items():
                if (column := number.get(term)) is not None:
                    by[k, :, :, column] = away @ pseudo_inertia(unit) @ away.T * sd[column]
            for stem in NOT_NEGATIVE:
                column = number[f"{stem} {k + 1}"]
                least[column] = -getattr(start, stem)[k] / sd[column]
        bodies = [pseudo_inertia(ABOUT * body) if body[0] > 0.0 else np.eye(4) for body in start.bodies]
        return cls(np.array(bodies), by, least)

    def __call__(self, z: np.ndarray) -> bool:
        """Whether an arm with these deviations could be built."""
        return bool(_allowed(self.pseudo + self.by @ z, (z - self.least)[np.isfinite(self.least)]))


ABOUT = np.r_[1.0, np.zeros(3), np.ones(6)]
"""Parameters of a body as `BODY` times these are linear ones about its centre."""


def pseudo_inertia(by: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) of linear parameters (10,) of a body, positive definite if there is such a body."""
    about = by[4 + SIX]
    out = np.zeros((4, 4))
    out[:3, :3] = 0.5 * np.trace(about) * np.eye(3) - about
    out[:3, 3] = out[3, :3] = by[1:4]
    out[3, 3] = by[0]
    return out


@_jit
def _allowed(bodies, over):
    """Whether matrices (n, 4, 4) are positive definite, by Cholesky, and values (M,) not negative."""
    for x in over:
        if x < 0.0:
            return False
    factor = np.empty((4, 4))
    for body in bodies:
        for i in range(4):
            for j in range(i + 1):
                x = body[i, j]
                for k in range(j):
                    x -= factor[i, k] * factor[j, k]
                if i > j:
                    factor[i, j] = x / factor[j, j]
                elif x > 0.0:
                    factor[i, i] = math.sqrt(x)
                else:
                    return False
    return True


@_jit
def _mixed(out, c, x, d, y):
    """Put c x + d y in `out`, all (N,): as a loop, which is compiled in half the time."""
    for k in range(len(out)):
        out[k] = c * x[k] + d * y[k]


@_jit
def _slices(away, middle, bodies, over, steps, bodies_by, over_by, chances):
    """Elliptical slices from `away` (K,) of the mean; each of `steps` (S, K) draws one, put in its place.

    The limits are linear: `middle` (16 n,) and (M,) at the mean, `bodies`, `over` by `away`, and
    `bodies_by`, `over_by` by the steps. `chances` (S, `SHRUNK`) are uniform.
    """
    new, least, there = np.empty_like(bodies), np.empty_like(over), np.empty_like(away)
    changed, margin = np.empty_like(bodies), np.empty_like(over)
    for s in range(len(steps)):
        angle = 2.0 * math.pi * chances[s, 0]
        low, high = angle - 2.0 * math.pi, angle
        for t in range(1, SHRUNK):
            c, d = math.cos(angle), math.sin(angle)
            _mixed(new, c, bodies, d, bodies_by[s])
            _mixed(least, c, over, d, over_by[s])
            _mixed(changed, 1.0, middle[0], 1.0, new)
            _mixed(margin, 1.0, middle[1], 1.0, least)
            if _allowed(changed.reshape(-1, 4, 4), margin):
                _mixed(there, c, away, d, steps[s])
                bodies[:], over[:], away[:] = new, least, there
                break
            if angle < 0.0:
                low = angle
            else:
                high = angle
            angle = low + (high - low) * chances[s, t]
        steps[s] = away
    return away


def draws_within(fit: Fit, possible: Possible, count: int, seed: int, total: int | None = None) -> np.ndarray:
    """Draws (chains, count, K) of the posterior of a fit within a set that holds z = 0.

    Elliptical slices (Murray, Adams and MacKay, AISTATS 2010): each step draws an ellipse of the normal
    distribution through the point, and shrinks it to an arc within the set. A chain begins on the line from
    nominal to the mean; its first `CALIBRATION.burned` steps are left out. There are `total` others in all
    chains, `CALIBRATION.steps` by default.
    """
    rng, mean, size = np.random.default_rng(seed), fit.z, len(fit.z)
    limited = np.flatnonzero(np.isfinite(possible.least))
    flat = possible.by.reshape(-1, size).T
    middle = np.ravel(possible.pseudo + possible.by @ mean), (mean - possible.least)[limited]
    total = CALIBRATION.steps if total is None else total
    thin = max(total // (CALIBRATION.chains * count), CALIBRATION.least_thin)
    out = np.empty((CALIBRATION.chains, count, size))
    for c in range(CALIBRATION.chains):
        away = (mean if possible(mean) else _inside(mean, possible)) - mean
        filled = -max(CALIBRATION.burned // thin, 1)
        while filled < count:
            rows = min(max(CALIBRATION.at_once // thin, 1), count - filled)
            normal = rng.standard_normal((rows * thin, size))
            steps = np.ascontiguousarray(solve_triangular(fit.factor[0], normal.T, trans="T", lower=True).T)
            bodies = steps @ flat
            chances = rng.uniform(size=(len(steps), SHRUNK))
            start = np.ravel(possible.by @ away), away[limited]
            over = np.ascontiguousarray(steps[:, limited])
            away = _slices(away, middle, *start, steps, bodies, over, chances)
            kept = steps[thin - 1 :: thin]
            first, filled = filled, filled + rows
            if filled > 0:
                out[c, max(first, 0) : filled] = mean + kept[max(-first, 0) :]
    return out


def constrained(fit: Fit, possible: Possible) -> np.ndarray:
    """Deviations (K,) of a fit, in prior standard deviations, of an arm that could be built."""
    if possible(fit.z):
        return fit.z
    return np.asarray(draws_within(fit, possible, CALIBRATION.few, 0, CALIBRATION.for_mean).mean(axis=(0, 1)))


def _inside(mean: np.ndarray, possible: Possible) -> np.ndarray:
    """The point of the line from nominal to the mean that is just within the set."""
    low, high = 0.0, 1.0
    for _ in range(CALIBRATION.halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if possible(middle * mean) else (low, middle)
    return low * mean


def spread(draws: np.ndarray) -> float:
    """Largest R-hat of draws (chains, S, K): Gelman and Rubin, Statist. Sci. 7(4), 1992, of half chains."""
    chains, count, size = draws.shape
    halves = draws[:, : count // 2 * 2].reshape(2 * chains, count // 2, size)
    within, between = halves.var(axis=1, ddof=1).mean(axis=0), halves.mean(axis=1).var(axis=0, ddof=1)
    return float(np.sqrt(np.max(1.0 + between / within)))


OF_TOOL = f"payload tool {EVERY}"
HELD = ("armature ", "inertia ", "base-tilt ", OF_TOOL)
"""How terms of effects begin that masses, rotors and the direction of gravity express."""


def stems(k: int, n: int) -> tuple[str, ...]:
    """How terms begin that are errors of a link, from 0."""
    last = (f"{OF_TOOL} {AS_LINK}",) if k + 1 == n else ()
    return f"inertia joint {k + 1} motion of the link", *last


def added(m: Mechanism, k: int, body: np.ndarray) -> dict[str, np.ndarray]:
    """By term what one unit of it adds to the parameters (10,) of a link, as `inertial_of`."""
    unit = np.eye(len(BODY))
    out, points = {}, {f"{stem} {BODY_ON_IT}": unit[0] for stem in stems(k, m.n)}
    if body[0] > 0.0:
        out = {f"{stem} {DENSE}": inertial_of(body) / body[0] for stem in stems(k, m.n)}
    if k + 1 == m.n:
        out[OF_TOOL] = points[f"{OF_TOOL} {ELSEWHERE}"] = payload_of(m)
    for stem, mass in points.items():
        out |= {f"{stem} {part}": x for part, x in zip(POINT, (mass, *unit[1:4]), strict=True)}
    return out


def with_body(body: np.ndarray, more: np.ndarray) -> np.ndarray:
    """A link (10,) as `BODY` with what is added to its linear parameters."""
    whole = inertial_of(body) + more
    centre = whole[1:4] / whole[0] if whole[0] else body[1:4]
    about = inertial(whole[0], centre, np.zeros((3, 3)))
    return np.r_[whole[0], centre, whole[4:] - about[4:]]


@dataclass(frozen=True)
class NamedArm:
    """An arm that could be built, and the values of all terms of the model, SI, in which it is."""

    estimate: Estimate
    scale: Scale
    mechanism: Mechanism
    gravity: np.ndarray  # (3,) m/s2
    values: Mapping[str, float]

    @property
    def gain(self) -> np.ndarray:
        """Shown torques over true ones (n,)."""
        return 1.0 + by_joint(self.values, self.mechanism.n, "constant")

    @property
    def offset(self) -> np.ndarray:
        """Of the shown torques (n,), N m."""
        return by_joint(self.values, self.mechanism.n, "offset")

    def further(self, s: Signals) -> tuple[np.ndarray, np.ndarray]:
        """Torques (N, n), N m, that act on the joints of a motion beside the mechanism, and of the drives.

        Errors of a measurement do not act. An error of tracking is a torque of the drives, by the stiffness;
        so is an offset of torques that follow from positions.
        """
        log, acts, drives = s.log, np.zeros_like(s.q), np.zeros_like(s.q)
        tracked = TRACKING in log.kinds
        if tracked:
            baseline = (c for c in self.estimate.columns(s) if c[0].name.startswith(TRACKING))
            drives -= sum(self._torque(s, *c) for c in baseline)
        for name in sorted(self.effects):
            for term, column in self._columns(s, name):
                if term.name.startswith(HELD):
                    continue
                if kind_of(log, term) == TRACKING or name == "servo-stiffness":
                    drives -= self._torque(s, term, column)
                elif term.moves:
                    acts -= self._torque(s, term, column)
        return acts, drives if tracked else drives - self.offset

    @property
    def effects(self) -> set[str]:
        """Names of the effects of the list."""
        return {effect_of(term) for term in self.values} - {""}

    def sizes(self) -> dict[str, tuple[str, np.ndarray]]:
        """Unit and RMS (n,) of each effect in the fitted motions: N m, or rad behind the gears."""
        out, parts = {}, [s for s in self.estimate.parts if s.role == CALIBRATE]
        listed = [name for name in sorted(self.effects) if next(self._columns(parts[0], name), None)]
        for name in listed:
            sums = (sum(self._torque(s, *c) for c in self._columns(s, name)) for s in each(parts))
            total = [np.mean(x**2, axis=0) for x in sums]
            first = next(self._columns(parts[0], name))[0]
            unit = "rad" if kind_of(parts[0].log, first) == LINK else "N m"
            out[name] = unit, np.sqrt(np.mean(total, axis=0))
        return out

    def _columns(self, s: Signals, effect: str) -> Iterator[Column]:
        """Terms of an effect, with their columns."""
        forms = EFFECTS[effect].forms(s, self.estimate.model, self.scale)
        return ((term, column) for _, term, column in forms if term.name in self.values)

    def _torque(self, s: Signals, term: Term, column: np.ndarray) -> np.ndarray:
        """Torque (N, n) of a term, of tracking by the stiffness; of a link its angle."""
        value = self.values[term.name] * column
        if term.channel == ALL:
            return value
        j, out = term.channel % s.log.n, np.zeros_like(s.q)
        stiffness = s.log.controller.stiffness if kind_of(s.log, term) == TRACKING else None
        out[:, j] = value if stiffness is None else value * stiffness[j]
        return out


def kind_of(log: Log, term: Term) -> str:
    """The kind of residuals of a term."""
    return log.kinds[0 if term.channel == ALL else term.channel // log.n]


def effect_of(term: str) -> str:
    """The effect whose form has a term of this name; "" of the baseline."""
    first, _, suffix = term.partition(" ")
    return first if first in EFFECTS and not suffix[:1].isdigit() and " of link " not in term else ""


def named_arm(estimate: Estimate, fit: Fit, scale: Scale) -> NamedArm:
    """The arm of a fit of the baseline with named effects."""
    log = estimate.parts[0].log
    start, m = nominal(log, estimate.rms), log.mechanism
    z = constrained(fit, Possible.of(fit, start, log)) * fit.sd
    values = dict(zip(fit.names, z.tolist(), strict=True))
    model = start.moved(values)
    bodies, armature, gravity = model.bodies.copy(), model.armature.copy(), log.gravity.copy()
    for k in range(m.n):
        for stem in stems(k, m.n):
            bodies[k] += [values.get(f"{stem} {name}", 0.0) for name in BODY]
        more = (values.get(term, 0.0) * unit for term, unit in added(m, k, model.bodies[k]).items())
        bodies[k] = with_body(bodies[k], sum(more, np.zeros(len(BODY))))
        armature[k] = max(armature[k] + values.get(f"armature joint {k + 1} acceleration", 0.0), 0.0)
    for axis, name in zip(np.eye(3), "xy", strict=False):
        tilt = values.get(f"base-tilt base gravity direction {name}", 0.0)
        gravity = gravity + tilt * np.cross(axis, log.gravity)
    model = replace(model, bodies=bodies, armature=armature)
    mechanism, _ = with_bodies(model.mechanism(m, log.torque_kind == SERVO))
    return NamedArm(estimate, scale, mechanism, gravity, values)
