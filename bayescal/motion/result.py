"""The result of a diagnosis of a joint log as frozen records, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.motion.effects import Form
from bayescal.motion.estimate import Estimate
from bayescal.motion.named import NamedArm
from bayescal.motion.settings import OUTCOME
from bayescal.motion.verdict import Verdict


@dataclass(frozen=True)
class Place:
    """Where an effect, or an unknown cause, acts, and its part of the torque residuals."""

    form: Form
    nats: float  # that the leading set loses without it; of others, gain over noise only
    kind: str  # of the residuals in which it is shown, see `bayescal.motion.terms`
    rms: float  # N m or rad, by which it changes what is left of calibration motions, in its largest joint
    joint: int  # of that, from 0
    explained_by: str  # the named effect, or ""


@dataclass(frozen=True)
class Amplitude:
    """The amplitude of a named effect at one site, SI."""

    form: Form
    value: float  # of several components the length of the vector
    u: float
    unit: str
    components: Mapping[str, tuple[float, float]]  # by name, with u; () of a single one
    relevant: bool  # whether the withheld error shrinks by `OUTCOME.relevant`
    removed: float  # share by which the withheld RMS of the joint with most shrinks


@dataclass(frozen=True)
class Course:
    """Torque residuals of the withheld motion with most error, N m, at some of its rows; NaN at rest."""

    motion: str
    time: np.ndarray  # (R,) s since the motion began
    before: np.ndarray  # (R, n)
    after: np.ndarray


@dataclass(frozen=True)
class Shrinkage:
    """RMS of the torque residuals on moving rows of validation motions, N m, by joint (n,)."""

    before: np.ndarray
    after: np.ndarray
    floor: np.ndarray  # of the noise, from calibration motions
    removed: float  # share of the excess variance, over all joints in units of the noise; nan without excess
    removed_interval95: tuple[float, float]
    gain: float  # log predictive density of the validation motions, nats, over the baseline
    course: Course


@dataclass(frozen=True)
class Tracking:
    """Errors of withheld motions that a simulator moves by the logged commands, on moving rows."""

    rms: np.ndarray  # (n,) rad, of positions
    torque: np.ndarray  # (n,) N m
    blocks: np.ndarray  # (B, n) rad2, mean squares of parts of the motions
    motions: int  # that were simulated

    def removed(self, before: Tracking) -> tuple[float, tuple[float, float]]:
        """Share of the mean square of all joints that an arm has less than another, and its 95 % interval."""
        first, last = before.blocks.sum(axis=1), self.blocks.sum(axis=1)
        picked = np.random.default_rng(0).integers(0, len(first), (OUTCOME.draws, len(first)))
        draws = 1.0 - last[picked].sum(axis=1) / first[picked].sum(axis=1)
        low, high = np.quantile(draws, (0.025, 0.975))
        return float(1.0 - last.sum() / first.sum()), (float(low), float(high))


@dataclass(frozen=True)
class MotionGap:
    """A diagnosis of a joint log."""

    estimate: Estimate
    verdict: Verdict
    where: tuple[Place, ...]
    amplitudes: tuple[Amplitude, ...]
    shrinkage: Shrinkage
    hypotheses: tuple[tuple[tuple[str, ...], float, float], ...]  # effects, probability, nats; best first
    not_assessed: Mapping[str, str]  # by effect, why
    advice: tuple[str, ...]
    values: Mapping[str, float]  # of all terms of the model with the names
    u: Mapping[str, float]
    warnings: tuple[str, ...]
    model: NamedArm  # without effects
    arm: NamedArm  # with the named ones
    tracking: Mapping[str, Tracking] | str = ""  # of arms nominal, model, effects; or why there is none
