"""One log from its seed and number alone: an arm, its motions, something hidden, and the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfiltfilt

from analysis.world.motion import arms, mix, noise, plan, size, write
from analysis.world.motion.log import GRAVITY, Act, Change, Log, rates, rigid

SCHEMA = "motion-truth/1"
U_ALIGNMENT, U_CONSTANT = 3e-4, 0.1
"""Standard uncertainty of the alignment of the clocks, s, and of a torque constant, relative."""
NOISE = 0.0040
"""Usual RMS of the torque's noise, as a share of the rated torque."""
POSITION, COUNT, VELOCITY, TEMPERATURE = 0.0003, 360 / 2**19, 0.09, 0.05
"""Noise of a position, its step, noise of a velocity and of the temperature; deg, deg/s, K."""
STIFFEST = 9.8e3
"""Of a position servo, N m/rad: softer than most, so that the tracking error is large."""
MOVING = 0.02
"""Speed of the quickest joint above which a row counts as moving, rad/s."""
BASELINE = ["inertials", "armature", "coulomb", "viscous", "offset"]


@dataclass(frozen=True)
class Made:
    """A log: its files by name, its ground truth, and the hidden effects with their sizes."""

    files: dict[str, bytes]
    truth: dict
    log: Log
    base: size.Baseline
    acts: list[tuple[Act, float]]
    drawn: arms.Arm


@dataclass(frozen=True)
class Rig:
    """How a log is measured: columns, controller, converters."""

    servo: bool
    command: bool
    link: bool
    temperature: bool
    velocity: bool
    current: bool
    referred_to: str
    stiffness: np.ndarray  # N m/rad
    lag: float  # s, of the position behind its command
    band: float  # Hz, of the servo
    constant: np.ndarray  # N m/A, stated
    true_constant: np.ndarray


def _rig(rng: np.random.Generator, arm: arms.Arm, wanted: dict) -> Rig:
    servo = wanted.get("servo", bool(rng.random() < 0.2))
    current = bool(rng.random() < 0.2)
    constant = np.array([float(f"{v:.3g}") for v in arm.rated / rng.uniform(6, 14)])
    return Rig(
        servo=servo,
        command=servo or bool(rng.random() < 0.6),
        link=wanted.get("link", bool(rng.random() < 0.15)),
        temperature=wanted.get("temperature", bool(rng.random() < 0.8)),
        velocity=bool(rng.random() < 0.9),
        current=current,
        referred_to="motor" if not current and rng.random() < 0.15 else "joint",
        stiffness=np.array([float(f"{min(v, STIFFEST):.3g}") for v in arm.rated / rng.uniform(0.006, 0.02)]),
        lag=float(rng.uniform(2e-3, 12e-3)),
        band=float(rng.uniform(4, 7)),
        constant=constant,
        true_constant=constant * (1 + U_CONSTANT * np.clip(rng.standard_normal(arm.size), -2, 2)),
    )


def _friction(arm: arms.Arm, dq: np.ndarray) -> np.ndarray:
    return arm.coulomb * np.tanh(dq / arm.transition) + arm.viscous * dq


def _follow(arm: arms.Arm, session: plan.Session, rig: Rig) -> tuple[plan.Session, np.ndarray | None, np.ndarray]:
    """Return the session as the arm moves it, command less position and the command (rows, n).

    A position servo is off by its torque over its stiffness, within its band; by iteration.
    """
    asked = session.q
    late = [m.path(session.since[run] - rig.lag) for m, run in zip(session.motions, session.runs, strict=True)]
    q, dq, ddq = (np.concatenate([p[k] for p in late]) for k in range(3))
    moved = replace(session, q=q, dq=dq, ddq=ddq)
    if not rig.servo:
        return moved, None, asked
    sos = butter(2, rig.band, fs=session.rate, output="sos")
    for _ in range(3):
        torque = rigid(arm, moved, GRAVITY)[0] + _friction(arm, moved.dq) + arm.armature * moved.ddq
        error = np.concatenate([sosfiltfilt(sos, torque[run], axis=0) for run in session.runs]) / rig.stiffness
        speed = rates(session, error)
        moved = replace(session, q=q - error, dq=dq - speed, ddq=ddq - rates(session, speed))
    return moved, error, asked


