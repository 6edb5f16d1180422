"""A session of contacts and a joint log of one arm, fitted together: they share the masses of its links.

Given the masses and first moments p (4n) of the links, the two measurements are independent. With all other
parameters of the session integrated out (`discrepancy.informed`), it tells of p by an information and a
score; these are added to the normal equations of the log, whose torques are linear in p. Then p is the joint
estimate. The session is fitted again with masses of this value, at which the other parameters have their
joint estimate too, and so on until p does not move: both models are then linearised at it. By the inversion
of a block matrix, the joint covariance of p and of the session's parameters is that of `Stated`, with the
joint covariance of p in place of the prior of masses. The prior of p counts once: that of the log.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from bayescal import calibration
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.calibration import Fit
from bayescal.dataset import Dataset
from bayescal.effects.compliance import COMPLIANCE
from bayescal.errors import BayescalError
from bayescal.estimate import fitted_level
from bayescal.estimate.discrepancy import informed
from bayescal.logs import Log, Mechanism
from bayescal.model import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.motion.calibrate import MotionFit, calibrated
from bayescal.motion.dynamics import turns
from bayescal.motion.estimate import Estimate, estimate_of
from bayescal.motion.fit_settings import TOGETHER
from bayescal.motion.linear import Fit as Linear
from bayescal.motion.linear import Further
from bayescal.motion.terms import BODY, prior_of_body, slopes_of
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from bayescal.posterior.checkpoint import Checkpoint

SHARED = BODY[:4]
"""Parameters of a body that gravity acts by."""


@dataclass(frozen=True)
class Shared:
    """A parameter, SI: its estimate and u by one measurement alone, and by both."""

    name: str
    unit: str
    source: str  # session or log: which has it as a parameter
    alone: tuple[float, float]
    both: tuple[float, float]


@dataclass(frozen=True)
class Together:
    """A session and a log that were fitted together."""

    contacts: Fit
    log: MotionFit
    shared: tuple[Shared, ...]
    chi2: float  # of the difference of the masses by the log alone and by both
    dof: int  # directions in which the session tells of the masses
    rounds: int


@dataclass(frozen=True)
class Bodies:
    """Masses and first moments (n, 4) of the links in the frames of a log, and what leads from there."""

    mechanism: Mechanism
    turn: np.ndarray  # (n, 3, 3) from the log's frame of each link to that of the session's robot
    shift: np.ndarray  # (n, 3) m

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of the log."""
        return tuple(f"{part} of link {k + 1}" for k in range(self.mechanism.n) for part in SHARED)

    @property
    def nominal(self) -> np.ndarray:
        """Nominal masses and first moments, (n, 4)."""
        return self.mechanism.inertials[:, :4]

    def of(self, deviations: np.ndarray) -> np.ndarray:
        """Masses and first moments (n, 4) at deviations (4n,) of the parameters from nominal."""
        m, away = self.mechanism, deviations.reshape(-1, len(SHARED))
        mass = m.mass + away[:, 0]
        return np.column_stack([mass, mass[:, None] * (m.centre + away[:, 1:])])

    def on(self, dataset: Dataset, p: np.ndarray) -> Dataset:
        """The session with links of masses and first moments `p` (n, 4)."""
        centres = np.einsum("kij,kj->ki", self.turn, p[:, 1:] / _masses(p)[:, None]) + self.shift
        return replace(dataset, robot=replace(dataset.robot, masses=p[:, 0], centres_of_mass=centres))

    def to_session(self, p: np.ndarray) -> np.ndarray:
        """Slopes (4n, 4n) of relative masses and centres, m, in the session's frames, by `p` about `p`."""
        parts = np.zeros((len(p), 4, 4))
        mass = _masses(p)
        parts[:, 0, 0] = 1.0 / mass
        parts[:, 1:, 0] = -np.einsum("kij,kj->ki", self.turn, p[:, 1:]) / mass[:, None] ** 2
        parts[:, 1:, 1:] = self.turn / mass[:, None, None]
        return block_diag(*parts)


def _masses(p: np.ndarray) -> np.ndarray:
    """Masses (n,) by which moments are divided: those of links without mass are 0, whatever divides them."""
    return np.where(p[:, 0] > 0.0, p[:, 0], 1.0)


