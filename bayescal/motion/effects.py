"""The list of effects of joint logs: what may be wrong with a model of torques, as columns.

An effect is one entry of `EFFECTS`. It yields its forms: a `Form` for each site and setting, with its
columns. An effect is named by the best of its forms, averaged over all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from bayescal.logs import Log
from bayescal.logs.mechanism import inertial
from bayescal.logs.types import SERVO
from bayescal.motion.ripple import Waves
from bayescal.motion.settings import FORMS
from bayescal.motion.signals import Signals, derivative
from bayescal.motion.terms import ALL, BODY, LINK, TRACKING, UNITS, Operating, Term, channel, kinds, of_body

TOOL, BASE, LOG = "tool", "base", "log"
OF_THE_ARM = (
    *("payload", "payload-offset", "armature", "stribeck", "load-friction", "asymmetric-friction"),
    *("viscous-temperature", "base-tilt", "inertia"),
)
"""Effects that are torques of the arm; others are errors of their measurement, or do not move an arm much."""
NO_TORQUE = "no torques are logged"
STICKS = "it is alike to the stiction of a servo: log second encoders"
UNSEEN = "motor torques do not show it below the bandwidth of the drives: log second encoders"


@dataclass(frozen=True)
class Form:
    """One way in which an effect, or an unknown one, acts: where, by which quantity, with which setting."""

    effect: str
    site: str
    driver: str
    setting: str = ""

    def term(self, unit: str, sd: float, channel: int = ALL, part: str = "") -> Term:
        """A term of this form."""
        name = " ".join(x for x in (self.effect, self.site, self.driver, self.setting, part) if x)
        return Term(name, unit, sd, channel, self.effect in OF_THE_ARM)


FormColumn = tuple[Form, Term, np.ndarray]


@dataclass(frozen=True)
class Scale:
    """Sizes of a log on which priors of effects depend."""

    torque: np.ndarray  # (n,) N m, RMS
    friction: np.ndarray  # (n,) N m, of the estimate
    loaded: float  # kg, mean payload of the loaded motions; 0 without
    waves: Waves = field(default_factory=Waves)  # that a scan found


@dataclass(frozen=True)
class Effect:
    """An effect of the list."""

    name: str
    forms: Callable[[Signals, Operating, Scale], Iterator[FormColumn]]
    title: str  # in reports
    remedy: str  # what to do about it
    needs: Callable[[Log], str] = field(default=lambda log: "")  # why it is not assessed; "" where it is
    positive: bool = False
    of_servo: str = ""  # why it is not assessed by the errors of servos alone

    def lacks(self, log: Log) -> str:
        """Why it is not assessed in a log; "" where it is."""
        return (self.of_servo if log.torque_kind == SERVO else "") or self.needs(log)


def joint(j: int) -> str:
    """The site of a joint, numbered from 0."""
    return f"joint {j + 1}"


def _payload(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    form, m = Form("payload", TOOL, "mass"), s.log.mechanism
    unit = inertial(1.0, m.payload_centre, m.payload_gyration**2 * np.eye(3))
    on = (s.payload > 0.0)[:, None]
    yield form, form.term("kg", FORMS.payload * scale.loaded), (s.rigid[:, :, -1] @ unit) * on


def _payload_offset(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    form, m = Form("payload-offset", TOOL, "centre of mass"), s.log.mechanism
    none = np.zeros((3, 3))
    for axis, step in zip("xyz", FORMS.offset * np.eye(3), strict=True):
        both = inertial(1.0, m.payload_centre + step, none) - inertial(1.0, m.payload_centre - step, none)
        column = (s.rigid[:, :, -1] @ (both / (2.0 * FORMS.offset))) * s.payload[:, None]
        yield form, form.term("m", FORMS.offset, part=axis), column


def _armature(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    for j in range(s.log.n):
        form = Form("armature", joint(j), "acceleration")
        sd = FORMS.armature * max(at.armature[j], scale.torque[j] / FORMS.acceleration)
        yield form, form.term("kg m2", sd, j), s.ddq[:, j]


def _stribeck(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    way = at.reversal(s)
    for j in range(s.log.n):
        for speed in FORMS.stribeck_speeds:
            for power in FORMS.stribeck_powers:
                form = Form("stribeck", joint(j), "low speed", f"{speed:g} rad/s, power {power:g}")
                bump = np.exp(-np.power(np.abs(s.dq[:, j]) / speed, power))
                yield form, form.term("N m", FORMS.stribeck * scale.friction[j], j), way[:, j] * bump


def _load_friction(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    way, load = at.reversal(s), at.load(s)
    for j in range(s.log.n):
        form = Form("load-friction", joint(j), "torque times direction")
        yield form, form.term("1", FORMS.load_friction, j), way[:, j] * np.abs(load[:, j])
        form = Form("load-friction", joint(j), "torque times direction", "square of the torque")
        square = load[:, j] ** 2 / scale.torque[j]
        yield form, form.term("1", FORMS.load_friction, j), way[:, j] * square


def _asymmetric(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    for j in range(s.log.n):
        form = Form("asymmetric-friction", joint(j), "abs speed")
        sd = FORMS.asymmetric * max(at.viscous[j], 0.5 * scale.friction[j])
        fast = np.abs(s.dq[:, j])
        yield form, form.term("N m s/rad", sd, j), fast
        form = Form("asymmetric-friction", joint(j), "abs speed", "that saturates")
        yield form, form.term("N m s/rad", sd, j), fast / (1.0 + fast / FORMS.saturation)


def _ripple(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    for j, waves in scale.waves.steady:
        for harmonics in FORMS.harmonics:
            setting = f"{waves:.4g} waves a turn" + (", with the double" if len(harmonics) > 1 else "")
            form = Form("ripple", joint(j), "motor angle", setting)
            for h in harmonics:
                for part, function in (("sin", np.sin), ("cos", np.cos)):
                    term = form.term("N m", FORMS.ripple * scale.friction[j] / h, j, f"{part} {h}")
                    yield form, term, function(h * waves * s.q[:, j])


def _torque_constant(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    torque = at.torque(s)
    for j in range(s.log.n):
        form = Form("torque-constant", joint(j), "torque")
        yield form, form.term("1", FORMS.constant, j), torque[:, j]
        form = Form("torque-constant", joint(j), "torque", "that falls with the torque")
        large = torque[:, j] * np.abs(torque[:, j]) / scale.torque[j]
        yield form, form.term("1", FORMS.constant, j), large


def _torque_drift(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    torque = at.torque(s)
    for w in warming(s):
        for j in range(s.log.n):
            form = Form("torque-drift", joint(j), w.driver, w.setting)
            yield form, form.term(f"N m{w.per}", FORMS.drift * scale.torque[j] / w.usual, j), w.rise
            form = Form("torque-drift", joint(j), f"{w.driver} times torque", w.setting)
            yield form, form.term(f"1{w.per}", FORMS.drift / w.usual, j), w.rise * torque[:, j]


def _viscous_temperature(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    for w in warming(s):
        for j in range(s.log.n):
            size = max(abs(at.viscous[j]), 0.5 * scale.friction[j])
            form = Form("viscous-temperature", joint(j), f"speed times {w.driver}", w.setting)
            term = form.term(f"N m s/rad{w.per}", FORMS.viscous_temperature * size / w.usual, j)
            yield form, term, w.rise * s.dq[:, j]


@dataclass(frozen=True)
class Warming:
    """How warm the arm is: `rise` (N,), of which `usual` is a usual size."""

    driver: str
    setting: str
    rise: np.ndarray
    usual: float
    per: str


def warming(s: Signals) -> Iterator[Warming]:
    """Rises of the temperature, K, as measured, and by the time: what warms is seldom where the sensor is."""
    if s.temperature is not None:
        yield Warming("temperature", "", s.temperature, FORMS.kelvin, "/K")
    first, last = s.log.motions[0].time[0], s.log.motions[-1].time[-1]
    for share in FORMS.warm_up:
        constant = share * (last - first)
        yield Warming("time", f"{constant:.0f} s", -np.expm1(-s.time / constant), 1.0, "")


def _delay(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    later = -derivative(at.measured(s), s.step)
    form = Form("delay", LOG, "rate of torque")
    yield form, form.term("s", FORMS.delay), later
    form = Form("delay", LOG, "rate of torque", "one per joint")
    for j in range(s.log.n):
        yield form, form.term("s", FORMS.delay, j, joint(j)), later[:, j]


def _base_tilt(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    form, m = Form("base-tilt", BASE, "gravity direction"), s.log.mechanism
    load = inertial(1.0, m.payload_centre, np.zeros((3, 3)))
    for k, name in enumerate("xy"):
        turned = np.cross(np.eye(3)[k], s.log.gravity)
        by = np.einsum("a,anjkp->njkp", turned, s.tilted)
        column = np.einsum("njkp,kp->nj", by, at.inertials) + by[:, :, -1] @ load * s.payload[:, None]
        yield form, form.term("rad", FORMS.tilt, part=name), column


def _inertia(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    m = s.log.mechanism
    for k in range(m.n):
        form = Form("inertia", joint(k), "motion of the link")
        by, sd = of_body(m, k)
        columns = s.rigid[:, :, k] @ by
        for p, name in enumerate(BODY):
            if sd[p] > 0.0:
                yield form, form.term(UNITS[p], FORMS.inertia * sd[p], part=name), columns[:, :, p]


def _servo_stiffness(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    torque, load, stiffness = at.torque(s), at.load(s), s.log.controller.stiffness
    assert stiffness is not None
    for j in range(s.log.n):
        form = Form("servo-stiffness", joint(j), "torque")
        if s.log.torque_kind == SERVO:
            yield form, form.term("1", FORMS.servo, j), load[:, j]
        else:
            softer = torque[:, j] / stiffness[j]
            yield form, form.term("1", FORMS.servo, channel(s.log, TRACKING, j)), softer
    if s.log.torque_kind == SERVO:
        return
    form = Form("servo-stiffness", LOG, "torque", "one per joint")
    for j in range(s.log.n):
        term = form.term("1", FORMS.servo, channel(s.log, TRACKING, j), joint(j))
        yield form, term, torque[:, j] / stiffness[j]


def _elasticity(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    load = at.load(s)
    for j in range(s.log.n):
        form = Form("elasticity", joint(j), "torque")
        sd = FORMS.deflection / scale.torque[j]
        yield form, form.term("rad/(N m)", sd, channel(s.log, LINK, j)), -load[:, j]


def _backlash(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    load, way = at.load(s), at.reversal(s)
    for j in range(s.log.n):
        form = Form("backlash", joint(j), "side of the torque")
        side = np.tanh(load[:, j] / (FORMS.side * scale.torque[j]))
        yield form, form.term("rad", FORMS.deflection, channel(s.log, LINK, j)), -side
        form = Form("backlash", joint(j), "direction of motion")
        yield form, form.term("rad", FORMS.deflection, channel(s.log, LINK, j)), -way[:, j]


def _without(kind: str, why: str) -> Callable[[Log], str]:
    """Why an effect is not assessed in logs without a kind of residuals."""
    return lambda log: "" if kind in kinds(log) else why


def _no_stiffness(log: Log) -> str:
    stated = log.torque_kind == SERVO and log.controller.stated
    none = "no position servo with a stated stiffness and commands"
    return "" if stated or TRACKING in kinds(log) else none


def _no_loads(log: Log) -> str:
    return "" if any(m.loaded for m in log.motions) else "no motion carries a payload"


EFFECTS: dict[str, Effect] = {
    e.name: e
    for e in (
        Effect(
            "payload", _payload, "error of the payload's mass", "Weigh it, or state what was found.",
            _no_loads,
        ),
        Effect(
            "payload-offset", _payload_offset, "error of the payload's centre of mass",
            "Measure where it is, or state what was found.", _no_loads,
        ),
        Effect("armature", _armature, "error of the rotor's inertia", "Use what was found.", positive=True),
        Effect("stribeck", _stribeck, "friction that rises at low speed", "Use it in slow motions."),
        Effect("load-friction", _load_friction, "friction that grows with load", "Use it.", positive=True),
        Effect("asymmetric-friction", _asymmetric, "viscous friction that differs by direction", "Use it."),
        Effect("ripple", _ripple, "torque that ripples with the motor angle", "Use it, or inspect the gear."),
        Effect(
            "torque-constant", _torque_constant, "error of the torque constant",
            "Use the ratio that was found.", of_servo=NO_TORQUE,
        ),
        Effect(
            "torque-drift", _torque_drift, "torque that drifts with temperature", "Warm up before a log.",
            of_servo=NO_TORQUE,
        ),
        Effect(
            "viscous-temperature", _viscous_temperature, "viscous friction that falls as the arm warms",
            "Warm up before a log.",
        ),
        Effect(
            "delay", _delay, "delay of the torque", "Shift the stamps by it.",
            of_servo="a delay of the commands is alike to viscous friction: both are in the lag of the servo",
        ),
        Effect("base-tilt", _base_tilt, "tilt of the base", "Level the base, or state its tilt."),
        Effect("inertia", _inertia, "error of the link's inertia", "Use what was found."),
        Effect(
            "servo-stiffness", _servo_stiffness, "another stiffness of the servo", "Use what was found.",
            _no_stiffness,
        ),
        Effect("elasticity", _elasticity, "elastic gear", "Use it.", _without(LINK, UNSEEN), True),
        Effect("backlash", _backlash, "backlash", "Adjust the gear.", _without(LINK, UNSEEN), True, STICKS),
    )
}  # fmt: skip


def columns(s: Signals, at: Operating, scale: Scale) -> Iterator[FormColumn]:
    """Columns of every effect that a log can tell of."""
    for effect in EFFECTS.values():
        if not effect.lacks(s.log):
            yield from effect.forms(s, at, scale)
