"""The check of a joint log: its facts, findings, and what a diagnosis can assess.

Joints of a log that are interchanged, or whose torques have the opposite sense: the nominal arm tells.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.logs import Log, read_log
from bayescal.logs.read import TABLES
from bayescal.motion.controller import MISMATCHED, is_servo, unfollowed, with_torques
from bayescal.motion.dynamics import carried, regressor
from bayescal.motion.effects import EFFECTS
from bayescal.preparing import joint_facts, joint_findings
from bayescal.preparing.joint_delays import thinned, uniform
from bayescal.preparing.joint_facts import LOADS, SLOW, Joint, Stamps
from bayescal.preparing.missing import KINDS, Finding

ROWS = 400
"""Of a log, that decide (cost)."""
FACTOR = 4.0
"""Product of the factors by which the residuals of the joints fall, at least. Of 80 logs in the right order
it is 1.2 at most, of interchanged joints of a UR5e 60 and 160, of two links 6."""
DRIVES = 0.2
"""Share of the torque of a joint (RMS) by friction that drives its motion, at which its sign is wrong: 0.9
where it is; in 80 logs where it is not, friction resists the motion."""
SCALES = (0.2, 5.0)
"""Measured torque over that of the nominal masses: beyond, a unit, a gear or the sign is wrong (assumed)."""


def reversed_torques(log: Log, rows: Sequence[np.ndarray]) -> tuple[str, ...]:
    """Names of joints whose torques have the opposite sense: by them friction drives the motion."""
    q, v, a, torque, payload = rows
    by = regressor(log.mechanism, q, v, a, log.gravity)
    rigid = carried(by, log.mechanism.inertials, log.mechanism, payload)
    out, names = [], log.mechanism.joint_names
    for name, e, load, speed, rotor in zip(names, torque.T, rigid.T, v.T, a.T, strict=True):
        drivers = np.column_stack([np.tanh(speed / SLOW[1]), speed, load, rotor, np.ones(len(speed))])
        friction = drivers[:, :2] @ np.linalg.lstsq(drivers, e, rcond=None)[0][:2]
        if np.mean(friction * speed) < 0 and np.std(friction) > DRIVES * np.std(e):
            out.append(name)
    return tuple(out)


def interchanged(log: Log, rows: Sequence[np.ndarray]) -> str:
    """Two joints that are interchanged, in words, of all columns, positions or torques; "" if none are.

    Of the torques beside those of the nominal masses, friction and rotors.
    """
    (q, v, a, torque, payload), m = rows, log.mechanism

    def log_residual(order: list[int], of_torque: list[int]) -> float:
        """Sum over the joints of the logarithm of the residual (RMS)."""
        by = regressor(m, q[:, order], v[:, order], a[:, order], log.gravity)
        residual = torque[:, of_torque] - carried(by, m.inertials, m, payload)
        total = 0.0
        for e, speed, rotor in zip(residual.T, v[:, order].T, a[:, order].T, strict=True):
            drivers = np.column_stack([np.tanh(speed / SLOW[1]), speed, rotor, np.ones(len(speed))])
            e = e - drivers @ np.linalg.lstsq(drivers, e, rcond=None)[0]
            total += float(np.log(np.sqrt(np.mean(e**2)) + 1e-12))
        return total

    as_stated = list(range(log.n))
    stated, names = log_residual(as_stated, as_stated), m.joint_names
    candidates: list[tuple[float, str]] = []
    for i, k in combinations(as_stated, 2):
        other = as_stated.copy()
        other[i], other[k] = k, i
        cases = ("columns", other, other), ("positions", other, as_stated), ("torques", as_stated, other)
        for what, *orders in cases:
            candidates.append((log_residual(*orders), f"the {what} of {names[i]} and {names[k]}"))
    best = min(candidates, default=(stated, ""))
    return best[1] if stated - best[0] > np.log(FACTOR) else ""


@dataclass(frozen=True)
class LogCheck:
    """What is known of a joint log before a diagnosis.

    Attributes
    ----------
    log : Log
    joints : tuple of Joint
    stamps : Stamps
    assessed : tuple of str
        Effects that a diagnosis can assess.
    not_assessed : dict of str to str
        Those that it cannot, with what would make them assessable.
    findings : tuple of Finding
        In the order of `KINDS`.
    """

    log: Log
    joints: tuple[Joint, ...]
    stamps: Stamps
    assessed: tuple[str, ...]
    not_assessed: dict[str, str]
    findings: tuple[Finding, ...]

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.log.name


def check_log(folder: Path, calibrations: Sequence[Path] = ()) -> LogCheck:
    """Check a joint log without a diagnosis.

    Parameters
    ----------
    folder : Path
    calibrations : sequence of Path
        Calibrations of LeRobot: that of the log, and others to compare with it.

    Raises
    ------
    BayescalError
        If a file cannot be read: stamps that go back, corrupt values, fewer than two motions, ...
    """
    log = read_log(folder)
    table = next(name for name in TABLES if (folder / name).exists())
    parts = log.divided if log.divided.motions else log  # `fit` and `gap` refuse one without any
    joints, stamps = joint_facts.joints_of(parts), joint_facts.stamps_of(log, table)
    findings = [*joint_findings.odd(log, joints, stamps, table)]
    findings += joint_findings.servo_odd(log, joints, table, calibrations)
    findings += joint_findings.missing(log, joints, table)
    wrong = [*mistaken(log, table)]
    if any(f.code == "command" for f in wrong):  # no joint sags then
        findings = [f for f in findings if f.code != "sag"]
    findings = [*wrong, *findings]
    why = not_assessed(log, joints)
    assessed = tuple(name for name in EFFECTS if name not in why)
    order = sorted(findings, key=lambda f: KINDS.index(f.kind))
    return LogCheck(log, joints, stamps, assessed, why, tuple(order))


def mistaken(log: Log, table: str = "") -> Iterator[Finding]:
    """Columns of another sign, order or unit, by the nominal arm and the other columns.

    Parameters
    ----------
    log : Log
    table : str
        File of the rows, for places.
    """
    if wrong := unfollowed(log):
        yield Finding("command", "refused" if is_servo(log) else "odd", wrong, table, MISMATCHED)
    parts = log.divided if log.divided.motions else log  # `fit` and `gap` refuse one without any
    even = [uniform(m) for m in parts.motions]
    if any(e.torque is None for e in even):
        return
    rows = thinned(parts, even, ROWS)
    names = reversed_torques(parts, rows) if log.signed else ()
    if names:
        yield joint_findings.said("odd", "torque_sign", table, names=listed(names))
    elif which := interchanged(parts, rows):
        yield joint_findings.said("odd", "order", table, which=which)
        return
    gains = zip(log.mechanism.joint_names, joint_facts.torque_gains(parts, even), strict=True)
    off = [(n, g) for n, g in gains if (g < SCALES[0] or g > SCALES[1]) and n not in names]
    if off:
        each = ", ".join(f"{name} {gain:.3g}" for name, gain in off)
        yield joint_findings.said("odd", "torque_scale", table, each=each)


STEADY = 1.0
"""K: a temperature that varies less shows no drift (assumed: ten times the noise of a thermometer)."""


def not_assessed(log: Log, joints: Sequence[Joint]) -> dict[str, str]:
    """Effects that a diagnosis cannot assess, and why: by columns of the log, or by what motions excite."""
    if is_servo(log):
        try:
            log = with_torques(log)
        except BayescalError as error:
            return dict.fromkeys(EFFECTS, f"{error.what}: {error.remedy}")
    if log.motions[0].torque is None:
        why = "no torques with a sign: log them" if log.torque_kind else "no torques: log torques or currents"
        return dict.fromkeys(EFFECTS, why)
    unexcited = _unexcited(log, joints)
    reasons = {name: effect.lacks(log) or unexcited.get(name, "") for name, effect in EFFECTS.items()}
    return {name: why for name, why in reasons.items() if why}


def _unexcited(log: Log, joints: Sequence[Joint]) -> dict[str, str]:
    """What the motions lack for some effects, with how to record it; "" if nothing."""
    loaded, warm = joint_findings.gravity_loaded(joints), joint_findings.warm_up(log)
    varied = any(j.gravity[1] >= LOADS * abs(j.gravity[0]) for j in loaded)
    poses = "" if varied else "gravity loads the joints in one pose: move them in two or more"
    moved = "" if any(j.fastest > SLOW[1] for j in joints) else "no joint moves: log motions"
    few = f"speeds below {SLOW[1]:g} rad/s are too few: reverse slowly"
    constant = "" if any(m.loaded for m in log.motions) else poses
    if log.torque_kind == "sensor":
        constant = "torques are those of a sensor: it has no torque constant"
    varies = f"the temperature varies by {warm:.2g} K: log {joint_findings.WARM:g} K of warm-up"
    steady = varies if warm < STEADY else ""
    return {
        "inertia": moved, "armature": moved, "asymmetric-friction": moved,
        "stribeck": "" if any(j.slow >= joint_findings.CROSSINGS for j in joints) else few,
        "load-friction": poses, "torque-constant": constant, "torque-drift": steady,
        "viscous-temperature": steady,
        "base-tilt": "" if len(loaded) > 1 else "gravity loads fewer than two joints",
    }  # fmt: skip


def log_record(of: LogCheck) -> dict[str, Any]:
    """The content of `bayescal check --to json` of a joint log; null where a value is not known."""
    log = of.log
    motions = [
        {"id": m.name, "role": m.role, "kind": m.kind, "same_as": m.same_as, "rows": len(m.time)}
        | {"duration_s": _plain(m.time[-1] - m.time[0]), "payload_kg": _plain(np.median(m.payload))}
        for m in log.motions
    ]
    stamps, (drift, u_drift) = of.stamps, joint_findings.clock_drift(of.joints)
    return {
        "schema": "bayescal-motion-check/1", "dataset": log.name, "sha256": log.digest,
        "robot": {"name": log.mechanism.name, "joints": log.n}, "rows": sum(len(m.time) for m in log.motions),
        "columns": [name for name in COLUMNS if getattr(log.motions[0], name) is not None],
        "torque": {"kind": log.torque_kind, "signed": log.signed},
        "stamps": {
            "step_ms": _plain(1e3 * stamps.step),
            "jitter": _plain(stamps.jitter),
            "longest_ms": _plain(1e3 * stamps.longest),
            "gaps": stamps.gaps,
        },
        "clock_drift_us_per_s": {"value": _plain(1e6 * drift), "u": _plain(1e6 * u_drift)},
        "temperature_range_K": _plain(joint_findings.warm_up(log)), "motions": motions,
        "joints": [_joint_record(j) for j in of.joints], "assumed": list(log.notes),
        "assessed": list(of.assessed), "not_assessed": of.not_assessed,
        "findings": [vars(f) for f in of.findings],
    }  # fmt: skip


COLUMNS = ("position", "velocity", "command", "torque", "link", "temperature")
"""Of a `Motion`, which may be absent."""


def _joint_record(j: Joint) -> dict[str, Any]:
    delays = {"torque": j.torque_delay, "velocity": j.velocity_delay}
    delays |= {"position_after_command": j.command_delay}
    return {
        "name": j.name,
        "range_deg": [_plain(np.degrees(j.lowest)), _plain(np.degrees(j.highest))],
        "fastest_rad_per_s": _plain(j.fastest),
        "at_rest": _plain(j.at_rest),
        "slow_s": _plain(j.slow),
        "gravity_Nm": {"mean": _plain(j.gravity[0]), "sd": _plain(j.gravity[1])},
        "delay_ms": {k: {"value": _plain(1e3 * v), "u": _plain(1e3 * u)} for k, (v, u) in delays.items()},
        "velocity_cutoff_Hz": _plain(j.velocity_cutoff),
        "torque_filtered_above_Hz": _plain(j.torque_band),
        "tracking_rms_deg": _plain(np.degrees(j.command_error)),
        "torque_limit_Nm": _plain(j.clipped),
    }


def _plain(value: Any) -> float | None:
    """A number to six digits; None if it is not finite."""
    return float(f"{float(value):.6g}") if np.isfinite(value) else None
