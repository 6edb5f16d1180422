"""How a log is measured: its columns, the position servo, converters of the torque."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfiltfilt

from analysis.world.motion import arms, plan
from analysis.world.motion.log import Change, Log
from analysis.world.motion.size import LINK, TRACK, wander

U_ALIGNMENT, U_CONSTANT = 3e-4, 0.1
"""Standard uncertainty of the alignment of the clocks, s, and of a torque constant, relative."""
POSITION, COUNT, VELOCITY, TEMPERATURE = 0.0003, 360 / 2**19, 0.09, 0.05
"""Noise of a position, its step, noise of a velocity and of the temperature; deg, deg/s, K."""
STIFFEST = 9.8e3
"""Of a position servo, N m/rad: softer than most, so that the tracking error is large."""


@dataclass(frozen=True)
class Rig:
    """How a log is measured: columns, controller, converters."""

    servo: bool
    command: bool
    link: bool
    temperature: bool
    velocity: bool
    velocity_hz: float  # band of a velocity, 0 without a filter
    current: bool
    referred_to: str
    stiffness: np.ndarray  # N m/rad
    lag: float  # s, of the position behind its command
    constant: np.ndarray  # N m/A, stated
    true_constant: np.ndarray


def draw(rng: np.random.Generator, arm: arms.Arm, wanted: dict) -> Rig:
    servo = wanted.get("servo", bool(rng.random() < 0.2))
    current = bool(rng.random() < 0.2)
    constant = np.array([float(f"{v:.3g}") for v in arm.rated / rng.uniform(6, 14)])
    return Rig(
        servo=servo,
        command=servo or bool(rng.random() < 0.6),
        link=wanted.get("link", bool(rng.random() < 0.15)),
        temperature=wanted.get("temperature", bool(rng.random() < 0.8)),
        velocity=bool(rng.random() < 0.9),
        velocity_hz=float(rng.choice([0.0, rng.uniform(15, 35)], p=[0.65, 0.35])),
        current=current,
        referred_to="motor" if not current and rng.random() < 0.15 else "joint",
        stiffness=np.array([float(f"{min(v, STIFFEST):.3g}") for v in arm.rated / rng.uniform(0.006, 0.02)]),
        lag=0.0 if servo else float(rng.uniform(2e-3, 12e-3)),
        constant=constant,
        true_constant=constant * (1 + U_CONSTANT * np.clip(rng.standard_normal(arm.size), -2, 2)),
    )


def follow(session: plan.Session, rig: Rig) -> tuple[plan.Session, np.ndarray]:
    """Return the session as the arm moves it, and the motion asked for (rows, n): the arm is late."""
    pairs = zip(session.motions, session.runs, strict=True)
    late = [m.path(session.since[run] - rig.lag) for m, run in pairs]
    q, dq, ddq = (np.concatenate([p[k] for p in late]) for k in range(3))
    return replace(session, q=q, dq=dq, ddq=ddq), session.q


def notes(rig: Rig, stated: np.ndarray) -> dict[str, str]:
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
    out["noise"] = (
        f"{{torque_Nm: {numbers}, autocorrelated: true, position_deg: {POSITION:g}{velocity}{more}}}"
    )
    return out


def columns(
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

    add("q", "deg", "%.5f", counted(s.q, POSITION))
    if rig.velocity:
        speed = np.degrees(s.dq) + VELOCITY * rng.standard_normal(shape)
        if rig.velocity_hz:
            sos = butter(1, rig.velocity_hz, fs=s.rate, output="sos")
            speed = np.concatenate([sosfiltfilt(sos, speed[run], axis=0) for run in s.runs])
        add("dq", "degps", "%.3f", speed)
    if rig.command:
        error = 0.0  # a position servo is off by its torque over its stiffness
        if rig.servo:
            error = log.torque / rig.stiffness + change.track + wander(rng, s, TRACK)
        add("command", "deg", "%.5f", np.degrees(command + error))
    if rig.link:
        add("link", "deg", "%.4f", np.degrees(s.q + change.link + wander(rng, s, LINK)))
    step = log.arm.rated / 5000
    if rig.current:
        add("current", "A", "%.4f", step * np.round(measured / step) / rig.true_constant)
    else:
        share = log.arm.gear if rig.referred_to == "motor" else np.ones(n)
        add(
            "torque",
            "Nm",
            "%.5f" if rig.referred_to == "motor" else "%.4f",
            step * np.round(measured / step) / share,
        )
    if rig.temperature:
        warm = 22 + s.warm + TEMPERATURE * rng.standard_normal(len(s.warm))
        out["temperature_degC"] = ("%.2f", warm)
    out["payload_kg"] = ("%g", s.payload)
    return out
