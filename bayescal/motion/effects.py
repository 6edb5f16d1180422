"""The list of effects of joint logs: what may be wrong with a model of torques, as columns.

An effect is a function behind `effect`. It yields its forms: a `Form` for each site and setting, with its
columns. An effect is named by the best of its forms, averaged over all of them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product, starmap
from typing import Any

import numpy as np

from bayescal.errors import listed
from bayescal.logs import Log
from bayescal.logs.types import LINK, SERVO, TRACKING, inertial
from bayescal.motion import terms
from bayescal.motion.dynamics import carried, payload_of
from bayescal.motion.settings import FORMS
from bayescal.motion.signals import Signals, derivative
from bayescal.motion.terms import ALL, BODY, UNITS, Operating, Term, channel
from bayescal.storage.reading import table_beside

TOOL, BASE, LOG = "tool", "base", "log"
EACH = "in all joints"
"""Setting of a form that is in all joints."""
BY_HAND = "log second encoders, or hold the servo and move the link by hand: the reading does not see the gap"
UNSEEN = "motor torques do not show it below the bandwidth of the drives: log second encoders"


@dataclass(frozen=True)
class Form:
    """One way in which an effect, or an unknown one, acts: where, by which quantity, with which setting."""

    effect: str
    site: str
    driver: str
    setting: str = ""

    @property
    def of_each(self) -> bool:
        """Whether it is in all joints, each with its own value."""
        return self.setting.endswith(EACH)

    def term(self, unit: str, sd: float, channel: int = ALL, part: str = "", most: float = np.inf) -> Term:
        """A term of this form."""
        name = " ".join(x for x in (self.effect, self.site, self.driver, self.setting, part) if x)
        moves = self.effect in EFFECTS and EFFECTS[self.effect].moves
        return Term(name, unit, sd, channel, moves, most)


FormColumn = tuple[Form, Term, np.ndarray]


@dataclass(frozen=True)
class Waves:
    """Joints, from 0, and waves a turn that explain most, with the logs of their shares of all tried."""

    steady: tuple[tuple[int, float], ...] = ()  # of one phase
    spread: float = 0.0
    changing: tuple[tuple[int, float], ...] = ()  # whose phase differs from piece to piece of the motions
    changing_spread: float = 0.0
    in_proportion: tuple[tuple[int, float, str], ...] = ()  # to a response of the joint, with its name
    in_proportion_spread: float = 0.0


@dataclass(frozen=True)
class Scale:
    """Sizes of a log on which priors of effects depend."""

    torque: np.ndarray  # (n,) N m, RMS
    friction: np.ndarray  # (n,) N m, of the estimate
    loaded: float  # kg, mean payload of the loaded motions; 0 without
    waves: Waves = field(default_factory=Waves)  # that a scan found


Forms = Callable[[Signals, Operating, Scale], Iterator[FormColumn]]


@dataclass(frozen=True)
class Effect:
    """An effect of the list."""

    name: str
    forms: Forms
    title: str  # in reports
    remedy: str  # what to do about it
    needs: Callable[[Log], str] = field(default=lambda log: "")  # why it is not assessed; "" where it is
    moves: bool = False  # whether it is a torque of the arm; others are errors of its measurement
    positive: bool = False
    of_servo: str = ""  # why it is not assessed by the errors of servos alone
    at_speed: bool = False  # whether the torque of one unit is `at_speed`
    by_load: bool = False  # whether its size depends on the torque that the model has in a gear

    def lacks(self, log: Log) -> str:
        """Why it is not assessed in a log; "" where it is."""
        return (self.of_servo if log.torque_kind == SERVO else "") or self.needs(log)


EFFECTS: dict[str, Effect] = {}
"""The list, by name."""


DECLARED = table_beside(__file__, "effects.toml")
"""Further fields of each effect."""


def effect(name: str, **further: Any) -> Callable[[Forms], Forms]:
    """Put forms into the list of effects; `further` are fields of `Effect` beside those declared."""

    def listed(forms: Forms) -> Forms:
        EFFECTS[name] = Effect(name, forms, **DECLARED[name], **further)
        return forms

    return listed


def _without(kind: str, why: str) -> Callable[[Log], str]:
    """Why an effect is not assessed in logs without a kind of residuals."""
    return lambda log: "" if kind in log.kinds else why


def _no_stiffness(log: Log) -> str:
    stated = log.torque_kind == SERVO and log.controller.stated
    none = "no position servo with a stated stiffness and commands"
    return "" if stated or TRACKING in log.kinds else none


def _no_gap(log: Log) -> str:
    """A gap is crossed where the torque of a joint changes its sign, and there a servo sticks too."""
    if LINK in log.kinds or log.torque_kind != SERVO:
        return "" if LINK in log.kinds else UNSEEN
    torques = np.concatenate([m.torque for m in log.motions if m.torque is not None])
    low, high = np.quantile(torques, FORMS.one_sided, axis=0)
    one = [name for name, a in zip(log.mechanism.joint_names, low * high > 0.0, strict=True) if a]
    kept = f"; the torque of {listed(one)} keeps its sign, so that no gap is crossed there" if one else ""
    return f"it is alike to the stiction of a servo{kept}: {BY_HAND}"


def _no_loads(log: Log) -> str:
    return "" if any(m.loaded for m in log.motions) else "no motion carries a payload"


def joint(j: int) -> str:
    """The site of a joint, numbered from 0."""
    return f"joint {j + 1}"


EVERY = "mass in every motion"
"""Driver of a payload that no motion states."""
UNSTATED, OR_LINK = "mass that no motion states", ", or error of the last link"
ELSEWHERE, AS_LINK = "centre unknown", "as of the last link"
"""Settings of it: not where payloads are stated; errors of the last link, which may be of what it carries."""
DENSE, BODY_ON_IT = "in proportion", "by a body on it"
"""Settings: masses are off by one factor, of a link its inertia too; a small body is on a link."""
POINT = ("mass", "moment x", "moment y", "moment z")
"""Linear parameters of a small body: its mass and first moment."""


def _point(
    form: Form, by: np.ndarray, sd: float, extent: float, most: float = np.inf
) -> Iterator[FormColumn]:
    """Columns of a small body on a link, by its parameters `POINT`: `by` (N, n, 4)."""
    yield form, form.term("kg", sd, part=POINT[0], most=most), by[:, :, 0]
    for p in range(1, len(POINT)):
        yield form, form.term("kg m", sd * extent, part=POINT[p]), by[:, :, p]


def _of_link(form: Form, k: int, s: Signals, model: Operating) -> Iterator[FormColumn]:
    """Columns of errors of a link: all its parameters, its density, or a body on it."""
    m, by = s.log.mechanism, s.rigid[:, :, k]
    sd, size = FORMS.inertia * terms.prior_of_body(m, k), terms.size_of_body(m, k)
    columns = by @ terms.slopes_of(model.bodies[k])
    for p, name in enumerate(BODY):
        if sd[p] > 0.0:
            yield form, form.term(UNITS[p], sd[p], part=name, most=size[p]), columns[:, :, p]
    if sd[0] > 0.0:
        dense, on_it = (replace(form, setting=f"{form.setting} {x}".strip()) for x in (DENSE, BODY_ON_IT))
        yield dense, dense.term("kg", sd[0], most=size[0]), by @ (model.inertials[k] / model.bodies[k, 0])
        yield from _point(on_it, by[:, :, : len(POINT)], sd[0], size[1], size[0])


@effect("payload")
def _payload(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    by, m = s.rigid[:, :, -1], s.log.mechanism
    column, most = by @ payload_of(m), [float(np.max(motion.payload)) for motion in s.log.motions]
    kinds = ("", "kg", scale.loaded, s.payload > 0.0), (DENSE, "1", 1.0, s.payload)  # alike for one mass
    for setting, unit, size, rows in kinds[: len({*most} - {0.0})]:
        form = Form("payload", TOOL, "mass", setting)
        yield form, form.term(unit, FORMS.payload * size), column * rows[:, None]
    if not all(most):
        sd, form = FORMS.unstated * float(np.sum(m.mass)), Form("payload", TOOL, EVERY)
        yield form, form.term("kg", sd), column
        point = np.concatenate([column[:, :, None], by[:, :, 1 : len(POINT)]], axis=2)
        yield from _point(replace(form, setting=ELSEWHERE), point, sd, FORMS.reach)
        yield from _of_link(replace(form, setting=AS_LINK), m.n - 1, s, model)


@effect("payload-offset", needs=_no_loads)
def _payload_offset(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    form, m = Form("payload-offset", TOOL, "centre of mass"), s.log.mechanism
    none = np.zeros((3, 3))
    for axis, step in zip("xyz", FORMS.offset * np.eye(3), strict=True):
        both = inertial(1.0, m.payload_centre + step, none) - inertial(1.0, m.payload_centre - step, none)
        column = (s.rigid[:, :, -1] @ (both / (2.0 * FORMS.offset))) * s.payload[:, None]
        yield form, form.term("m", FORMS.offset, part=axis), column


Kind = tuple[str, str, str, float | np.ndarray, np.ndarray]
"""Driver, setting and unit of a form of each joint; prior sds, one or (n,); columns (N, n)."""


def _of_joints(effect: str, *of: Kind, first: int = 0) -> Iterator[FormColumn]:
    """Forms of each joint, in channels from `first` on."""
    for j in range(of[0][-1].shape[1]):
        for driver, setting, unit, sd, columns in of:
            form = Form(effect, joint(j), driver, setting)
            size = sd if isinstance(sd, float) else float(sd[j])
            yield form, form.term(unit, size, first + j), columns[:, j]


@effect("armature")
def _armature(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    sd = FORMS.armature * np.maximum(model.armature, scale.torque / FORMS.acceleration)
    return _of_joints("armature", ("acceleration", "", "kg m2", sd, s.ddq))


@effect("stribeck")
def _stribeck(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    way, speeds, sd = model.reversal(s), np.abs(s.dq), FORMS.stribeck * scale.friction

    def kind(speed: float, power: float) -> Kind:
        bump = np.exp(-np.power(speeds / speed, power))
        return "low speed", f"{speed:g} rad/s, power {power:g}", "N m", sd, way * bump

    return _of_joints("stribeck", *starmap(kind, product(FORMS.stribeck_speeds, FORMS.stribeck_powers)))


@effect("load-friction")
def _load_friction(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    way, load, driver = model.reversal(s), model.load(s), "torque times direction"
    plain = (driver, "", "1", FORMS.load_friction, way * np.abs(load))
    square = (driver, "square of the torque", "1", FORMS.load_friction, way * (load**2 / scale.torque))
    return _of_joints("load-friction", plain, square)


SATURATES = "that saturates"
"""Setting of a form that grows less and less with speed."""


def at_speed(setting: str, speed: np.ndarray) -> np.ndarray:
    """Torque per unit of a form of viscous friction, at speeds of any shape, rad/s."""
    fast = np.abs(speed)
    return fast / (1.0 + fast / FORMS.saturation) if setting.startswith(SATURATES) else fast


@effect("asymmetric-friction")
def _asymmetric(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    sd = FORMS.asymmetric * np.maximum(model.viscous, 0.5 * scale.friction)
    of = [("abs speed", x, "N m s/rad", sd, at_speed(x, s.dq)) for x in ("", SATURATES)]
    return _of_joints("asymmetric-friction", *of)


@effect("ripple")
def _ripple(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    for j, waves in scale.waves.steady:
        for harmonics in FORMS.harmonics:
            setting = f"{waves:.4g} waves a turn" + (", with the double" if len(harmonics) > 1 else "")
            form = Form("ripple", joint(j), "motor angle", setting)
            for h in harmonics:
                for part, function in (("sin", np.sin), ("cos", np.cos)):
                    term = form.term("N m", FORMS.ripple * scale.friction[j] / h, j, f"{part} {h}")
                    yield form, term, function(h * waves * s.q[:, j])


@effect("torque-constant")
def _torque_constant(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    torque = model.torque(s)
    large = torque * np.abs(torque) / scale.torque
    falling = ("torque", "that falls with the torque", "1", FORMS.constant, large)
    return _of_joints("torque-constant", ("torque", "", "1", FORMS.constant, torque), falling)


@effect("torque-drift")
def _torque_drift(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    torque = model.torque(s)
    for w in warming(s):
        rise = np.broadcast_to(w.rise[:, None], torque.shape)
        sd, share = FORMS.drift * scale.torque / w.usual, FORMS.drift / w.usual
        plain = (w.driver, w.setting, f"N m{w.per}", sd, rise)
        scaled = (f"{w.driver} times torque", w.setting, f"1{w.per}", share, rise * torque)
        yield from _of_joints("torque-drift", plain, scaled)


@effect("viscous-temperature")
def _viscous_temperature(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    size = FORMS.viscous_temperature * np.maximum(np.abs(model.viscous), 0.5 * scale.friction)
    for w in warming(s):
        driver, unit = f"speed times {w.driver}", f"N m s/rad{w.per}"
        of = (driver, w.setting, unit, size / w.usual, w.rise[:, None] * s.dq)
        yield from _of_joints("viscous-temperature", of)


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


@effect("delay")
def _delay(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    later = -derivative(model.measured(s), s.step)
    form = Form("delay", LOG, "rate of torque")
    yield form, form.term("s", FORMS.delay), later
    yield from _of_joints("delay", ("rate of torque", "", "s", FORMS.delay, later))


@effect("base-tilt")
def _base_tilt(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    form = Form("base-tilt", BASE, "gravity direction")
    for k, name in enumerate("xy"):
        turned = np.cross(np.eye(3)[k], s.log.gravity)
        by = np.einsum("a,anjkp->njkp", turned, s.tilted)
        column = carried(by, model.inertials, s.log.mechanism, s.payload)
        yield form, form.term("rad", FORMS.tilt, part=name), column


@effect("inertia")
def _inertia(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    for k in range(s.log.n):
        yield from _of_link(Form("inertia", joint(k), "motion of the link"), k, s, model)


@effect("servo-stiffness", needs=_no_stiffness)
def _servo_stiffness(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    if s.log.torque_kind == SERVO:
        yield from _of_joints("servo-stiffness", ("torque", "", "1", FORMS.servo, model.load(s)))
        return
    softer, first = model.driven(s) / s.log.controller.stiffness, channel(s.log, TRACKING, 0)
    yield from _of_joints("servo-stiffness", ("torque", "", "1", FORMS.servo, softer), first=first)


@effect("elasticity", needs=_without(LINK, UNSEEN))
def _elasticity(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    of = ("torque", "", "rad/(N m)", FORMS.deflection / scale.torque, -model.load(s))
    return _of_joints("elasticity", of, first=channel(s.log, LINK, 0))


@effect("backlash", needs=_no_gap)
def _backlash(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    def kind(side: float) -> Kind:
        setting = f"over {side:g} of its RMS"
        return "side of the torque", setting, "rad", FORMS.deflection, -np.tanh(load / (side * scale.torque))

    load = model.load(s)
    by_way = ("direction of motion", "", "rad", FORMS.deflection, -model.reversal(s))
    return _of_joints("backlash", *map(kind, FORMS.sides), by_way, first=channel(s.log, LINK, 0))


def title_of(form: Form) -> str:
    """What is wrong, in words."""
    if form.driver != EVERY:
        return EFFECTS[form.effect].title
    return UNSTATED + (OR_LINK if form.setting.startswith(AS_LINK) else "")


def in_all_joints(forms: Mapping[Form, Sequence[str]]) -> dict[Form, tuple[str, ...]]:
    """Forms of effects that are in all joints, each with its own value; they have the terms of the joints'.

    What warms, turns or feeds all drives is one cause, and may be too weak in each joint to be seen there.
    """
    out: dict[Form, tuple[str, ...]] = {}
    for form, names in forms.items():
        if form.effect in EFFECTS and form.site.startswith("joint ") and len(names) == 1:
            setting = ", ".join(x for x in (form.setting, EACH) if x)
            every = replace(form, site=LOG, setting=setting)
            out[every] = (*out.get(every, ()), *names)
    return {form: names for form, names in out.items() if len(names) > 1}


def columns(s: Signals, model: Operating, scale: Scale) -> Iterator[FormColumn]:
    """Columns of every effect that a log can tell of."""
    for of in EFFECTS.values():
        if not of.lacks(s.log):
            yield from of.forms(s, model, scale)
