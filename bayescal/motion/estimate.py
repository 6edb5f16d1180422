"""The estimate of a log: bodies, rotors, friction, offsets, times, and the noise, by linear fits in turn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.assess.findings import FAR
from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, SERVO, TRACKING
from bayescal.motion import terms
from bayescal.motion.controller import with_controller, with_torques
from bayescal.motion.fit_settings import SERVOS
from bayescal.motion.linear import Fit, Further, Table, fitted, normal, tabulated
from bayescal.motion.noise import Noise, noise_of, white_noise
from bayescal.motion.settings import NOISE, SIGNALS
from bayescal.motion.signals import Bands, Signals, all_signals, each
from bayescal.motion.terms import FORM, Column, Operating, channel


def contradicted(names: Sequence[str]) -> list[str]:
    """A sentence on parameters (their names) that are far from what is stated, if there are any."""
    text = f"more than {FAR:.0f} prior standard deviations from nominal, which pulls the estimate"
    correct = "correct what dataset.yaml and the robot file state, or its u"
    return [f"{', '.join(names)}: {text}; {correct}"] if names else []


@dataclass(frozen=True)
class Estimate:
    """What the motions of role `calibrate` tell of the baseline, and the noise about it."""

    parts: tuple[Signals, ...]
    model: Operating
    moved: dict[str, float]  # deviations of `model` from nominal, by the names of terms
    rms: np.ndarray  # (n,) N m, of the measured torques
    noise: Noise

    @property
    def limits(self) -> tuple[str, ...]:
        """What limits the log, as sentences."""
        first, words = self.parts[0], list[str]()
        log, stuck = first.log, first.stuck
        if log.torque_kind == SERVO:
            return log.limits
        if first.band < SIGNALS.band:
            words.append(f"accelerations are noise above {first.band:.1f} Hz: what is faster is not assessed")
        if first.wider > 1.0:
            words.append(f"noise counts as {first.wider:.2g} times as large for what they have below")
        if any(np.any(s.unsure > SIGNALS.blurred) for s in self.parts):
            words.append("rows about reversals are left out where speeds are noise")
        said = list(log.limits)
        if words:
            said.append("; ".join((*words, "log positions with more digits, or at a higher rate")))
        if stuck is not None:
            share = 1.0 - float(np.mean(np.concatenate([s.free for s in self.parts])))
            wider = f"noise counts as {NOISE.stuck:g} times as large for it"
            strong = f", with those about reversals; {wider}" if stuck else ""
            held = f"stiction holds joints at rest: {share:.0%} of their rows are left out{strong}"
            said.append(held.replace("%", " %"))
        return tuple(said)

    def columns(self, s: Signals) -> Iterable[Column]:
        """Columns of the baseline, linearised at the estimate."""
        return terms.baseline(s, self.model, self.rms)

    def residual(self, s: Signals) -> np.ndarray:
        """Residuals (N, C) of which a linear fit of all columns finds the deviations from nominal."""
        return terms.from_nominal(s, self.model, self.columns(s), self.moved)

    def fit(self, further: Further | None = None) -> Fit:
        """The baseline fitted to the motions of role `calibrate`, and to a further measurement."""
        p = normal(self.table(), self.noise)
        return fitted(p if further is None else further.beside(p), np.arange(len(p.terms)))

    def table(self) -> Table:
        """The columns of the baseline in the motions of role `calibrate`."""
        return tabulated(of_role(self.parts, CALIBRATE), self.columns, self.residual)

    def relinearised(self, fit: Fit) -> Estimate:
        """The same, linearised at a fit."""
        start = terms.nominal(self.parts[0].log, self.rms)
        moved = {name: value for name, value in fit.values.items() if not name.startswith(FORM)}
        return replace(self, model=start.moved(moved), moved=moved)


def of_role(parts: Sequence[Signals], role: str) -> tuple[Signals, ...]:
    """Motions of a role."""
    return tuple(s for s in parts if s.role == role)


def noise_about(table: Table, fit: Fit) -> Noise:
    """The noise of what a fit leaves of the residuals of a table's motions.

    Of servos repeats do not tell it, which have the same stops. What a model of strong stiction lacks is
    noise too, of servos that of any friction. No servo moves as exactly as its stiffness says.
    """
    parts = [part.signals for part in table.parts]
    log = parts[0].log
    servo = log.torque_kind == SERVO
    same = () if servo else tuple(s.same_as for s in parts)
    weights = [part.weight for part in table.parts]
    noise = noise_of(table.residuals(fit.values), fit.followed(table), same, weights)
    if TRACKING in log.kinds:
        assert log.controller.stiffness is not None
        rms = np.sqrt(np.mean(np.concatenate([s.torque**2 for s in parts]), axis=0))
        first, least = channel(log, TRACKING, 0), np.zeros_like(noise.sd)
        least[first : first + log.n] = NOISE.tracking * rms / log.controller.stiffness
        sd = np.where(noise.sd > 0.0, noise.sd, np.inf)  # of a joint that never moves it is not known
        noise = noise.wider(np.maximum(least / sd, 1.0))
    stuck = parts[0].stuck
    lacking = SERVOS.noise if servo and stuck is not None else NOISE.stuck if servo or stuck else 1.0
    return noise.wider(parts[0].wider * lacking)


def estimate_of(log: Log) -> Estimate:
    """Estimate the baseline and its noise in the widest band in which a log tells of its accelerations.

    Where they are noise in the narrowest too, that of torques counts as larger.

    Raises
    ------
    BayescalError
        If there are no torques with a sign.
    """
    log = with_torques(log)
    bands, whole = Bands.of(log.divided), log.divided
    if log.torque_kind == SERVO:
        out = _of_servos(log, bands)
        return _alike(out) if log.controller.stated else out
    while True:
        out = estimated(all_signals(log, bands))
        share = bands.share(whole, out.noise.sd[: log.n])
        if share <= SIGNALS.small:
            return out
        if bands.rows <= SIGNALS.narrow:
            wider = (share / SIGNALS.small) ** SIGNALS.unsure
            return estimated(tuple(s.changed(wider=wider) for s in out.parts))
        bands = bands.narrower(share)


def _of_servos(log: Log, bands: Bands) -> Estimate:
    """Of servos: with friction as stated, or, where that is contradicted, with one that holds joints."""
    out, m = estimated(all_signals(log, bands)), log.mechanism
    if not m.transition or out.moved["transition"] > -SERVOS.sudden * m.u.transition:
        return out
    note = "friction holds the joints: the log contradicts `friction_transition_degps`"
    log = replace(log, mechanism=replace(m, transition=0.0), notes=(*log.notes, note))
    return estimated(all_signals(log, bands))


def _alike(of: Estimate) -> Estimate:
    """The estimate with servos whose stiffness is as uncertain as those of the log differ."""
    n, fit, log = of.parts[0].log.n, of.fit(), of.parts[0].log
    value, u = (terms.by_joint(x, n, "constant") for x in (fit.values, fit.u))
    log = replace(log, u_constant=spread_of_servos(value, u))
    return replace(of, parts=tuple(s.changed(log=log) for s in of.parts))


def spread_of_servos(value: np.ndarray, u: np.ndarray) -> float:
    """Relative standard uncertainty of a stiffness, by the deviations (n,) of all from what is stated.

    The one that differs most is left out: it is to be found, not believed.
    """
    others = np.sort(np.abs(value[u < SERVOS.determined * SERVOS.gain]))[:-1]
    if len(others) < SERVOS.few:
        return SERVOS.gain
    return float(np.clip(np.sqrt(np.mean(others**2)), SERVOS.least, SERVOS.gain))


def estimated(parts: tuple[Signals, ...]) -> Estimate:
    """Estimate the baseline and its noise."""
    parts = with_controller(parts)
    used = of_role(parts, CALIBRATE)
    log = parts[0].log
    rms = np.sqrt(np.mean(np.concatenate([s.torque**2 for s in used]), axis=0))
    start = terms.nominal(log, rms)
    first = np.sqrt(np.mean(np.concatenate([terms.residuals(s, start) for s in each(used)]) ** 2, axis=0))
    out = Estimate(parts, start, {}, rms, white_noise(np.r_[rms, first[log.n :]]))
    for k in range(SERVOS.rounds if log.torque_kind == SERVO else NOISE.rounds):
        table = out.table()
        moves = [k for k, term in enumerate(table.terms) if not term.name.startswith(FORM)]
        fit = fitted(normal(table, out.noise), moves)
        noise = noise_about(table, fit)
        settled = np.allclose(noise.sd, out.noise.sd, rtol=SERVOS.settled)
        model = start.moved(fit.values)
        if k == NOISE.held and log.torque_kind != SERVO:
            stuck = _stuck(used, model, noise)
            parts = tuple(s.changed(stuck=stuck) for s in parts)
        if log.torque_kind == SERVO and k >= SERVOS.measured:
            parts = tuple(model.simulated(s) for s in each(parts))
        out = Estimate(parts, model, fit.values, rms, noise)
        if log.torque_kind == SERVO and settled and k > SERVOS.measured:
            return out
    if log.torque_kind != SERVO:
        return out
    log = replace(log, notes=(*log.notes, f"the estimate has not settled in {SERVOS.rounds} rounds"))
    return replace(out, parts=tuple(s.changed(log=log) for s in out.parts))


def _stuck(parts: Sequence[Signals], model: Operating, noise: Noise) -> float | None:
    """Time about rest in which stiction holds joints, s, or None: by the torques of joints at rest."""
    square, count = 0.0, 0
    for s in each(parts):
        rests, n = s.rests, s.log.n
        sd = noise.sd[:n] / NOISE.stuck  # it is wider where stiction is strong
        rests &= sd > 0.0  # of a joint that never moves it is not known
        off = s.kept(terms.residuals(s, model)[:, :n]) / np.maximum(sd, 1e-300)
        square += float(np.sum(off[rests] ** 2))
        count += int(np.sum(rests))
    some, strong = NOISE.stiction
    chance = 1.0 + NOISE.sure * np.sqrt(2.0 * NOISE.correlated / max(count, 1))
    if count < NOISE.few or square < count * max(some, chance):
        return None
    return SIGNALS.stuck if square > count * strong else 0.0
