"""The calibration of a log: inertias, rotors, friction, offsets and times with their uncertainty.

The posterior of mass, centre and inertia of each body is normal about its mode, where torques are linearised
in them; physics restricts it. A body has a positive mass and a positive definite pseudo inertia matrix
(Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018): about its centre a convex set of mass and inertia. Rotors
and friction are not negative. The normal posterior is sampled within this set (`possible`), so that every
draw, and their mean, is an arm that could be built.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.logs import Log, Mechanism
from bayescal.logs.types import CALIBRATE, SERVO, VALIDATE
from bayescal.motion.estimate import Estimate, estimate_of, of_role
from bayescal.motion.expected import expected_of
from bayescal.motion.fit_settings import CALIBRATION
from bayescal.motion.linear import Fit, tabulated
from bayescal.motion.possible import NOT_NEGATIVE, Possible, draws_within, spread
from bayescal.motion.signals import Signals, each, root_mean_square, where_moving
from bayescal.motion.terms import BODY, Operating, nominal
from bayescal.storage.stopping import Progress, silent


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
    """Torque error of one joint, N m RMS, on rows of validation motions that stiction does not hold."""

    joint: str
    nominal: float
    fitted: float
    expected: float  # by noise and the uncertainty of the parameters
    interval95: tuple[float, float]  # of the latter


@dataclass(frozen=True)
class MotionFit:
    """A calibration from a joint log."""

    log: Log
    limits: tuple[str, ...]  # of the log, as sentences
    parameters: tuple[Parameter, ...]
    draws: np.ndarray  # (chains, draws, K) of the parameters
    withheld: tuple[Withheld, ...]
    determined: int  # directions in which the log tells more than the prior
    combinations: tuple[str, ...]  # what is determined only together
    mechanism: Mechanism  # with the estimate
    shift: float  # s, of the torques
    lag1: np.ndarray  # (n,)
    seed: int
    r_hat: float  # of the draws


def calibrate(log: Log, samples: int, seed: int, progress: Progress = silent) -> MotionFit:
    """Calibrate an arm from a joint log; see `calibrated`.

    Raises
    ------
    BayescalError
        If there are no torques with a sign.
    """
    progress("estimate", 0.0)
    estimate = estimate_of(log)
    return calibrated(estimate, estimate.fit(), samples, seed, progress)


def calibrated(
    estimate: Estimate, fit: Fit, samples: int, seed: int, progress: Progress = silent
) -> MotionFit:
    """The calibration of an estimate and its linear fit.

    Parameters
    ----------
    estimate : Estimate
    fit : Fit
        Of all its terms.
    samples : int
        Draws of the posterior, in four chains.
    seed : int
    """
    log = estimate.parts[0].log
    start = nominal(log, estimate.rms)
    names = fit.names
    stated = nominal_values(start)
    base = np.array([stated.get(name, 0.0) for name in names])
    possible = Possible.of(fit, start, log)
    progress("sample", 0.3)
    count = max(samples, CALIBRATION.fewest) // CALIBRATION.chains
    z = draws_within(fit, possible, count, seed)
    if (r_hat := spread(z)) > CALIBRATION.r_hat:
        z = draws_within(fit, possible, count, seed, CALIBRATION.further * CALIBRATION.steps)
        r_hat = spread(z)
    deviations = dict(zip(names, (z.mean(axis=(0, 1)) * fit.sd).tolist(), strict=True))
    values, base, units, sd = _speeds(base + z * fit.sd, base, fit, start)
    flat = values.reshape(-1, len(names))
    low, high = np.quantile(flat, (0.025, 0.975), axis=0)
    rows = zip(names, units, base, flat.mean(axis=0), flat.std(axis=0), low, high, sd, strict=True)
    shown = tuple(Parameter(n, unit, b, m, u, (lo, hi), s) for n, unit, b, m, u, lo, hi, s in rows)
    progress("withheld", 0.8)
    model = start.moved(deviations)
    return MotionFit(
        log=log,
        limits=estimate.limits,
        parameters=shown,
        draws=values,
        withheld=_withheld(estimate, fit, start, model),
        determined=int(np.sum(np.linalg.eigvalsh(fit.covariance) < CALIBRATION.determined**2)),
        combinations=_combinations(fit, names),
        mechanism=model.mechanism(log.mechanism, log.torque_kind == SERVO),
        shift=float(model.shift[0]),
        lag1=estimate.noise.lag1[: log.n],
        seed=seed,
        r_hat=r_hat,
    )


def _speeds(
    values: np.ndarray, base: np.ndarray, fit: Fit, start: Operating
) -> tuple[np.ndarray, np.ndarray, list[str], np.ndarray]:
    """Draws (chains, S, K), nominal values (K,), units and prior sds (K,) with transitions as speeds, rad/s.

    The fit has the logarithms of their ratios to the nominal ones: of all joints, and of each beside.
    """
    values, base, sd, names = values.copy(), base.copy(), fit.sd.copy(), fit.names
    units = [t.unit for t in fit.normal.terms]
    every = names.index("transition") if "transition" in names else None
    common = 0.0 if every is None else values[..., every].copy()
    for k, name in enumerate(names):
        stem, _, joint = name.partition(" ")
        if stem == "transition":
            nominal_speed = float(start.transition[int(joint or 1) - 1])
            beside = values[..., k] if joint else 0.0
            sd[k] = nominal_speed * np.hypot(fit.sd[k], fit.sd[every] if joint and every is not None else 0.0)
            values[..., k] = nominal_speed * np.exp(common + beside)
            base[k], units[k] = nominal_speed, "rad/s"
    return values, base, units, sd


def nominal_values(start: Operating) -> dict[str, float]:
    """Nominal values of parameters, by name; those of others are 0."""
    joints = range(len(start.bodies))
    out = {f"{part} of link {k + 1}": start.bodies[k, p] for k in joints for p, part in enumerate(BODY)}
    out |= {f"{stem} {k + 1}": getattr(start, stem)[k] for stem in NOT_NEGATIVE for k in joints}
    return out | {"alignment": start.shift[0]}


def _withheld(estimate: Estimate, fit: Fit, start: Operating, final: Operating) -> tuple[Withheld, ...]:
    """Torque errors of validation motions, with what noise and uncertain parameters let expect.

    Of the rows that a fit uses: with any torque stiction holds a joint in the others.
    """
    parts, log = of_role(estimate.parts, VALIDATE), estimate.parts[0].log
    if not parts:
        return ()

    def off(model: Operating, role: str) -> Iterator[tuple[Signals, np.ndarray]]:
        some = each(of_role(estimate.parts, role))
        errors = ((s, s.unfiltered(model.measured(s) - model.shown(s))) for s in some)
        return ((s, np.where(s.unfiltered(s.free) > 0.0, x, np.nan)) for s, x in errors)

    def rms(model: Operating) -> np.ndarray:
        return root_mean_square(where_moving(x, s) for s, x in off(model, VALIDATE))

    held = tabulated(parts, estimate.columns, estimate.residual)
    e = expected_of(final, off(final, CALIBRATE), held, fit)
    rows = zip(log.mechanism.joint_names, rms(start), rms(final), e.rms, *e.interval95, strict=True)
    return tuple(Withheld(n, b, a, x, (low, high)) for n, b, a, x, low, high in rows)


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
