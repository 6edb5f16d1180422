"""The calibration of a log: inertias, rotors, friction, offsets and times with their uncertainty.

The posterior of the linear model is normal; physics restricts it. A body has a positive mass and a pseudo
inertia matrix that is positive definite, which is a convex set of the parameters in which torques are linear
(Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018); rotors and friction are not negative. The normal posterior
is sampled within this set, so that every draw, and their mean, is an arm that could be built.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from bayescal.logs import Log, Mechanism
from bayescal.logs.mechanism import symmetric
from bayescal.logs.types import CALIBRATE, SERVO, VALIDATE
from bayescal.motion.estimate import Estimate, estimated, moved_to, of_role
from bayescal.motion.linear import Fit, tabulated
from bayescal.motion.servo import with_torques
from bayescal.motion.settings import CALIBRATION, OUTCOME
from bayescal.motion.signals import Signals, all_signals, each
from bayescal.motion.terms import BODY, Operating, nominal, of_body
from bayescal.storage.stopping import Progress, silent

NOT_NEGATIVE = ("armature", "coulomb", "viscous")


@dataclass(frozen=True)
class Parameter:
    """A parameter of the arm, SI: nominal value, estimate, standard uncertainty, 95 % interval, prior."""

    name: str
    unit: str
    nominal: float
    estimate: float
    u: float
    interval95: tuple[float, float]
    prior_sd: float

    @property
    def identifiable(self) -> str:
        """How far the log determines it, by the uncertainty over the prior's."""
        share = self.u / self.prior_sd
        return "yes" if share < CALIBRATION.determined else "weakly" if share < CALIBRATION.weakly else "no"


@dataclass(frozen=True)
class Withheld:
    """Torque error of one joint on moving rows of validation motions, N m RMS."""

    joint: str
    nominal: float
    fitted: float
    expected: float  # by noise and the uncertainty of the parameters
    interval95: tuple[float, float]  # of the latter


@dataclass(frozen=True)
class MotionFit:
    """A calibration from a joint log."""

    log: Log
    parameters: tuple[Parameter, ...]
    draws: np.ndarray  # (chains, draws, K) of the parameters
    withheld: tuple[Withheld, ...]
    determined: int  # directions in which the log tells more than the prior
    combinations: tuple[str, ...]  # what is determined only together
    mechanism: Mechanism  # with the estimate
    shift: float  # s, of the torques
    lag1: np.ndarray  # (n,)
    seed: int


def calibrate(log: Log, samples: int, seed: int, progress: Progress = silent) -> MotionFit:
    """Calibrate an arm from a joint log.

    Parameters
    ----------
    log : Log
    samples : int
        Draws of the posterior, in four chains.
    seed : int

    Raises
    ------
    BayescalError
        If there are no torques with a sign.
    """
    log = with_torques(log)
    progress("estimate", 0.0)
    estimate = estimated(all_signals(log))
    fit = estimate.fit()
    start = nominal(log, estimate.rms)
    names = [t.name for t in fit.normal.terms]
    base = np.array([_nominal(name, start, log.mechanism) for name in names])
    sd = np.array([t.sd for t in fit.normal.terms])
    progress("sample", 0.3)
    count = max(samples, CALIBRATION.fewest) // CALIBRATION.chains
    z = _draws(fit, Possible.of(fit, start, log), count, seed)
    values = base + z * sd
    flat = values.reshape(-1, len(names))
    mean = flat.mean(axis=0)
    low, high = np.quantile(flat, (0.025, 0.975), axis=0)
    rows = zip(fit.normal.terms, base, mean, flat.std(axis=0), low, high, strict=True)
    shown = tuple(Parameter(t.name, t.unit, b, m, u, (lo, hi), t.sd) for t, b, m, u, lo, hi in rows)
    progress("withheld", 0.8)
    deviations = dict(zip(names, (mean - base).tolist(), strict=True))
    at = moved_to(start, estimate.parts[0], deviations)
    return MotionFit(
        log=log,
        parameters=shown,
        draws=values,
        withheld=_withheld(estimate, fit, start, at),
        determined=int(np.sum(np.linalg.eigvalsh(fit.covariance) < CALIBRATION.determined**2)),
        combinations=_combinations(fit, names),
        mechanism=fitted_mechanism(log.mechanism, at, log.torque_kind == SERVO),
        shift=float(at.shift[0]),
        lag1=estimate.noise.lag1[: log.n],
        seed=seed,
    )


