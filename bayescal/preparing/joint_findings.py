"""Findings on a joint log: what is probably a mistake of the recording, and what it lacks.

Of servos: jumps of positions, zeros that differ, and sag of the joints at rest.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayescal.errors import listed
from bayescal.logs import Log, Motion
from bayescal.motion.controller import is_servo
from bayescal.preparing import joint_facts
from bayescal.preparing.joint_delays import speeds
from bayescal.preparing.joint_facts import CERTAIN, LOADS, SHORTEST, SLOW, Joint, Stamps, is_late
from bayescal.preparing.missing import Finding
from bayescal.robots.servos import STEP, STEPS, of_joints, read_calibration, zero_shift

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
SCALES = (0.2, 5.0)
"""Measured torque over that of the nominal masses: beyond, a unit, a gear or the sign is wrong (assumed)."""
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
        what = f"{stamps.gaps} gap{'s' * (stamps.gaps > 1)} in the stamps, the longest {stamps.longest:.3g} s"
        what += f" (step {1e3 * stamps.step:.3g} ms)"
        yield Finding("gaps", "odd", what, stamps.where, "log without loss; motions are divided there")
    if stamps.jitter > joint_facts.JITTER:
        what = f"steps scatter by {100 * stamps.jitter:.2g} % of {1e3 * stamps.step:.3g} ms: stamps count"
        yield Finding("jitter", "odd", what, table, "log the time of measurement, not that of arrival")
    yield from _clocks(log, joints, table)
    if wrong := [j for j in joints if j.torque_gain < SCALES[0] or j.torque_gain > SCALES[1]]:
        each = ", ".join(f"{j.name} {j.torque_gain:.3g}" for j in wrong)
        what = f"torques over those of the nominal masses: {each} (1 expected)"
        remedy = "check unit (N m), sign and gear ratio of the torques, and the masses of the robot"
        yield Finding("torque_scale", "odd", what, table, remedy)
    for joint in joints:
        if np.isfinite(joint.clipped):
            what = f"the torque of {joint.name} is limited at {joint.clipped:.4g} N m, a row there is none"
            yield Finding("clipped", "odd", what, table, "move slower, or raise the limit of the signal")
        if joint.held > LAGS[0]:
            what = f"positions of {joint.name} are held for {joint.held:.2g} rows: their rate is lower"
            yield Finding("held", "odd", what, table, "log at the rate of the controller, with its stamps")
        low, high = FILTERED if np.isfinite(joint.velocity_cutoff) else GAINS
        if np.isfinite(joint.velocity_gain) and not low < joint.velocity_gain < high:
            what = f"the velocity of {joint.name} is {joint.velocity_gain:.3g} times that of its positions"
            yield Finding("velocity", "odd", what, table, "check the unit of `dq..._degps`, and the stamps")
    for name in ("velocity", "command", "torque"):
        parts = [values for m in log.motions if (values := getattr(m, name)) is not None]
        still = np.ptp(np.concatenate(parts), axis=0) == 0 if parts else ()
        stuck = (j for j, constant in zip(joints, still, strict=False) if constant)
        if dead := [j.name for j in stuck if j.fastest > SLOW[0]]:
            what = f"the {name} of {listed(dead)} never changes though the joint moves"
            yield Finding("constant", "odd", what, table, "is the signal connected? remove the column if not")
    for name, share in log.coarse.items():
        if share < 1.0:
            rows = f"{100 * share:.0f} % of the rows in which it moves"
            what = f"the torque of {name} is one and the same in {rows}"
            yield Finding("coarse", "odd", what, table, "log it with more digits, or leave this joint out")
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
            way = "later" if mean > 0 else "earlier"
            what = f"torques are {1e3 * abs(mean):.2f} ms (u {1e3 * u_mean:.2f}) {way} than positions; "
            what += f"stated is {1e3 * log.alignment:.4g} ms (u {1e3 * log.u_alignment:.2g})"
            remedy = f"two clocks? state `alignment_ms: {1e3 * mean:.2f}`; else `delay` is assessed"
            yield Finding("delay", "odd", what, table, remedy)
        if away.any():
            late = [f"{joints[delays[k][0]].name} {1e3 * values[k]:.2g} ms" for k in np.flatnonzero(away)]
            what = f"the delay of torque differs by joint: {', '.join(late)}; the others {1e3 * mean:.2g} ms"
            yield Finding("joint_delay", "odd", what, table, "one alignment does not hold for all joints")
    slope, u_slope = clock_drift(joints)
    span = np.ptp([m.time.mean() for m in log.motions])
    if abs(slope) > DRIFTS * u_slope and abs(slope) * span > SHORTEST:
        what = f"the delay of torques changes by {1e6 * slope:.2g} µs/s (u {1e6 * u_slope:.1g}), "
        what += f"{1e3 * slope * span:.2g} ms over the log: two clocks of different rates"
        yield Finding("clock_drift", "odd", what, table, "take torque and position from one message or clock")
    lag = [j for j in joints if is_late(*j.velocity_delay)]
    if lag:
        each = ", ".join(f"{j.name} {1e3 * j.velocity_delay[0]:.3g} ms" for j in lag)
        what = f"velocities are later than the derivative of positions: {each}"
        remedy = "they are filtered, or of another clock: see the table"
        yield Finding("velocity_delay", "odd", what, table, remedy)


def _span(log: Log, name: str) -> np.ndarray:
    """Range (n,) of a quantity over all motions; 0 if it was not measured."""
    parts = [values for m in log.motions if (values := getattr(m, name)) is not None]
    return np.ptp(np.concatenate(parts), axis=0) if parts else np.zeros(log.n)


def _corrupt(motion: Motion, spans: Mapping[str, np.ndarray], table: str) -> Iterator[Finding]:
    """Single values that are far from their neighbours, and ends with accelerations that no motion has."""
    for name, span in spans.items():
        values = getattr(motion, name)
        if values is not None and len(rows := joint_facts.spikes(values, span)):
            what = f"{len(rows)} rows of motion {motion.name} with a {name} far from their neighbours"
            where = f"{table}:{motion.line + rows[0]}"
            yield Finding("spikes", "odd", what, where, "remove these rows: they are corrupt")
    derived = np.gradient(motion.position, motion.time, axis=0)
    rate = derived if motion.velocity is None else motion.velocity
    acceleration = np.abs(np.diff(rate, axis=0) / np.diff(motion.time)[:, None])
    within = np.maximum(np.percentile(acceleration[4:-4], 99.5, axis=0), 1e-9)
    for end, rows in (("begins", acceleration[:2]), ("ends", acceleration[-2:])):
        if np.any((rows > LAGS[1] * within) & (rows > FAST)):
            line = motion.line + (0 if end == "begins" else len(motion.time) - 1)
            times = float(np.max(rows / within))
            what = f"motion {motion.name} {end} with {times:.2g} times the acceleration within"
            yield Finding("ends", "odd", what, f"{table}:{line}", "remove its first or last rows")


def missing(log: Log, joints: Sequence[Joint], table: str) -> Iterator[Finding]:
    """What the log lacks so that less can be assessed."""
    motions, where = log.motions, "dataset.yaml"

    def lacks(code: str, what: str, remedy: str, place: str = table) -> Finding:
        return Finding(code, "missing", what, place, remedy)

    if is_servo(log):
        what = "no torques: the errors of the position servos are assessed instead"
        yield lacks("no_torque", what, "log currents, if the servos state them")
    elif not log.torque_kind:
        yield Finding("no_torque", "refused", "no torques are logged", table, "log torques or currents")
    elif not log.signed or motions[0].torque is None:
        what = "torques have no sign: they are not assessed"
        yield Finding("unsigned", "refused", what, table, "log signed currents or torques")
    if not log.of_role("validate"):
        what = "no motion has the role validate: `gap` refuses the log"
        yield lacks("no_validation", what, "withhold some", where)
    elif {m.kind for m in log.of_role("validate")} <= {m.kind for m in log.of_role("calibrate")}:
        what = "withheld motions are of the kind of the fitted ones: another use is not tested"
        yield lacks("same_kind", what, "withhold motions of another kind, such as pick and place", where)
    most = max(sum(m.same_as == name for m in motions) for name in {m.same_as for m in motions})
    if most < REPEATS:
        what = f"no motion is repeated{' three times' if most > 1 else ''}"
        what += ": the noise follows from residuals alone"
        yield lacks("no_repeat", what, "log one motion three times", where)
    short = [m.name for m in motions if m.time[-1] - m.time[0] < LENGTH]
    if len(motions) < MOTIONS or len(short) > len(motions) / 2:
        what = f"{len(motions)} motions, {len(short)} of them shorter than {LENGTH:g} s"
        yield lacks("few_motions", what, f"log {MOTIONS} motions or more of 10 to 20 s")
    still = [j.name for j in joints if j.fastest <= SLOW[0]]
    if still:
        what = f"{listed(still)} not moved: friction undetermined"
        yield lacks("resting", what, "move all joints")
    moved = [j for j in joints if j.name not in still]
    if slow := [j.name for j in moved if j.slow < CROSSINGS]:
        what = f"{listed(slow)}: less than {CROSSINGS:g} s slower than {SLOW[1]:g} rad/s"
        yield lacks("no_slow", what, "add a motion that reverses slowly")
    if slack := [j.name for j in moved if j.fastest < FAST]:
        yield lacks("no_fast", f"{listed(slack)}: never faster than {FAST:g} rad/s", "add a faster motion")
    if poses := [j.name for j in gravity_loaded(joints) if j.gravity[1] < LOADS * abs(j.gravity[0])]:
        what = f"{listed(poses)}: gravity loads them in one pose alone"
        yield lacks("one_pose", what, "move them in two poses or more")
    loads = [m.loaded for m in motions]
    changes = sum(a != b for a, b in pairwise(loads))
    if changes == 0:
        what = "all motions carry the payload" if all(loads) else "no motion carries a payload"
        yield lacks("no_loads", what, "log motions with and without a known payload, interleaved")
    elif changes == 1:
        what = "loaded motions come in one block: drift and payload are alike"
        yield lacks("load_order", what, "interleave motions with and without the payload")
    warm = warm_up(log)
    if np.isnan(warm):
        what = "no temperature: warm-up is assessed by time alone"
        yield lacks("no_temperature", what, "log `temperature_degC`")
    elif warm < WARM:
        yield lacks("no_warm_up", f"the temperature varies by {warm:.2g} K", f"log {WARM:g} K of warm-up")
    if motions[0].command is None:
        yield lacks("no_command", "no commands: tracking is not assessed", "log `command1_deg` ...")


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
        what = f"{joint.name} rests {np.degrees(mean):.2f} deg from its command ({low:.2f} to {high:.2f} in "
        what += f"{rested:.0f} s at rest)"
        if joint.name in loaded:
            what += f": it sags, gravity loads it with {joint.gravity[0]:.2g} N m on average"
        remedy = "use positions as readings, not commands; a larger gain of the servo reduces it"
        yield Finding("sag", "odd", what, table, remedy)


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
            what = f"{joint.name} is up to {np.degrees(beyond):.1f} deg beyond its range in the calibration"
            yield Finding("range", "odd", what, first, "is it the calibration of this log?")
    for other, theirs in by_file[1:]:
        for name, one, two in zip(names, servos, theirs, strict=True):
            steps = zero_shift(one, two)
            if abs(steps) > APART:
                turns = _whole(steps * STEP)
                what = f"at one pose {name} reads {np.degrees(steps * STEP):+.2f} deg ({steps:+g} steps)"
                what += f" more by {other} than by {first} (Feetech servos)" + (f": {turns}" if turns else "")
                remedy = "calibrate at the same middle pose, or import each log with its own calibration"
                yield Finding("zero", "odd", what, other, remedy)