def fit_together(
    dataset: Dataset,
    log: Log,
    effects: tuple[str, ...],
    options: FitOptions = USUAL,
    *,
    without: Sequence[str] = (),
    samples: int = 5000,
    progress: Progress = silent,
    checkpoint: Checkpoint | None = None,
) -> Together:
    """Fit a session of contacts and a joint log of the same arm.

    Parameters
    ----------
    dataset, effects, options, without, samples, progress, checkpoint
        As of `bayescal.calibration.fit`.
    log : Log

    Raises
    ------
    BayescalError
        If they are of different arms, or share nothing.
    """
    bodies = same_arm(dataset, log, effects)
    progress("log", 0.0)
    estimate = estimate_of(log)
    fit = estimate.fit()
    of_log = calibrated(estimate, fit, samples, options.seed)
    progress("session", 0.0)
    alone = calibration.fit(dataset, effects, options, without=without, samples=0)
    p = _possible(bodies, np.array([fit.values.get(name, 0.0) for name in bodies.names]))
    for rounds in range(1, TOGETHER.rounds + 1):
        progress("together", (rounds - 1) / TOGETHER.rounds)
        scene = Scene(bodies.on(dataset, p), oriented=True)
        level = fitted_level(scene, effects, options.omitting(without, scene, effects))
        information, score = informed(level)
        of_session = bodies, p, information, score
        estimate = estimate.relinearised(estimate.fit(_further(estimate, *of_session)))
        further = _further(estimate, *of_session)
        both = estimate.fit(further)
        z = np.array([both.values.get(name, 0.0) for name in bodies.names])
        u = np.array([both.u.get(name, np.inf) for name in bodies.names])
        step = np.max(np.abs(np.linalg.solve(_slopes(estimate), (bodies.of(z) - p).ravel())) / u)
        p = _possible(bodies, z)
        if step < TOGETHER.still:
            break
    joint = calibrated(estimate, both, samples, options.seed)
    draws = _deviations(joint, bodies)
    p = bodies.of(np.mean(draws, axis=0))
    to = bodies.to_session(p) @ _slopes(estimate)
    final = bodies.on(dataset, p)
    robot = replace(final.robot, mass_covariance=to @ np.cov(draws.T) @ to.T)
    contacts = calibration.fit(
        replace(final, robot=robot), effects, options, without=without, samples=samples, progress=progress,
        checkpoint=checkpoint,
    )  # fmt: skip
    shared = (*_of_session(alone, contacts), *_of_log(of_log, joint, bodies.names))
    return Together(contacts, joint, shared, *_moved(fit, both, further.names), rounds)


def same_arm(dataset: Dataset, log: Log, effects: tuple[str, ...]) -> Bodies:
    """The links of a session's robot and of a log's mechanism.

    Raises
    ------
    BayescalError
        If a link is not where it is in the other, or the masses have no part in the session.
    """
    robot, m, remedy = dataset.robot, log.mechanism, "give both the same robot file"
    if COMPLIANCE.name not in effects:
        raise BayescalError("without compliance the masses have no part", "--model", "add compliance")
    if dataset.torques == "measured":
        what = "the session measures torques, in place of those of the masses"
        raise BayescalError(what, dataset.name, "fit the session and the log one by one")
    if robot.masses is None or robot.centres_of_mass is None:
        raise BayescalError("the robot states no masses", dataset.name, remedy)
    if robot.n != m.n:
        what = f"the session's arm has {robot.n} joints, that of the log {m.n}"
        raise BayescalError(what, log.name, remedy)
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (TOGETHER.poses, m.n))
    chain = chain_of(robot)
    mine = frames(chain, link_angles(robot, readings))[:, 1:-1]
    mine = mine if robot.convention == "mdh" else mine @ chain.link[1:]
    between = np.linalg.inv(mine) @ placed(m, readings)
    middle = between[0]
    off = np.linalg.norm(between[..., :3, 3] - middle[:, :3, 3], axis=2).max(axis=0)
    turned = np.linalg.norm(between[..., :3, :3] - middle[:, :3, :3], axis=(2, 3)).max(axis=0)
    wrong = np.flatnonzero((off > TOGETHER.off) | (turned > TOGETHER.turned))
    if len(wrong):
        k = int(wrong[0])
        what = f"link {k + 1} is not that of the session's robot: it moves by {1e3 * off[k]:.3g} mm "
        what += f"and {np.degrees(turned[k]):.2g} deg against it"
        raise BayescalError(f"{what}, so that the two are different arms", log.name, remedy)
    return Bodies(m, middle[:, :3, :3], middle[:, :3, 3])