def _nominal(name: str, start: Operating, m: Mechanism) -> float:
    """Nominal value of a parameter."""
    stem, _, number = name.rpartition(" ")
    if stem.endswith(" of link"):
        k, part = int(number) - 1, stem.removesuffix(" of link")
        inertia = m.inertia[k]
        values = [
            m.mass[k],
            *m.centre[k],
            *(inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
        ]
        return float(values[BODY.index(part)])
    each = {"armature": start.armature, "coulomb": start.coulomb, "viscous": start.viscous}
    if stem in each:
        return float(each[stem][int(number) - 1])
    return float(start.shift[0]) if name == "alignment" else 0.0


@dataclass(frozen=True)
class Possible:
    """The set of deviations (K,), in prior standard deviations, of arms that could be built."""

    pseudo: np.ndarray  # (n, 4, 4) of the nominal bodies
    by: np.ndarray  # (n, 4, 4, K)
    least: np.ndarray  # (K,) of rotors and friction, -inf of others

    @classmethod
    def of(cls, fit: Fit, start: Operating, log: Log) -> Possible:
        """The set of a fit."""
        n, terms = log.n, [fit.normal.terms[k] for k in fit.chosen]
        number = {t.name: k for k, t in enumerate(terms)}
        by, least = np.zeros((n, 4, 4, len(terms))), np.full(len(terms), -np.inf)
        for k in range(n):
            slopes = of_body(log.mechanism, k)[0]
            for p, name in enumerate(BODY):
                for term in (f"{name} of link {k + 1}", f"inertia joint {k + 1} motion of the link {name}"):
                    if (column := number.get(term)) is not None:
                        size = terms[column].sd * fit.scales[column]
                        by[k, :, :, column] = pseudo_inertia(slopes[:, p]) * size
            for stem in NOT_NEGATIVE:
                column = number[f"{stem} {k + 1}"]
                least[column] = -getattr(start, stem)[k] / terms[column].sd
        return cls(np.array([pseudo_inertia(ten) for ten in start.inertials]), by, least)

    def __call__(self, z: np.ndarray) -> bool:
        """Whether an arm with these deviations could be built."""
        if np.any(z < self.least):
            return False
        return bool(np.all(np.linalg.eigvalsh(self.pseudo + self.by @ z) > 0.0))


def pseudo_inertia(ten: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) of a body's linear parameters, positive definite if there is such a body."""
    about = symmetric(ten[4:])
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(about) * np.eye(3) - about
    out[:3, 3] = out[3, :3] = ten[1:4]
    out[3, 3] = ten[0]
    return out


def _draws(fit: Fit, possible: Possible, count: int, seed: int) -> np.ndarray:
    """Draws (chains, count, K) of a normal posterior within a set that holds z = 0.

    Elliptical slices (Murray, Adams and MacKay, AISTATS 2010): each step draws an ellipse of the normal
    distribution through the point, and shrinks it to an arc within the set.
    """
    rng = np.random.default_rng(seed)
    mean, size = fit.z, len(fit.z)
    out = np.empty((CALIBRATION.chains, count, size))
    for c in range(CALIBRATION.chains):
        point = mean if possible(mean) else _inside(mean, possible)
        for k in range(count * CALIBRATION.thin):
            step = solve_triangular(fit.factor[0].T, rng.standard_normal(size), lower=False)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            low, high = angle - 2.0 * np.pi, angle
            while True:
                new = mean + (point - mean) * np.cos(angle) + step * np.sin(angle)
                if possible(new):
                    break
                low, high = (angle, high) if angle < 0.0 else (low, angle)
                angle = rng.uniform(low, high)
            point = new
            if k % CALIBRATION.thin == 0:
                out[c, k // CALIBRATION.thin] = point
    return out


def _inside(mean: np.ndarray, possible: Possible) -> np.ndarray:
    """The point of the line from nominal to the mean that is just within the set."""
    low, high = 0.0, 1.0
    for _ in range(CALIBRATION.halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if possible(middle * mean) else (low, middle)
    return low * mean


def constrained(fit: Fit, possible: Possible) -> np.ndarray:
    """Deviations (K,) of a fit, in prior standard deviations, of an arm that could be built."""
    if possible(fit.z):
        return fit.z
    return np.asarray(_draws(fit, possible, CALIBRATION.few, 0).mean(axis=(0, 1)))


def fitted_mechanism(m: Mechanism, at: Operating, servo: bool) -> Mechanism:
    """The mechanism with estimated bodies, rotors and friction; of servos at their estimated stiffness."""
    mass = at.inertials[:, 0]
    centre = at.inertials[:, 1:4] / mass[:, None]
    about = np.array([symmetric(ten[4:]) for ten in at.inertials])
    shifted = np.array([w * (c @ c * np.eye(3) - np.outer(c, c)) for w, c in zip(mass, centre, strict=True)])
    by = at.gain if servo else 1.0
    return replace(
        m, mass=mass, centre=centre, inertia=about - shifted, armature=at.armature / by,
        coulomb=at.coulomb / by, viscous=at.viscous / by,
        transition=float(np.exp(np.mean(np.log(at.transition)))),
    )  # fmt: skip


def _withheld(estimate: Estimate, fit: Fit, start: Operating, at: Operating) -> tuple[Withheld, ...]:
    """Torque errors of validation motions, with what noise and uncertain parameters let expect."""
    parts, log = of_role(estimate.parts, VALIDATE), estimate.parts[0].log
    if not parts:
        return ()

    def rms(model: Operating, some: tuple[Signals, ...]) -> np.ndarray:
        left = [s.unfiltered(model.measured(s) - model.shown(s))[_moving(s)] for s in each(some)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)))

    before, after = rms(start, parts), rms(at, parts)
    noise = rms(at, of_role(estimate.parts, CALIBRATE))
    table = tabulated(parts, estimate.columns, estimate.residual)
    sd = np.array([t.sd for t in table.terms])
    covariance = fit.covariance * np.outer(sd, sd)
    extra = np.zeros(log.n)
    for p in table.parts:
        for j in range(log.n):
            x, chosen = p.columns[j], p.numbers[j]
            extra[j] += np.mean(np.einsum("ij,jk,ik->i", x, covariance[np.ix_(chosen, chosen)], x))
    expected = np.sqrt(noise**2 + extra / len(parts))
    # half the variance of an RMS of N correlated rows is 1 / (2 N / correlation length)
    seconds = sum(len(s.time) * s.step for s in parts)
    spread = np.sqrt(OUTCOME.block / (2.0 * seconds))
    low, high = expected * (1.0 - 1.96 * spread), expected * (1.0 + 1.96 * spread)
    rows = zip(log.mechanism.joint_names, before, after, expected, low, high, strict=True)
    return tuple(Withheld(n, b, a, e, (lo, hi)) for n, b, a, e, lo, hi in rows)


def _moving(s: Signals) -> np.ndarray:
    return np.any(np.abs(s.unfiltered(s.dq)) > OUTCOME.moving, axis=1)


def _combinations(fit: Fit, names: list[str]) -> tuple[str, ...]:
    """Sums of parameters that the log determines although it does not determine the parameters alone."""
    covariance = fit.covariance
    u = np.sqrt(np.diag(covariance))
    open_ = np.flatnonzero(u > CALIBRATION.weakly)
    values, vectors = np.linalg.eigh(covariance[np.ix_(open_, open_)])
    out: list[str] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > CALIBRATION.determined**2 or len(out) == CALIBRATION.listed:
            break
        order = np.argsort(-np.abs(vector))[: CALIBRATION.parts]
        sign = np.sign(vector[order[0]])
        parts = " ".join(f"{sign * vector[k]:+.2f} {names[open_[k]]}" for k in order)
        out.append(f"{parts} (each over its prior sd; u {np.sqrt(value):.2g} of it)")
    return tuple(out)
