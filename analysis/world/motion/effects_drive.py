"""Effects of the list that act in drives, friction and measurement; each has several forms."""

from __future__ import annotations

import numpy as np

from analysis.world.motion.effects import alone, of_joint, place, scaled
from analysis.world.motion.log import Act, Change, Log


def stribeck(rng: np.random.Generator, log: Log, form: str) -> Act:
    """More friction at low speeds: exponents of 1, 1.5 or 2."""
    j, arm, dq = int(rng.integers(log.arm.size)), log.arm, log.session.dq
    exponent = {"exponential": 1.0, "between": 1.5, "Gaussian": 2.0}[form]
    knee = float(rng.uniform(2.2, 5.0)) * arm.transition
    drop = np.tanh(dq[:, j] / arm.transition) * np.exp(-((np.abs(dq[:, j]) / knee) ** exponent))
    most = 3 * arm.coulomb[j]
    return of_joint(
        log, j, "stribeck", "speed", "N m", most, drop, speed_radps=knee, exponent=exponent, form=form
    )


def load_friction(rng: np.random.Generator, log: Log, form: str) -> Act:
    """Friction that grows with the torque: with its absolute value, smoothly, or with gravity alone."""
    j = int(rng.integers(log.arm.size))
    load = log.rigid[:, j]
    if form == "smooth":
        soft = 0.1 * log.arm.rated[j]
        size = np.sqrt(load**2 + soft**2) - soft
    else:
        size = np.abs(log.still[:, j] if form == "gravity" else load)
    return of_joint(log, j, "load-friction", "torque times direction", "1", 0.5,
                    size * np.tanh(log.session.dq[:, j] / log.arm.transition), form=form)  # fmt: skip


def asymmetric_friction(rng: np.random.Generator, log: Log, form: str) -> Act:
    """Friction that differs by direction: viscous, saturating, or of a power of the speed."""
    j = int(rng.integers(log.arm.size))
    speed = np.abs(log.session.dq[:, j])
    knee = float(rng.uniform(0.15, 0.4))
    shapes = {"viscous": speed, "saturating": speed / (1 + speed / knee), "power": speed**1.6}
    most = 4 * log.arm.viscous[j]
    return of_joint(log, j, "asymmetric-friction", "abs speed", "N m s/rad", most,
                    float(rng.choice([-1, 1])) * shapes[form], form=form)  # fmt: skip


