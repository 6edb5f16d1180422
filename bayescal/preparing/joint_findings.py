"""Findings on a joint log: what is probably a mistake of the recording, and what it lacks.

Of servos: jumps of positions, zeros that differ, and sag of the joints at rest.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayescal.errors import listed
from bayescal.logs import Log, Motion
from bayescal.motion.controller import is_servo
from bayescal.preparing import joint_facts
from bayescal.preparing.joint_delays import speeds
from bayescal.preparing.joint_facts import CERTAIN, LOADS, SHORTEST, SLOW, Joint, Stamps, is_late
from bayescal.preparing.missing import TEXTS, Finding
from bayescal.robots.servos import STEP, STEPS, of_joints, read_calibration, zero_shift

said = partial(Finding.said, TEXTS["logs"])
CROSSINGS = 2.0
"""s in all at `SLOW` speeds that show it (assumed)."""
FAST = 1.0
"""rad/s, that separates viscous friction from an offset."""
WARM = 10.0
"""K, of warm-up."""
MOTIONS, LENGTH, REPEATS = 6, 10.0, 3
"""Motions of so many s, and repeats of one, for a noise model and withheld motions (assumed)."""
DRIFTS = 4.0
"""Standard uncertainties of a drift, by few motions."""
GAINS, FILTERED = (0.9, 1.1), (0.6, 1.6)
"""Measured velocity over the derivative of the position: beyond, a unit is wrong; of a filtered one, whose
gain at rest is extrapolated."""
SHARE = 0.01
"""Of the largest torque of gravity of any joint: what makes a joint one that gravity loads."""
LAGS = (2.0, 3.0)
"""Rows for which a value is held, and acceleration at the end of a motion over that within, that are odd."""


def clock_drift(joints: Sequence[Joint]) -> tuple[float, float]:
    """Change of the delay of torques with time, s/s, and its u; nan with fewer than four pieces of motions.

    By least squares on the delays of all joints, each less its mean.
    """
    late = [j.torque_delays for j in joints if j.torque_delays.shape[1] >= 4 and j.torque_delays[2].any()]
    if not late:
        return np.nan, np.nan
    time, weight = late[0][0], np.sum([w for _, _, w in late], axis=0)
    values = np.sum([w * (v - w @ v / w.sum()) for _, v, w in late], axis=0) / np.maximum(weight, 1e-300)
    time = time - weight @ time / weight.sum()
    information = weight @ time**2
    slope = float(weight * time @ values / information)
    residual = values - weight @ values / weight.sum() - slope * time
    free = max(int(np.count_nonzero(weight)) - 2, 1)
    return slope, float(np.sqrt(weight @ residual**2 / free / information))


def gravity_loaded(joints: Sequence[Joint]) -> list[Joint]:
    """Joints that gravity loads."""
    most = max(abs(j.gravity[0]) + j.gravity[1] for j in joints)
    return [j for j in joints if abs(j.gravity[0]) + j.gravity[1] > SHARE * most]


def warm_up(log: Log) -> float:
    """Range of the temperature, K; nan without one."""
    values = [m.temperature for m in log.motions if m.temperature is not None]
    return float(np.ptp(np.concatenate(values))) if values else np.nan


def odd(log: Log, joints: Sequence[Joint], stamps: Stamps, table: str) -> Iterator[Finding]:
    """What is probably a mistake of the recording."""
    if stamps.gaps:
        s = "s" * (stamps.gaps > 1)
        yield said("odd", "gaps", stamps.where, of=stamps, s=s, ms=1e3 * stamps.step)
    if stamps.jitter > joint_facts.JITTER:
        yield said("odd", "jitter", table, share=100 * stamps.jitter, ms=1e3 * stamps.step)
    yield from _clocks(log, joints, table)
    for joint in joints:
        if np.isfinite(joint.clipped):
            yield said("odd", "clipped", table, j=joint)
        if joint.held > LAGS[0]:
            yield said("odd", "held", table, j=joint)
        low, high = FILTERED if np.isfinite(joint.velocity_cutoff) else GAINS
        if np.isfinite(joint.velocity_gain) and not low < joint.velocity_gain < high:
            yield said("odd", "velocity", table, j=joint)
    for name in ("velocity", "command", "torque"):
        stuck = zip(joints, _span(log, name) == 0, strict=True)
        if dead := [j.name for j, constant in stuck if constant and j.fastest > SLOW[0]]:
            yield said("odd", "constant", table, quantity=name, names=listed(dead))
    for name, share in log.coarse.items():
        if share < 1.0:
            yield said("odd", "coarse", table, name=name, share=100 * share)
    spans = {name: _span(log, name) for name in ("position", "velocity", "torque")}
    for motion in log.motions:
        yield from _corrupt(motion, spans, table)


def _clocks(log: Log, joints: Sequence[Joint], table: str) -> Iterator[Finding]:
    """Delays between torque, velocity and position."""
    delays = [(k, *j.torque_delay) for k, j in enumerate(joints) if np.isfinite(j.torque_delay).all()]
    if delays:
        _, values, u = (np.array(column) for column in zip(*delays, strict=True))
        u_mean = float(u.min())  # what is missing in the drivers is alike for all joints
        order = np.argsort(values)
        half = np.searchsorted(np.cumsum(u[order] ** -2.0), 0.5 * np.sum(u**-2.0))
        off = np.abs(values - values[order][half])  # from the weighted median: one joint may differ
        away = off > np.maximum(CERTAIN * np.hypot(u, u_mean), SHORTEST)
        mean = float(np.sum((values / u**2)[~away]) / np.sum(u[~away] ** -2))
        beyond = abs(mean - log.alignment)
        if beyond > max(CERTAIN * float(np.hypot(u_mean, log.u_alignment)), SHORTEST):
            sizes = {"mean": 1e3 * mean, "size": 1e3 * abs(mean), "u": 1e3 * u_mean}
            sizes |= {"stated": 1e3 * log.alignment, "u_stated": 1e3 * log.u_alignment}
            yield said("odd", "delay", table, way="later" if mean > 0 else "earlier", **sizes)
        if away.any():
            late = [f"{joints[delays[k][0]].name} {1e3 * values[k]:.2g} ms" for k in np.flatnonzero(away)]
            yield said("odd", "joint_delay", table, each=", ".join(late), mean=1e3 * mean)
    slope, u_slope = clock_drift(joints)
    span = np.ptp([m.time.mean() for m in log.motions])
    if abs(slope) > DRIFTS * u_slope and abs(slope) * span > SHORTEST:
        over = 1e3 * slope * span
        yield said("odd", "clock_drift", table, slope=1e6 * slope, u=1e6 * u_slope, over=over)
    if lag := [j for j in joints if is_late(*j.velocity_delay)]:
        each = ", ".join(f"{j.name} {1e3 * j.velocity_delay[0]:.3g} ms" for j in lag)
        yield said("odd", "velocity_delay", table, each=each)


def _span(log: Log, name: str) -> np.ndarray:
    """Range (n,) of a quantity over all motions; nan if it was not measured."""
    parts = [values for m in log.motions if (values := getattr(m, name)) is not None]
    return np.ptp(np.concatenate(parts), axis=0) if parts else np.full(log.n, np.nan)


def _corrupt(motion: Motion, spans: Mapping[str, np.ndarray], table: str) -> Iterator[Finding]:
    """Single values that are far from their neighbours, and ends with accelerations that no motion has."""
    for name, span in spans.items():
        values = getattr(motion, name)
        if values is not None and len(rows := joint_facts.spikes(values, span)):
            where = f"{table}:{motion.line + rows[0]}"
            yield said("odd", "spikes", where, count=len(rows), motion=motion.name, quantity=name)
    derived = np.gradient(motion.position, motion.time, axis=0)
    rate = derived if motion.velocity is None else motion.velocity
    acceleration = np.abs(np.diff(rate, axis=0) / np.diff(motion.time)[:, None])
    within = np.maximum(np.percentile(acceleration[4:-4], 99.5, axis=0), 1e-9)
    for end, rows in (("begins", acceleration[:2]), ("ends", acceleration[-2:])):
        if np.any((rows > LAGS[1] * within) & (rows > FAST)):
            line = motion.line + (0 if end == "begins" else len(motion.time) - 1)
            times = float(np.max(rows / within))
            yield said("odd", "ends", f"{table}:{line}", motion=motion.name, end=end, times=times)


def missing(log: Log, joints: Sequence[Joint], table: str) -> Iterator[Finding]:
    """What the log lacks so that less can be assessed."""
    motions, where = log.motions, "dataset.yaml"
    if is_servo(log):
        yield said("missing", "no_torque", table)
    elif not log.torque_kind:
        yield said("refused", "no_torque", table)
    elif not log.signed or motions[0].torque is None:
        yield said("refused", "unsigned", table)
    if not log.of_role("validate"):
        yield said("missing", "no_validation", where)
    elif {m.kind for m in log.of_role("validate")} <= {m.kind for m in log.of_role("calibrate")}:
        yield said("missing", "same_kind", where)
    most = max(sum(m.same_as == name for m in motions) for name in {m.same_as for m in motions})
    if most < REPEATS:
        yield said("missing", "no_repeat", where, times=" three times" if most > 1 else "")
    short = [m.name for m in motions if m.time[-1] - m.time[0] < LENGTH]
    if len(motions) < MOTIONS or len(short) > len(motions) / 2:
        counts = {"count": len(motions), "short": len(short), "least": MOTIONS}
        yield said("missing", "few_motions", table, **counts, length=LENGTH)
    if still := [j.name for j in joints if j.fastest <= SLOW[0]]:
        yield said("missing", "resting", table, names=listed(still))
    moved = [j for j in joints if j.name not in still]
    if slow := [j.name for j in moved if j.slow < CROSSINGS]:
        yield said("missing", "no_slow", table, names=listed(slow), least=CROSSINGS, slow=SLOW[1])
    if slack := [j.name for j in moved if j.fastest < FAST]:
        yield said("missing", "no_fast", table, names=listed(slack), fast=FAST)
    if poses := [j.name for j in gravity_loaded(joints) if j.gravity[1] < LOADS * abs(j.gravity[0])]:
        yield said("missing", "one_pose", table, names=listed(poses))
    loads = [m.loaded for m in motions]
    changes = sum(a != b for a, b in pairwise(loads))
    if changes == 0:
        what = "all motions carry the payload" if all(loads) else "no motion carries a payload"
        yield said("missing", "no_loads", table, what=what)
    elif changes == 1:
        yield said("missing", "load_order", table)
    warm = warm_up(log)
    if np.isnan(warm):
        yield said("missing", "no_temperature", table)
    elif warm < WARM:
        yield said("missing", "no_warm_up", table, warm=warm, least=WARM)
    if motions[0].command is None:
        yield said("missing", "no_command", table)


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
    spikes = joint_facts.spikes(motion.position, _span(log, "position"))
    beyond[[row + k for row in spikes for k in (-1, 0) if 0 <= row + k < len(beyond)]] = False
    rows = np.flatnonzero(beyond.any(axis=1))
    if len(rows) == 0:
        return
    j = int(np.argmax(np.abs(change[rows[0]]) * beyond[rows[0]]))
    size = float(change[rows[0], j])
    turns = _whole(size)
    name = log.mechanism.joint_names[j]
    more = (f" ({len(rows)} such rows)" if len(rows) > 1 else "") + (f": {turns}" if turns else "")
    remedy = f"its reading wraps at {STEPS} steps: turn it back" if turns else "divide the motion there"
    jump = {"name": name, "size": np.degrees(size), "motion": motion.name, "more": more, "remedy": remedy}
    yield said("odd", "jump", f"{table}:{motion.line + int(rows[0]) + 1}", **jump)


def _turned(log: Log, table: str) -> Iterator[Finding]:
    """Motions whose readings are half a turn, or a turn, from those of the others."""
    middles = np.array([np.median(m.position, axis=0) for m in log.motions])
    spans = np.array([np.ptp(m.position, axis=0) for m in log.motions])
    usual = np.median(middles, axis=0)
    for j, name in enumerate(log.mechanism.joint_names):
        each = zip((middles[:, j] - usual[j]).tolist(), spans[:, j], strict=True)
        kinds = [_whole(x) if span < 0.25 * TURN else "" for x, span in each]
        for turns in dict.fromkeys(filter(None, kinds)):
            which = [k for k, kind in enumerate(kinds) if kind == turns]
            motions = listed([log.motions[k].name for k in which])
            where = f"{table}:{log.motions[which[0]].line}"
            yield said("odd", "turned", where, name=name, turns=turns, motions=motions)


def _sag(log: Log, joints: Sequence[Joint], table: str) -> Iterator[Finding]:
    """Joints that rest away from their commands, gravity loads them or not."""
    if log.motions[0].command is None:
        return
    seconds, off = np.zeros(log.n), [np.empty(0)] * log.n
    for m in log.motions:
        assert m.command is not None
        still = np.abs(speeds(m.time, m.position)) <= SLOW[0]
        still &= np.abs(speeds(m.time, m.command)) <= SLOW[0]
        seconds += (still * np.gradient(m.time)[:, None]).sum(axis=0)
        away = m.position - m.command
        off = [np.concatenate([old, away[still[:, j], j]]) for j, old in enumerate(off)]
    loaded = {joint.name for joint in gravity_loaded(joints)}
    for joint, values, rested in zip(joints, off, seconds.tolist(), strict=True):
        if rested < RESTING or abs(mean := float(values.mean())) < SAGS:
            continue
        low, high = np.degrees(np.percentile(values, (5, 95)))
        more = f": it sags, gravity loads it with {joint.gravity[0]:.2g} N m on average"
        sizes = {"mean": np.degrees(mean), "low": low, "high": high, "rested": rested}
        yield said("odd", "sag", table, j=joint, **sizes, more=more if joint.name in loaded else "")


def _zeros(log: Log, joints: Sequence[Joint], calibrations: Sequence[Path]) -> Iterator[Finding]:
    """Differences of the zeros of calibrations, and readings beyond the range of the first one."""
    names = log.mechanism.joint_names
    by_file = [(path.name, of_joints(read_calibration(path), names, path.name)) for path in calibrations]
    if not by_file:
        return
    first, servos = by_file[0]
    for joint, servo in zip(joints, servos, strict=True):
        half = 0.5 * (servo.range_max - servo.range_min) * STEP
        beyond = max(joint.highest, -joint.lowest) - half
        if beyond > NEAR:
            yield said("odd", "range", first, j=joint, beyond=np.degrees(beyond))
    for other, theirs in by_file[1:]:
        for name, one, two in zip(names, servos, theirs, strict=True):
            steps = zero_shift(one, two)
            if abs(steps) > APART:
                more = f": {turns}" if (turns := _whole(steps * STEP)) else ""
                shift = {"deg": np.degrees(steps * STEP), "steps": steps, "other": other, "first": first}
                yield said("odd", "zero", other, name=name, **shift, more=more)
