"""Findings on the positions of servos: jumps, zeros that differ, and sag of the joints at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bayescal.errors import listed
from bayescal.logs import Log, Motion
from bayescal.preparing import signals
from bayescal.preparing.joint_facts import SLOW, Joint, gravity_loaded
from bayescal.preparing.missing import Finding
from bayescal.robots.servos import STEP, STEPS, of_joints, read_calibration, zero_shift

TURN = 2.0 * np.pi
FASTEST = 15.0
"""rad/s: largest speed where the robot states none (assumed: twice that of a servo)."""
SMALLEST = np.radians(5.0)
"""A jump that is smaller is not one: reading noise over a short step."""
SAGS = np.radians(0.5)
"""Distance from the command at rest: six steps of a servo, as much as its backlash (assumed)."""
RESTING = 0.5
"""s at rest in all, without which no sag is stated."""
NEAR = np.radians(10.0)
"""How far a shift between motions may be from half a turn or a turn."""
APART = 30
"""Steps by which the zeros of two calibrations may differ: repeatability of the pose by hand (assumed)."""


def servo_odd(
    log: Log, joints: Sequence[Joint], table: str, calibrations: Sequence[Path]
) -> Iterator[Finding]:
    """What is probably a mistake of servos, or of their calibrations.

    Parameters
    ----------
    log : Log
    joints : sequence of Joint
    table : str
        File of the rows, for places.
    calibrations : sequence of Path
        Calibrations of LeRobot: that of the log, and others that are compared with it.
    """
    for motion in log.motions:
        yield from _jumps(log, motion, table)
    yield from _turned(log, table)
    yield from _sag(log, joints, table)
    yield from _zeros(log, joints, calibrations)


def _whole(angle: float) -> str:
    """In words which part of a turn an angle is; "" if it is none."""
    for turns, words in ((0.5, "half a turn"), (1.0, "a whole turn")):
        if abs(abs(angle) - turns * TURN) < NEAR:
            return words
    return ""


def _jumps(log: Log, motion: Motion, table: str) -> Iterator[Finding]:
    """Steps from one row to the next that no joint makes, and that are not taken back in the row behind."""
    fastest = np.where(np.isnan(log.mechanism.fastest), FASTEST, 2.0 * log.mechanism.fastest)
    change = np.diff(motion.position, axis=0)
    beyond = np.abs(change) > np.maximum(fastest * np.diff(motion.time)[:, None], SMALLEST)
    spikes = signals.spikes(motion.position)
    beyond[[row + k for row in spikes for k in (-1, 0) if 0 <= row + k < len(beyond)]] = False
    rows = np.flatnonzero(beyond.any(axis=1))
    if len(rows) == 0:
        return
    j = int(np.argmax(np.abs(change[rows[0]]) * beyond[rows[0]]))
    size = float(change[rows[0], j])
    turns = _whole(size)
    name = log.mechanism.joint_names[j]
    what = f"{name} jumps by {np.degrees(size):.1f} deg in one row of motion {motion.name}"
    what += f" ({len(rows)} such rows)" if len(rows) > 1 else ""
    what += f": {turns}" if turns else ""
    remedy = f"its reading wraps at {STEPS} steps: turn it back" if turns else "divide the motion there"
    yield Finding("jump", "odd", what, f"{table}:{motion.line + int(rows[0]) + 1}", remedy)


def _turned(log: Log, table: str) -> Iterator[Finding]:
    """Motions whose readings are half a turn, or a turn, from those of the others."""
    middles = np.array([np.median(m.position, axis=0) for m in log.motions])
    spans = np.array([np.ptp(m.position, axis=0) for m in log.motions])
    usual = np.median(middles, axis=0)
    for j, name in enumerate(log.mechanism.joint_names):
        away = middles[:, j] - usual[j]
        each = zip(away.tolist(), spans[:, j], strict=True)
        kinds = [_whole(x) if span < 0.25 * TURN else "" for x, span in each]
        for turns in dict.fromkeys(filter(None, kinds)):
            which = [k for k, kind in enumerate(kinds) if kind == turns]
            motions = listed([log.motions[k].name for k in which])
            what = f"{name} is {turns} from its other motions in {motions}: zero of another calibration?"
            where = f"{table}:{log.motions[which[0]].line}"
            remedy = "give motions of one calibration, or import the others with their own (--calibration)"
            yield Finding("turned", "odd", what, where, remedy)


def _sag(log: Log, joints: Sequence[Joint], table: str) -> Iterator[Finding]:
    """Joints that rest away from their commands, gravity loads them or not."""
    if log.motions[0].command is None:
        return
    seconds, off = np.zeros(log.n), [np.empty(0)] * log.n
    for m in log.motions:
        assert m.command is not None
        still = np.abs(signals.speeds(m.time, m.position)) <= SLOW[0]
        still &= np.abs(signals.speeds(m.time, m.command)) <= SLOW[0]
        seconds += (still * np.gradient(m.time)[:, None]).sum(axis=0)
        away = m.position - m.command
        off = [np.concatenate([old, away[still[:, j], j]]) for j, old in enumerate(off)]
    loaded = {joint.name for joint in gravity_loaded(joints)}
    for joint, values, rested in zip(joints, off, seconds.tolist(), strict=True):
        if rested < RESTING or abs(mean := float(values.mean())) < SAGS:
            continue
        low, high = np.degrees(np.percentile(values, (5, 95)))
        what = f"{joint.name} rests {np.degrees(mean):.2f} deg from its command ({low:.2f} to {high:.2f} in "
        what += f"{rested:.0f} s at rest)"
        if joint.name in loaded:
            what += f": it sags, gravity loads it with {joint.gravity[0]:.2g} N m on average"
        remedy = "use positions as readings, not commands; a larger gain of the servo reduces it"
        yield Finding("sag", "odd", what, table, remedy)


def _zeros(log: Log, joints: Sequence[Joint], calibrations: Sequence[Path]) -> Iterator[Finding]:
    """Differences of the zeros of calibrations, and readings beyond the range of the first one."""
    names = log.mechanism.joint_names
    known = [(path.name, of_joints(read_calibration(path), names, path.name)) for path in calibrations]
    if not known:
        return
    first, servos = known[0]
    for joint, servo in zip(joints, servos, strict=True):
        half = 0.5 * (servo.range_max - servo.range_min) * STEP
        beyond = max(joint.highest, -joint.lowest) - half
        if beyond > NEAR:
            what = f"{joint.name} is up to {np.degrees(beyond):.1f} deg beyond its range in the calibration"
            yield Finding("range", "odd", what, first, "is it the calibration of this log?")
    for other, theirs in known[1:]:
        for name, one, two in zip(names, servos, theirs, strict=True):
            steps = zero_shift(one, two)
            if abs(steps) > APART:
                turns = _whole(steps * STEP)
                what = f"at one pose {name} reads {np.degrees(steps * STEP):+.2f} deg ({steps:+g} steps)"
                what += f" more by {other} than by {first} (Feetech servos)" + (f": {turns}" if turns else "")
                remedy = "calibrate at the same middle pose, or import each log with its own calibration"
                yield Finding("zero", "odd", what, other, remedy)