def make(
    seed: int, number: int, kinds: Sequence[str] = mix.KINDS, held_out: bool = False, motions: int = 0, length: float = 0.0
) -> Made:
    """Make a log.

    Parameters
    ----------
    seed, number : int
        The same seed gives the same set of logs; no log depends on another.
    kinds : sequence of str
        Of `mix.KINDS`, those that are made.
    held_out : bool
        With the further forms and causes.
    motions, length : int, float
        Number of motions and their duration (s); by default drawn.
    """
    rng = np.random.default_rng([seed, 0, number])
    what = mix.recipe(seed, number, kinds, held_out)
    wanted = mix.wishes(rng, what.names)
    drawn = arms.nominal(rng, str(rng.choice(tuple(arms.SORTS), p=[0.4, 0.25, 0.2, 0.15])))
    arm = arms.true(rng, drawn)
    rig = _rig(rng, drawn, wanted)
    session, error, command = _follow(arm, plan.plan(rng, drawn, wanted, motions, length), rig)
    turbulence = noise.draw(rng, NOISE * drawn.rated)
    body, columns = rigid(arm, session, GRAVITY)
    still = replace(session, dq=0 * session.q, ddq=0 * session.q)
    offset = 0.01 * drawn.rated * rng.standard_normal(arm.size)
    torque = body + arm.armature * session.ddq + _friction(arm, session.dq) + offset
    log = Log(arm, session, turbulence, torque, body, rigid(arm, still, GRAVITY)[0], rates(session, torque), error,
              rig.link, rig.current, U_CONSTANT, U_ALIGNMENT, GRAVITY)  # fmt: skip
    base = size.baseline(log, columns, drawn)
    found = [_sized(rng, maker, base, log) for maker in what.makers]
    acts = [(act, amount) for act, amount, _ in found]
    change = total(log, [act.apply(amount) for act, amount in acts])
    disturbance = noise.sampled(rng, turbulence, session.runs, session.step)
    alignment = float(U_ALIGNMENT * np.clip(rng.standard_normal(), -2, 2))
    measured = log.at(np.full(len(session.time), alignment)) + change.torque + disturbance
    name = f"motion log {number:03d}"
    stated = turbulence.rms * rng.uniform(0.78, 1.28)
    files = {
        "dataset.yaml": write.dataset_text(name, drawn, session, _notes(rig, stated)).encode(),
        "motion.csv.gz": write.motion_table(session, _columns(rng, log, rig, measured, command, change)),
    }
    truth = _truth(base, what, found, change, disturbance) | {"seed": seed, "alignment_s": alignment}
    truth = {"world": f"{number:03d}", "schema": SCHEMA} | truth
    truth["session"] = session.notes | {"arm": drawn.name, "servo": rig.servo, "current": rig.current, "link": rig.link}
    truth["true_inertials"] = [round(float(v), 6) for v in arm.parameters]
    return Made(files, plain(truth), log, base, acts, drawn)


def total(log: Log, changes: Sequence[Change]) -> Change:
    """Return the sum of changes."""
    none = np.zeros_like(log.torque)

    def added(key: str) -> np.ndarray:
        return sum((v for c in changes if (v := getattr(c, key)) is not None), none)

    return Change(added("torque"), added("link"), added("track"))


def _sized(rng: np.random.Generator, maker: mix.Maker, base: size.Baseline, log: Log) -> tuple[Act, float, dict]:
    """Draw an effect and its size for a wanted lambda; again where no possible size has it."""
    goal = float(np.exp(rng.uniform(*np.log(mix.GOAL))))
    best: tuple[Act, float, dict] | None = None
    for _ in range(5):
        act = maker(rng, log)
        amount = size.solved(base, act.apply, act.usual, act.most, goal)
        parts = size.detectability(base, act.apply(amount))
        note = {"goal": goal, "value": sum(parts.values()), "parts": parts}
        if best is None or note["value"] > best[2]["value"]:
            best = (act, amount, note)
        if best[2]["value"] > 0.98 * goal:
            break
    assert best is not None
    return best


def _notes(rig: Rig, stated: np.ndarray) -> dict[str, str]:
    """Return the lines of dataset.yaml on the measurement."""
    flat = partial(np.format_float_positional, precision=3, fractional=False, trim="-")
    numbers = "[" + ", ".join(flat(v) for v in stated) + "]"
    kind = "current" if rig.current else "motor"
    torque = f"kind: {kind}, referred_to: {rig.referred_to}, sign: joint"
    if rig.current:
        listed = ", ".join(f"{v:g}" for v in rig.constant)
        torque += f", constant_Nm_per_A: [{listed}], u_constant: {U_CONSTANT:g}"
    more = f", temperature_degC: {TEMPERATURE:g}" if rig.temperature else ""
    velocity = f", velocity_degps: {VELOCITY:g}" if rig.velocity else ""
    out = {"torque": f"{{{torque}}}", "position": "{side: motor}"}
    if rig.servo:
        stiffness = ", ".join(f"{v:g}" for v in rig.stiffness)
        out["controller"] = f"{{kind: position, kp_Nm_per_rad: [{stiffness}]}}"
    out["clock"] = f"{{kind: stamps, alignment_ms: 0, u_alignment_ms: {1e3 * U_ALIGNMENT:g}}}"
    out["noise"] = f"{{torque_Nm: {numbers}, autocorrelated: true, position_deg: {POSITION:g}{velocity}{more}}}"
    return out


