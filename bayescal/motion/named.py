"""The arm with the named effects: what a mechanism can hold is in it, the rest is a torque beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayescal.logs import Log, Mechanism
from bayescal.logs.types import CALIBRATE, LINK, SERVO, TRACKING
from bayescal.motion.calibrate import fitted_mechanism
from bayescal.motion.effects import EFFECTS, Scale
from bayescal.motion.estimate import Estimate, moved_to
from bayescal.motion.linear import Fit
from bayescal.motion.possible import Possible, constrained
from bayescal.motion.signals import Signals, each
from bayescal.motion.terms import ALL, BODY, Column, Term, nominal

HELD = ("armature", "inertia", "base-tilt")
"""Effects that masses, rotors and the direction of gravity express."""


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
        return 1.0 + self._each("constant")

    @property
    def offset(self) -> np.ndarray:
        """Of the shown torques (n,), N m."""
        return self._each("offset")

    def _each(self, name: str) -> np.ndarray:
        return np.array([self.values.get(f"{name} {j + 1}", 0.0) for j in range(self.mechanism.n)])

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
        for name in self.effects - set(HELD):
            for term, column in self._columns(s, name):
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
    model = moved_to(start, estimate.parts[0], values)
    bodies, armature, gravity = model.bodies.copy(), model.armature.copy(), log.gravity.copy()
    for k in range(m.n):
        bodies[k] += [values.get(f"inertia joint {k + 1} motion of the link {name}", 0.0) for name in BODY]
        armature[k] = max(armature[k] + values.get(f"armature joint {k + 1} acceleration", 0.0), 0.0)
    for axis, name in zip(np.eye(3), "xy", strict=False):
        tilt = values.get(f"base-tilt base gravity direction {name}", 0.0)
        gravity = gravity + tilt * np.cross(axis, log.gravity)
    model = replace(model, bodies=bodies, armature=armature)
    return NamedArm(estimate, scale, fitted_mechanism(m, model, log.torque_kind == SERVO), gravity, values)