def ripple(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A torque periodic in the angle: of the gear's turn, of its teeth, with a second or a near harmonic."""
    j = int(rng.integers(log.arm.size))
    q, gear = log.session.q[:, j], log.arm.gear[j]
    waves = {"motor turn": gear, "teeth": float(rng.integers(10, 41)), "two periods": 2 * gear}[form]
    waves = (
        waves if 2.5 * waves * np.quantile(np.abs(log.session.dq[:, j]), 0.5) < 2 * np.pi * 12 else waves / 2
    )
    phase, second = rng.uniform(0, 2 * np.pi, 2)
    share = float(rng.uniform(0.2, 0.6)) if rng.random() < 0.6 else 0.0
    again = 1.37 if form == "two periods" else 2.0
    wave = np.sin(waves * q + phase) + share * np.sin(again * waves * q + second)
    return of_joint(log, j, "ripple", "motor angle", "N m", 0.5 * log.arm.rated[j], wave, waves=waves,
                    phase=phase, second_share=share, form=form)  # fmt: skip


def torque_constant(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A torque constant that is off: of one joint, of the drives of a type, or less at high current."""
    n, j = log.arm.size, int(rng.integers(log.arm.size))
    same = [k for k in range(n) if log.arm.rated[k] == log.arm.rated[j]]
    joints = same if form == "drives of a type" else [j]
    shape = np.zeros_like(log.torque)
    shape[:, joints] = log.torque[:, joints]
    if form == "saturates":
        shape[:, j] *= np.abs(log.torque[:, j]) / log.arm.rated[j]
    where = [w for k in joints for w in place(f"joint {k + 1}", "torque", "torque-constant")]
    sign = float(rng.choice([-1, 1]))
    return scaled("torque-constant", form, where, "1", 0.9, sign * shape, log, joint=j + 1, sign=sign)


def torque_drift(rng: np.random.Generator, log: Log, form: str) -> Act:
    """An offset of the torque that drifts: with temperature, with time, or fast at first."""
    j, s = int(rng.integers(log.arm.size)), log.session
    time = (s.time - s.time[0]) / np.ptp(s.time)
    shapes = {"temperature": s.warm, "time": time, "fast at first": 1 - np.exp(-time / 0.25)}
    driver = "temperature" if form == "temperature" else "time"
    unit = "N m/K" if form == "temperature" else "N m"
    return of_joint(log, j, "torque-drift", driver, unit, 0.5 * log.arm.rated[j],
                    float(rng.choice([-1, 1])) * shapes[form], form=form)  # fmt: skip


def viscous_temperature(rng: np.random.Generator, log: Log, form: str) -> Act:
    """Viscous friction that falls as the grease warms: in proportion, exponentially, or with a lag."""
    j, s, arm = int(rng.integers(log.arm.size)), log.session, log.arm
    where = place(f"joint {j + 1}", "temperature times speed", "viscous-temperature")
    warm = s.warm
    if form == "late":
        late = np.interp(s.time - 0.12 * np.ptp(s.time), s.time, s.warm)
        warm = np.where(s.time - s.time[0] < 0.12 * np.ptp(s.time), 0.0, late)
    if form != "exponential":
        shape = alone(log, j, -arm.viscous[j] * warm * s.dq[:, j])
        return scaled(
            "viscous-temperature", form, where, "1/K", 1.2 / max(1e-3, s.warm.max()), shape, log, joint=j + 1
        )

    def apply(size: float) -> Change:
        return Change(alone(log, j, arm.viscous[j] * np.expm1(-size * warm) * s.dq[:, j]))

    return Act("viscous-temperature", form, where, "1/K", 0.01, 0.6, apply, {"joint": j + 1})


def delay(rng: np.random.Generator, log: Log, form: str) -> Act:
    """Torques later than positions, of all joints, one, or each by its own; positions later than commands."""
    if form == "command":
        return _late_servo(log) if log.stiffness is not None else delay(rng, log, "log")
    n = log.arm.size
    share, joint = np.ones(n), None
    if form == "one joint":
        joint = int(rng.integers(n))
        share = np.eye(n)[joint]
    elif form == "each":
        share = rng.uniform(0.4, 1.6, n)
    site = "log" if joint is None else f"joint {joint + 1}"
    rows = np.ones(len(log.torque))

    def apply(size: float) -> Change:
        return Change(log.at(size * rows[:, None] * share) - log.torque)

    detail = {"share": share.tolist()} | ({} if joint is None else {"joint": joint + 1})
    return Act("delay", form, place(site, "rate of torque", "delay"), "s", 2e-3, 0.06, apply, detail)


def _late_servo(log: Log) -> Act:
    """Return a position servo that acts on its commands of an earlier time."""
    s, stiffness, none = log.session, log.stiffness, np.zeros_like(log.torque)

    def apply(size: float) -> Change:
        later = log.at(np.full(len(s.time), -size)) - log.torque
        return Change(none, track=size * s.dq + size**2 / 2 * s.ddq + later / stiffness)

    where = place("log", "rate of the command", "delay")
    return Act("delay", "command", where, "s", 1e-4, 0.06, apply)


def servo_stiffness(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A position servo whose gain is not the stated one: of one joint, of all, or less at large errors."""
    n, j = log.arm.size, int(rng.integers(log.arm.size))
    assert log.stiffness is not None
    every = log.torque / log.stiffness
    error = np.zeros_like(every)
    joints = list(range(n)) if form == "all joints" else [j]
    error[:, joints] = every[:, joints]
    if form == "hardens":
        error[:, j] *= 1 - np.abs(every[:, j]) / np.abs(every[:, j]).max()
    sign = float(rng.choice([-1, 1]))
    where = [w for k in joints for w in place(f"joint {k + 1}", "torque", "servo-stiffness")]
    none = np.zeros_like(log.torque)

    def apply(size: float) -> Change:
        return Change(none, track=error * (1 / (1 - sign * size) - 1))

    return Act("servo-stiffness", form, where, "1", 0.02, 0.6, apply, {"joint": j + 1, "sign": sign})


DRIVE = {
    "stribeck": (stribeck, ("exponential", "Gaussian", "between")),
    "load-friction": (load_friction, ("absolute", "smooth", "gravity")),
    "asymmetric-friction": (asymmetric_friction, ("viscous", "saturating", "power")),
    "ripple": (ripple, ("motor turn", "teeth", "two periods")),
    "torque-constant": (torque_constant, ("one", "drives of a type", "saturates")),
    "torque-drift": (torque_drift, ("temperature", "time", "fast at first")),
    "viscous-temperature": (viscous_temperature, ("linear", "exponential", "late")),
    "delay": (delay, ("log", "one joint", "command", "each")),
    "servo-stiffness": (servo_stiffness, ("one", "all joints", "hardens")),
}
"""As `effects.BODY`."""
