"""Quantities of a log on which an unknown error may depend, with functions of each, at rows that are kept.

They are functions of low-passed signals, not low-passed functions: what they describe is only known to be
some function, and so a thousand of them cost little.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bayescal.motion.cells import Ranges, presliding, resonated, smooth
from bayescal.motion.effects import Waves
from bayescal.motion.settings import FORMS, PRODUCTS, SEARCH
from bayescal.motion.signals import Signals
from bayescal.motion.terms import Operating

_WIDE = np.array([-1.0, 1.0]) * PRODUCTS.wide


@dataclass(frozen=True)
class Argument:
    """A quantity, with functions (M, k) of it; `joint` is the one that it belongs to, from 0."""

    name: str
    functions: np.ndarray
    joint: int | None = None
    times: tuple[str, ...] = PRODUCTS.responses
    moves: bool = False  # whether it is a motion of what carries the arm, or of what it carries
    only: int | None = None  # the one joint whose error may depend on it
    log_prior: float = 0.0  # nats, where it was chosen among many


@dataclass(frozen=True)
class Kept:
    """Signals of a motion at the rows that are kept, of size about 1 where no unit is stated."""

    q: np.ndarray  # (M, n) rad
    dq: np.ndarray  # (M, n) over their RMS, as all below
    ddq: np.ndarray
    load: np.ndarray
    way: np.ndarray  # (M, n) direction of motion


def quantities(s: Signals, model: Operating, r: Ranges, waves: Waves) -> tuple[Kept, tuple[Argument, ...]]:
    """Signals of a motion that errors are in proportion to, and quantities that they may depend on."""
    k = kept_signals(s, model, r)
    return k, tuple(_arguments(s, model.load(s), model.torque(s), r, k, waves))


def kept_signals(s: Signals, model: Operating, r: Ranges) -> Kept:
    """Signals of a motion that errors are in proportion to."""
    return Kept(
        s.kept(s.q), s.kept(s.dq) / r.usual_speed, s.kept(s.ddq) / r.usual_acceleration,
        s.kept(model.load(s)) / r.usual_load, s.kept(model.reversal(s)),
    )  # fmt: skip


def responses(k: Kept, j: int) -> dict[str, np.ndarray]:
    """What an error at a joint may be in proportion to, (M,) each."""
    load, way = k.load[:, j], k.way[:, j]
    return {
        "": np.ones(len(load)),
        "direction": way,
        "torque": load,
        "torque times direction": way * np.abs(load),
        "speed": k.dq[:, j],
        "acceleration": k.ddq[:, j],
    }


def _arguments(
    s: Signals, load: np.ndarray, torque: np.ndarray, r: Ranges, k: Kept, waves: Waves
) -> Iterator[Argument]:
    few = PRODUCTS.waves
    for j in range(s.log.n):
        label = f" of joint {j + 1}"
        yield Argument("angle" + label, _waves(k.q[:, j], r.angle[:, j], PRODUCTS.angles), j)
        for name, x in (("speed", k.dq), ("torque", k.load), ("acceleration", k.ddq)):
            yield Argument(name + label, _waves(x[:, j], _WIDE, few), j)
        yield Argument("direction" + label, k.way[:, j : j + 1], j)
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
        yield Argument(name, _waves(late, np.maximum(_WIDE, 0.0), few), None, PRODUCTS.with_memory)
    if r.loaded:
        yield Argument("payload", s.kept((s.payload > 0.0).astype(float))[:, None])
    if s.temperature is not None:
        warm = s.kept(s.temperature) / FORMS.kelvin
        yield Argument("temperature", np.column_stack([warm, warm**2]))
    sources = np.column_stack([s.ddq / r.usual_acceleration, load / r.usual_load])
    for frequency in (f for f in PRODUCTS.resonances if f < s.band):
        response, name = s.kept(resonated(sources, frequency, s.step)), f"oscillation, {frequency:.2g} Hz"
        yield Argument(name, response, None, ("",), True, None, PRODUCTS.oscillation)
    for j, number in waves.changing:
        wave = s.kept(np.exp(1j * number * s.q[:, j]))
        functions = np.zeros((len(time), 2 * r.count))
        parts = np.array_split(np.arange(len(time)), SEARCH.pieces)
        for piece, rows in zip(r.pieces[s.name], parts, strict=True):
            functions[rows, 2 * piece], functions[rows, 2 * piece + 1] = wave[rows].real, wave[rows].imag
        name = f"angle of joint {j + 1}, {number:.3g} waves a turn whose phase changes"
        yield Argument(name, functions, j, ("",), only=j, log_prior=waves.changing_spread)
    for j, number, kind in waves.in_proportion:
        wave = s.kept(np.exp(1j * number * s.q[:, j]))
        name = f"angle of joint {j + 1}, {number:.3g} waves a turn"
        both = np.column_stack([wave.real, wave.imag])
        yield Argument(name, both, j, (kind,), only=j, log_prior=waves.in_proportion_spread)


def _memories(s: Signals, load: np.ndarray, torque: np.ndarray, j: int) -> Iterator[Argument]:
    """What was before, of a joint: the way that it has come, and how its torques (N,) have changed."""

    def memory(name: str, *columns: np.ndarray) -> Argument:
        kept = s.kept(np.column_stack(columns))
        return Argument(f"{name} of joint {j + 1}", kept, j, PRODUCTS.with_memory)

    gone = np.cumsum(np.abs(s.dq[:, j])) * s.step
    for length in PRODUCTS.ways:
        yield memory("way since the reversal", presliding(s.dq[:, j], s.step, length))
        yield memory("way since the start", np.exp(-gone / length))
    sides = np.tanh(np.column_stack([torque, load]) / FORMS.sides[0])
    yield Argument(f"side of the torque of joint {j + 1}", s.kept(sides), j)
    for share in PRODUCTS.shares:
        yield memory("change of torque", presliding(np.gradient(torque) / s.step, s.step, share))
    for constant in PRODUCTS.lags:
        yield memory("earlier torque", *(_late(x, constant, s.step) for x in (torque, torque**2)))


def _late(x: np.ndarray, constant: float, step: float) -> np.ndarray:
    """Samples (N,) with the lag of one time constant, s, that begins at rest."""
    keep = np.exp(-step / constant)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0])


def _waves(x: np.ndarray, bounds: np.ndarray, count: int) -> np.ndarray:
    """Cosines (M, count) over a range (2,) of x."""
    return np.column_stack(smooth(x, bounds, count))