def placed(m: Mechanism, readings: np.ndarray) -> np.ndarray:
    """Frames (N, n, 4, 4) of the bodies of a mechanism in its base, at readings (N, n), rad."""
    out = np.empty((*readings.shape, 4, 4))
    behind = np.tile(np.eye(4), (len(readings), 1, 1))
    for k, turn in enumerate(turns(m, readings @ m.coupling.T)):
        step = np.tile(m.place[k], (len(readings), 1, 1))
        step[:, :3, :3] = turn
        behind = out[:, k] = behind @ step
    return out


def _slopes(estimate: Estimate) -> np.ndarray:
    """Of masses and first moments by the parameters of the log, (4n, 4n)."""
    count = len(SHARED)
    return block_diag(*(slopes_of(body)[:count, :count] for body in estimate.model.bodies))


def _further(
    estimate: Estimate, bodies: Bodies, p: np.ndarray, information: np.ndarray, score: np.ndarray
) -> Further:
    """What a session that is linearised at `p` tells of the parameters, linearised at an estimate."""
    m, moved, to = bodies.mechanism, estimate.moved, bodies.to_session(p)
    z = np.array([moved.get(name, 0.0) for name in bodies.names])
    by = to @ _slopes(estimate)
    away = to @ (p - bodies.of(z)).ravel() + by @ z
    present = np.flatnonzero([prior_of_body(m, k)[: len(SHARED)] > 0.0 for k in range(m.n)])
    return Further(
        tuple(bodies.names[k] for k in present),
        (by.T @ information @ by)[np.ix_(present, present)],
        (by.T @ (score + information @ away))[present],
    )


def _possible(bodies: Bodies, deviations: np.ndarray) -> np.ndarray:
    """Masses and first moments (n, 4) at which a session can be linearised: masses are positive."""
    p = bodies.of(deviations)
    bad = p[:, 0] < TOGETHER.lightest * bodies.nominal[:, 0]
    p[bad] = bodies.nominal[bad]
    return p


def _deviations(fit: MotionFit, bodies: Bodies) -> np.ndarray:
    """Draws (S, 4n) of the deviations of the shared parameters from nominal."""
    place = {p.name: (k, p.nominal) for k, p in enumerate(fit.parameters)}
    flat = fit.draws.reshape(-1, len(fit.parameters))
    none = np.zeros(len(flat))
    columns = [flat[:, place[name][0]] - place[name][1] if name in place else none for name in bodies.names]
    return np.column_stack(columns)


def _of_session(alone: Fit, both: Fit) -> Iterator[Shared]:
    """Parameters of the session's model that are not geometry: compliances, and what else gravity acts by."""
    before, after = (_values(fit) for fit in (alone, both))
    for p in both.final.estimate.model.parameters:
        if p.effect == COMPLIANCE.name and p.name in before:
            yield Shared(p.name, p.unit, "session", before[p.name], after[p.name])


def _values(fit: Fit) -> dict[str, tuple[float, float]]:
    """Estimates and stated standard uncertainties, SI, of the arm's parameters."""
    model, z = fit.final.estimate.model, fit.final.estimate.z
    count = len(model.parameters)
    values, u = model.physical(z)[:count], fit.stated.sd[:count] * model.sd
    return {p.name: (float(v), float(s)) for p, v, s in zip(model.parameters, values, u, strict=True)}


def _of_log(alone: MotionFit, both: MotionFit, names: Sequence[str]) -> Iterator[Shared]:
    """Masses and centres of mass of the links."""
    for a, b in zip(alone.parameters, both.parameters, strict=True):
        if a.name in names:
            before, after = ((float(p.estimate), float(p.u)) for p in (a, b))
            yield Shared(a.name, a.unit, "log", before, after)


def _moved(alone: Linear, both: Linear, names: Sequence[str]) -> tuple[float, int]:
    """Chi-square of the change of the shared parameters by the session, and its degrees of freedom.

    Of a change d by further information the covariance is that before less that after. Directions of which
    the session takes little of the variance are not counted.
    """
    chosen = [alone.normal.index[name] for name in names]
    before, after = (fit.covariance[np.ix_(chosen, chosen)] for fit in (alone, both))
    root = np.linalg.cholesky(before)
    inverse = np.linalg.inv(root)
    share, vectors = np.linalg.eigh(np.eye(len(chosen)) - inverse @ after @ inverse.T)
    along = vectors.T @ inverse @ (both.vector - alone.vector)[chosen]
    kept = share > TOGETHER.least
    return float(np.sum(along[kept] ** 2 / share[kept])), int(np.sum(kept))
