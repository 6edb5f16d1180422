"""Functions of the quantities of a log, for causes that are not in the list.

A cause that is in no list still is a function of something: an angle, a speed, a load, the time, the way that
a joint has come. Each *cell* is a site, an argument and a few columns, low-passed as those of an effect.

Quantities on which an unknown error may depend beside them are functions of low-passed signals, not
low-passed functions: what they describe is only known to be some function, and so a thousand of them cost
little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.signal import lfilter

from bayescal.arm.transforms import compiled
from bayescal.motion.dynamics import Loads
from bayescal.motion.effects import BASE, LOG, TOOL, Form, FormColumn, Scale, Waves, columns, joint
from bayescal.motion.settings import CELLS, FORMS, PRODUCTS, SEARCH
from bayescal.motion.signals import Signals, derivative, each
from bayescal.motion.terms import Operating
from bayescal.statistics import grouped

UNKNOWN = "unknown"


def smooth(x: np.ndarray, bounds: np.ndarray, count: int) -> list[np.ndarray]:
    """The first cosines (N,) over a range (2,) of x, each half a period more than the last."""
    low, high = bounds
    u = np.clip((x - low) / max(high - low, 1e-12), 0.0, 1.0)
    return [np.cos(np.pi * k * u) for k in range(1, count + 1)]


class Ranges:
    """Ranges over all motions, of what cells are functions of."""

    def __init__(self, parts: tuple[Signals, ...], model: Operating) -> None:
        def bounds(x: list[np.ndarray]) -> np.ndarray:
            whole = np.concatenate(x)
            return np.array([np.min(whole, axis=0), np.max(whole, axis=0)])

        def usual(x: list[np.ndarray]) -> np.ndarray:
            return np.maximum(np.sqrt(np.mean(np.concatenate(x) ** 2, axis=0)), 1e-9)

        self.angle = bounds([s.q for s in parts])  # (2, n)
        self.speed = bounds([s.dq for s in parts])
        self.time = bounds([s.time for s in parts])  # (2,)
        times = grouped((s.role, s.time) for s in parts)
        waves = {role: smooth(np.concatenate(x), self.time, CELLS.time_waves) for role, x in times.items()}
        self.usual_times = {role: np.mean(x, axis=1) for role, x in waves.items()}
        count = min(len(parts), CELLS.groups)
        self.groups = {s.name: k * count // len(parts) for k, s in enumerate(parts)}
        loads, powers = [], []
        for s in each(parts):  # a long log forgets its torques
            loads.append(model.load(s))
            powers.append(float(np.mean(np.abs(np.sum(model.torque(s) * s.dq, axis=1)))))
        self.load, self.usual_load = bounds(loads), usual(loads)
        self.usual_speed = usual([s.dq for s in parts])
        self.usual_acceleration = usual([s.ddq for s in parts])
        self.usual_power = max(float(np.mean(powers)), 1e-9)
        every = len(parts) * SEARCH.pieces
        self.count = min(every, SEARCH.most_pieces)
        numbers = np.arange(every).reshape(len(parts), -1) * self.count // every
        self.pieces = {s.name: row.tolist() for s, row in zip(parts, numbers, strict=True)}
        self.loaded = any(np.any(s.payload > 0.0) for s in parts)


def cells(s: Signals, model: Operating, scale: Scale, r: Ranges) -> Iterator[FormColumn]:
    """Columns of every cell."""
    way, load, n = model.reversal(s), model.load(s), s.log.n
    later = derivative(model.torque(s), s.step)

    def cell(j: int, driver: str, functions: list[np.ndarray], setting: str = "") -> Iterator[FormColumn]:
        form = Form(UNKNOWN, joint(j), driver, setting)
        for k, function in enumerate(functions):
            yield form, form.term("N m", CELLS.size * scale.friction[j], j, str(k)), function

    times = smooth(s.time, r.time, CELLS.time_waves)
    within = np.linspace(0.0, 1.0, len(s.time), endpoint=False)
    offsets = [np.full(len(s.time), float(r.groups[s.name] == g)) for g in sorted(set(r.groups.values()))]
    parts = CELLS.pieces if len(offsets) < CELLS.groups else 1
    pieces = [(np.floor(parts * within) == k) * offset for offset in offsets for k in range(parts)]
    for j in range(n):
        turn, speed = s.q[:, j], s.dq[:, j]
        angles = smooth(turn, r.angle[:, j], CELLS.waves)
        direction, torque = way[:, j], load[:, j]
        torques = smooth(torque, r.load[:, j], CELLS.load_waves)
        speeds = smooth(speed, r.speed[:, j], CELLS.waves)
        yield from cell(j, "angle", angles)
        yield from cell(j, "angle times direction", [direction * f for f in angles])
        yield from cell(j, "torque", torques)
        yield from cell(j, "torque times direction", [direction * f for f in torques])
        yield from cell(j, "speed", speeds)
        yield from cell(j, "time", times)
        yield from cell(j, "time times direction", [direction * f for f in times])
        yield from cell(j, "time times torque", [torque / scale.torque[j] * f for f in times])
        yield from cell(j, "time within a motion", pieces)
        yield from cell(j, "direction times time within a motion", [direction * f for f in pieces])
        yield from cell(j, "motion", offsets)
        if r.loaded:
            on = (s.payload > 0.0).astype(float)
            functions = [on * direction, *(on * f for f in angles[:2])]
            yield from cell(j, "payload", functions)
        if s.temperature is not None:
            warm = s.temperature / FORMS.kelvin
            functions = [warm * direction, warm * np.abs(speed), warm**2, warm * angles[0]]
            yield from cell(j, "temperature", functions)
        for k in range(n):
            if k != j:
                others = smooth(s.q[:, k], r.angle[:, k], CELLS.other_waves)
                yield from cell(j, f"angle of joint {k + 1}", others)
                both = [direction * f for f in others]
                yield from cell(j, f"direction times angle of joint {k + 1}", both)
                fast = smooth(s.dq[:, k], r.speed[:, k], CELLS.other_waves)
                yield from cell(j, f"speed of joint {k + 1}", fast)
        for length in CELLS.presliding:
            moved = presliding(speed, s.step, length)
            yield from cell(j, "way since the reversal", [moved - direction], f"{length:g} rad")
        low, high = r.angle[:, j]
        for width in CELLS.bumps:
            for centre in np.arange(low + width, high, 1.5 * width):
                bump = np.exp(-0.5 * ((turn - centre) / width) ** 2)
                where = f"{np.rad2deg(centre):.0f} deg, width {np.rad2deg(width):.0f} deg"
                yield from cell(j, "angle, one place", [bump, bump * direction], where)
    form = Form(UNKNOWN, LOG, "rate of torque times time")  # errors of the clock, in all joints
    # torques that are early in motions of one role only are no drift: friction leads where motions are others
    for k, f in enumerate(times):
        yield form, form.term("s", CELLS.clock, part=str(k)), later * (f - r.usual_times[s.role][k])[:, None]
    form = Form(UNKNOWN, BASE, "turning of the base")  # an angular acceleration of what carries the arm
    still = s.q, np.zeros_like(s.q), np.zeros_like(s.q)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        turned = Loads.of(s.log.mechanism, still, np.zeros(3), model.inertials, s.payload, axis)
        yield form, form.term("rad/s2", CELLS.turning, part=name), turned.joints
    form = Form(UNKNOWN, TOOL, "force on the tool")  # constant, along the axes of the base: a hose, a cable
    unit = np.r_[1.0, s.log.mechanism.payload_centre, np.zeros(6)]
    for name, by in zip("xyz", s.tilted, strict=True):
        yield form, form.term("N", CELLS.force, part=name), by[:, :, -1] @ unit


def candidates(
    s: Signals, model: Operating, scale: Scale, r: Ranges, general: bool = True
) -> Iterable[FormColumn]:
    """Columns of every effect that a log can tell of, and of `general` functions."""
    return chain(columns(s, model, scale), cells(s, model, scale, r) if general else ())


def presliding(speed: np.ndarray, step: float, length: float) -> np.ndarray:
    """Deflection (N,) of bristles, -1 to 1, that a way of `length` rad saturates (Dahl, 1976)."""
    return _bristles(speed * step / length)


@compiled()
def _bristles(ways):
    out, z = np.empty(len(ways)), 0.0
    for k, way in enumerate(ways):
        z = (z + way) / (1.0 + abs(way))
        out[k] = z
    return out


def resonated(x: np.ndarray, frequency: float, step: float) -> np.ndarray:
    """Response (N, k) of a lightly damped oscillator to x, less x itself."""
    w, damping = 2.0 * np.pi * frequency, PRODUCTS.damping
    pole = np.exp((-damping + 1j * np.sqrt(1.0 - damping**2)) * w * step)
    a = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
    return lfilter([np.sum(a)], a, x, axis=0) - x


_WIDE = np.array([-1.0, 1.0]) * PRODUCTS.wide


@dataclass(frozen=True)
class Kept:
    """Signals of a motion at the rows that are kept, of size about 1 where no unit is stated."""

    q: np.ndarray  # (M, n) rad
    dq: np.ndarray  # (M, n) over their RMS, as all below
    ddq: np.ndarray
    load: np.ndarray
    way: np.ndarray  # (M, n) direction of motion

    @classmethod
    def of(cls, s: Signals, model: Operating, r: Ranges) -> Kept:
        """Signals of a motion that errors are in proportion to."""
        return cls(
            s.kept(s.q), s.kept(s.dq) / r.usual_speed, s.kept(s.ddq) / r.usual_acceleration,
            s.kept(model.load(s)) / r.usual_load, s.kept(model.reversal(s)),
        )  # fmt: skip


RESPONSES: Mapping[str, Callable[[Kept, int], np.ndarray]] = {
    "": lambda k, j: np.ones(len(k.load)),
    "direction": lambda k, j: k.way[:, j],
    "torque": lambda k, j: k.load[:, j],
    "torque times direction": lambda k, j: k.way[:, j] * np.abs(k.load[:, j]),
    "speed": lambda k, j: k.dq[:, j],
    "acceleration": lambda k, j: k.ddq[:, j],
}
"""What an error at a joint may be in proportion to, (M,) each (assumed)."""


@dataclass(frozen=True)
class Argument:
    """A quantity of a site, with functions (M, k) of it; `times` are the responses of joints beside it."""

    name: str
    functions: np.ndarray
    site: str = LOG
    times: tuple[str, ...] = tuple(RESPONSES)
    moves: bool = False  # whether it is a motion of what carries the arm, or of what it carries
    only: int | None = None  # the one joint whose error may depend on it
    log_prior: float = 0.0  # nats, where it was chosen among many


def quantities(s: Signals, model: Operating, r: Ranges, waves: Waves) -> tuple[Kept, tuple[Argument, ...]]:
    """Signals of a motion that errors are in proportion to, and quantities that they may depend on."""
    k = Kept.of(s, model, r)
    return k, tuple(_arguments(s, model, r, k, waves))


def _arguments(s: Signals, model: Operating, r: Ranges, k: Kept, waves: Waves) -> Iterator[Argument]:
    few, load, torque = PRODUCTS.waves, model.load(s), model.torque(s)
    for j in range(s.log.n):
        label = f" of joint {j + 1}"
        yield Argument("angle" + label, _waves(k.q[:, j], r.angle[:, j], PRODUCTS.angles), joint(j))
        for name, x in (("speed", k.dq), ("torque", k.load), ("acceleration", k.ddq)):
            yield Argument(name + label, _waves(x[:, j], _WIDE, few), joint(j))
        yield Argument("direction" + label, k.way[:, j : j + 1], joint(j))
        yield from _memories(s, load[:, j] / r.usual_load[j], torque[:, j] / r.usual_load[j], j)
    time = s.kept(s.time)
    yield Argument("time", _waves(time, r.time, PRODUCTS.times))
    since = time - s.time[0]
    fading = [np.exp(-since / constant) for constant in PRODUCTS.fading]
    within = _waves(since, np.array([0.0, since[-1]]), few)
    yield Argument("time since the motion began", np.column_stack([within, *fading]))
    groups = np.arange(max(r.groups.values()) + 1)
    yield Argument("motion", np.tile(groups == r.groups[s.name], (len(time), 1)).astype(float))
    power = np.sum(torque * s.dq, axis=1) / r.usual_power
    for name, constant in (("power", PRODUCTS.short), ("heat", PRODUCTS.long)):
        value = np.abs(power) if name == "heat" else np.maximum(power, 0.0)
        late = s.kept(_late(value, constant, s.step))
        yield Argument(name, _waves(late, np.maximum(_WIDE, 0.0), few), LOG, PRODUCTS.with_memory)
    if r.loaded:
        yield Argument("payload", s.kept((s.payload > 0.0).astype(float))[:, None])
    if s.temperature is not None:
        warm = s.kept(s.temperature) / FORMS.kelvin
        yield Argument("temperature", np.column_stack([warm, warm**2]))
    sources = np.column_stack([s.ddq / r.usual_acceleration, load / r.usual_load])
    for frequency in (f for f in PRODUCTS.resonances if f < s.band):
        response, name = s.kept(resonated(sources, frequency, s.step)), f"oscillation, {frequency:.2g} Hz"
        yield Argument(name, response, LOG, ("",), True, None, PRODUCTS.oscillation)
    for j, number in waves.changing:
        wave = s.kept(np.exp(1j * number * s.q[:, j]))
        functions = np.zeros((len(time), 2 * r.count))
        parts = np.array_split(np.arange(len(time)), SEARCH.pieces)
        for piece, rows in zip(r.pieces[s.name], parts, strict=True):
            functions[rows, 2 * piece], functions[rows, 2 * piece + 1] = wave[rows].real, wave[rows].imag
        name = f"angle of joint {j + 1}, {number:.3g} waves a turn whose phase changes"
        yield Argument(name, functions, joint(j), ("",), only=j, log_prior=waves.changing_spread)
    for j, number, kind in waves.in_proportion:
        wave = s.kept(np.exp(1j * number * s.q[:, j]))
        name = f"angle of joint {j + 1}, {number:.3g} waves a turn"
        both = np.column_stack([wave.real, wave.imag])
        yield Argument(name, both, joint(j), (kind,), only=j, log_prior=waves.in_proportion_spread)
    yield from _of_ends(s, model, r)


def _of_ends(s: Signals, model: Operating, r: Ranges) -> Iterator[Argument]:
    """What the base and the tool carry: quantities of no joint, and how something there would swing."""
    m, motion = s.log.mechanism, (s.q, s.dq, s.ddq)
    loads = Loads.of(m, motion, s.log.gravity, model.inertials, s.payload)
    of_base = BASE, "moment on the base", loads.base / np.max(r.usual_load)
    for site, name, x in (of_base, (TOOL, "acceleration at the tool", loads.tool / CELLS.gravity)):
        yield Argument(name, s.kept(x), site, ())
        yield Argument(f"side of the {name}", s.kept(np.tanh(x / FORMS.sides[1])), site, ())
        for constant in PRODUCTS.lags:
            yield Argument(f"earlier {name}", s.kept(_late(x, constant, s.step)), site, ())
        for frequency in (f for f in PRODUCTS.resonances if f < s.band):
            swings = s.kept(resonated(x, frequency, s.step))
            of = f"oscillation by the {name}, {frequency:.2g} Hz"
            yield Argument(of, swings, site, (), log_prior=PRODUCTS.oscillation)


def _memories(s: Signals, load: np.ndarray, torque: np.ndarray, j: int) -> Iterator[Argument]:
    """What was before, of a joint: the way that it has come, and how its torques (N,) have changed."""

    def memory(name: str, *columns: np.ndarray) -> Argument:
        kept = s.kept(np.column_stack(columns))
        return Argument(f"{name} of joint {j + 1}", kept, joint(j), PRODUCTS.with_memory)

    gone = np.cumsum(np.abs(s.dq[:, j])) * s.step
    for length in PRODUCTS.ways:
        yield memory("way since the reversal", presliding(s.dq[:, j], s.step, length))
        yield memory("way since the start", np.exp(-gone / length))
    sides = np.tanh(np.column_stack([torque, load]) / FORMS.sides[0])
    yield Argument(f"side of the torque of joint {j + 1}", s.kept(sides), joint(j))
    for share in PRODUCTS.shares:
        yield memory("change of torque", presliding(np.gradient(torque) / s.step, s.step, share))
    for constant in PRODUCTS.lags:
        yield memory("earlier torque", *(_late(x, constant, s.step) for x in (torque, torque**2)))


def _late(x: np.ndarray, constant: float, step: float) -> np.ndarray:
    """Samples (N, ...) with the lag of one time constant, s, that begins at rest."""
    keep = np.exp(-step / constant)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=keep * x[:1])[0])


def _waves(x: np.ndarray, bounds: np.ndarray, count: int) -> np.ndarray:
    """Cosines (M, count) over a range (2,) of x."""
    return np.column_stack(smooth(x, bounds, count))