def _columns(
    rng: np.random.Generator, log: Log, rig: Rig, measured: np.ndarray, command: np.ndarray, change: Change
) -> dict[str, tuple[str, np.ndarray]]:
    """Return the columns of motion.csv by name, each with its format and its values."""
    s, n, shape = log.session, log.arm.size, log.torque.shape
    assert change.track is not None
    assert change.link is not None

    def counted(radians: np.ndarray, noisy: float) -> np.ndarray:
        return COUNT * np.round((np.degrees(radians) + noisy * rng.standard_normal(shape)) / COUNT)

    out: dict[str, tuple[str, np.ndarray]] = {}

    def add(name: str, unit: str, form: str, values: np.ndarray) -> None:
        out.update({f"{name}{j + 1}_{unit}": (form, values[:, j]) for j in range(n)})

    add("q", "deg", "%.5f", counted(s.q - change.track, POSITION))
    if rig.velocity:
        add("dq", "degps", "%.3f", np.degrees(s.dq) + VELOCITY * rng.standard_normal(shape))
    if rig.command:
        wobble = size.wander(rng, s, size.TRACK) if rig.servo else 0.0
        add("command", "deg", "%.5f", np.degrees(command + wobble))
    if rig.link:
        add("link", "deg", "%.4f", np.degrees(s.q + change.link + size.wander(rng, s, size.LINK)))
    step = log.arm.rated / 5000
    if rig.current:
        add("current", "A", "%.4f", step * np.round(measured / step) / rig.true_constant)
    else:
        share = log.arm.gear if rig.referred_to == "motor" else np.ones(n)
        add("torque", "Nm", "%.5f" if rig.referred_to == "motor" else "%.4f", step * np.round(measured / step) / share)
    if rig.temperature:
        warm = 22 + s.warm + TEMPERATURE * rng.standard_normal(len(s.warm))
        out["temperature_degC"] = ("%.2f", warm)
    out["payload_kg"] = ("%g", s.payload)
    return out


def _truth(base: size.Baseline, what: mix.Recipe, found: list, change: Change, disturbance: np.ndarray) -> dict:
    """Return the hidden effects, their detectability and the RMS of the validation torques."""
    log, s = base.log, base.log.session
    rows = s.rows("validate") & (np.max(np.abs(s.dq), axis=1) > MOVING)
    outside = what.kind == "outside"
    names = [act.name for act, _, _ in found]
    each = {act.name: note["value"] for act, _, note in found}
    both = change.torque + disturbance
    rest = {
        "oracle": disturbance,
        "baseline": base.residual(both, base.absorbed(both)),
        "baseline_noise_free": base.residual(change.torque, base.absorbed(change.torque)),
    }
    turbulence = log.noise
    return {
        "kind": what.kind,
        "effects": ["unknown"] if outside else names,
        "outside": names[0] if outside else None,
        "form": {act.name: act.form for act, _, _ in found},
        "where": [w for act, _, _ in found for w in act.where],
        "lambda": {
            "value": min(each.values(), default=0.0),
            "each": each,
            "total": sum(size.detectability(base, change).values()),
            "parts": {act.name: note["parts"] for act, _, note in found},
        },
        "lambda_goal": {act.name: note["goal"] for act, _, note in found},
        "amplitude": {act.name: {"value": amount, "unit": act.unit} for act, amount, _ in found},
        "effect_parameters": {act.name: act.detail for act, _, _ in found},
        "baseline": BASELINE + (["torque-constant"] if log.current else []),
        "rate_hz": s.rate,
        "motions": len(s.motions),
        "rows": len(s.time),
        "noise": {
            "torque_rms_Nm": turbulence.rms,
            "slow_share": turbulence.slow,
            "fast_s": turbulence.fast_s,
            "slow_s": turbulence.slow_s,
        },
        "torque_rms_Nm": {k: np.sqrt(np.mean(v[rows] ** 2, axis=0)) for k, v in rest.items()},
    }


def plain(value: object) -> object:
    """Return a value as JSON knows it, to six digits."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    return float(f"{value:.6g}") if isinstance(value, float | np.floating) else value
