"""What the numbers of a joint log mean: the kind of its torques, their constants, units that are wrong."""

from dataclasses import replace
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.importing.joint_formats import DEG
from bayescal.importing.joint_rows import MOVING, Rows, speeds
from bayescal.statistics import rms

KINDS = ("motor", "current", "sensor")
U_CONSTANT = 0.1
"""Relative u of torque constants (assumed: tolerance of motors and gears)."""
BORNE = 0.02
"""Of the largest torque of a joint: what it must bear at rest to give the constant."""
FEW = 50
"""Rows in motion that give a constant."""
SLOPE = (0.8, 1.25)
"""Measured velocity over that of the positions: beyond, units or columns are wrong."""
STEPS = (5e-5, 0.5)
"""s, between rows: beyond, times are in another unit (assumed: logs have 2 Hz to 20 kHz)."""
FOLLOWS = (0.2, 5.0)
"""Change of the command over that of the position: beyond, a unit or joint is wrong (60 logs: 0.95 to 1)."""
SPAN = 0.2
"""s, of the changes that are compared with stated velocities (assumed: more than bursts of messages)."""
BEYOND = 0.2
"""rad: a joint is not so far beyond its limits, or units or joints are wrong (assumed)."""
LEAST = 0.035
"""rad: where no joint moves further, angles are probably in another unit."""
FULL = 2 * np.pi
"""Numbers of angles that are not larger are rad."""
NORMALISED = "normalised"
"""Unit of LeRobot's values from -100 to 100, the range of the joint as it was calibrated."""
TURN = 360 / 4096
"""deg, a step of a servo."""
ALIKE = 0.005
"""Relative difference of steps that are the same (a turn of 4095 steps in place of 4096, rounding)."""
EVEN = 0.1
"""Of a step: changes that are multiples of it are no further off (assumed: rounding to float32)."""
STATE = '`--torque "current: 11.4 11.4 9.9 ..."`'


def one_torque(rows: Rows, recorded: str, stated: str) -> tuple[Rows, dict[str, Any], tuple[str, ...]]:
    """The rows with one quantity of torque, what dataset.yaml says of it, and what was assumed."""
    velocity = speeds(rows.time, rows.cells["position"], rows.motion)
    kind, _, numbers = stated.partition(":")
    if kind not in ("", *KINDS):
        remedy = f"write motor, sensor, or {STATE} (N m/A of each joint)"
        raise BayescalError(f"`{kind}` is no kind of torque", "--torque", remedy)
    given = [k for k in ("torque", "current") if k in rows.cells]
    if not given:
        if stated:
            what = "the log has neither torques nor currents"
            raise BayescalError(what, "--torque", "remove it, or map them")
        if "command" in rows.cells:
            return rows, {}, ("no torques: commands are those of position servos (assumed), by their errors",)
        return rows, {}, ("no torques and no commands: the log cannot be diagnosed",)
    name = "torque" if "torque" in given and kind != "current" else given[-1]
    values = rows.cells[name]
    cells = {key: cell for key, cell in rows.cells.items() if key not in given}
    notes = [f"{other} is not used, {name} is" for other in given if other != name]
    if name == "current" and kind in ("motor", "sensor"):
        what = f"the log has currents, A, and no torques of a {kind}"
        raise BayescalError(what, "--torque", f"state their constants: {STATE}, or map torques, N m")
    current = kind == "current" or (kind == "" and "current" in (name, recorded))
    kind = kind or ("current" if current else recorded or "motor")
    said: dict[str, Any] = {"kind": kind, "referred_to": "joint", "sign": "joint"}
    if current:
        constants, how = torque_constants(rows, velocity, numbers, name)
        said |= {"constant_Nm_per_A": constants, "u_constant": U_CONSTANT}
        each = ", ".join(f"{c:g}" for c in constants)
        notes.append(f"torque constants {how}: {each} N m/A, u 10 % (assumed)")
    elif not stated:
        notes.append(f"torques: {kind}, N m at the joints (assumed; --torque states another kind)")
    moved = (velocity > MOVING).any(axis=0) & (velocity < -MOVING).any(axis=0)
    unsigned = bool(np.all(values >= 0) and moved.any() and values.any())
    if unsigned:
        values = values * np.array(said.pop("constant_Nm_per_A")) if current else values
        said |= {"sign": "none", "kind": "motor" if current else kind}
        notes.append("no torque is negative though joints move both ways: no sign, torque is not assessed")
    cells["magnitude" if unsigned else "current" if current else "torque"] = values
    return replace(rows, cells=cells), said, tuple(notes)


def torque_constants(rows: Rows, velocity: np.ndarray, numbers: str, name: str) -> tuple[list[float], str]:
    """Torque constants (n,), N m/A at the joints, stated or from targets of torque and current; how.

    `name`, "current" or "torque", is that of the currents: efforts are currents by convention alone.
    """
    n = velocity.shape[1]
    if numbers.strip():
        try:
            constants = [float(word) for word in numbers.replace(",", " ").split()]
        except ValueError:
            constants = []
        if len(constants) != n or not all(0 < c < np.inf for c in constants):
            what = f"'{numbers.strip()}' is not {n} positive numbers"
            raise BayescalError(what, "--torque", "write N m/A of each joint")
        return constants, "as stated"
    torque, current = rows.cells.get("target_torque"), rows.cells.get("target_current")
    if torque is None or current is None:
        what, remedy = "currents without torque constants", f"state them, N m/A at the joints: {STATE}"
        if name == "torque":
            what += ": efforts of this arm are currents, A, as its driver writes them"
            remedy += "; if they are in N m: --torque motor"
        raise BayescalError(what, "--torque", remedy)
    at_rest = (np.abs(velocity) < MOVING).all(axis=1)
    out = np.full(n, np.nan)
    held = torque[at_rest] if at_rest.sum() > 1 else np.zeros((1, n))
    bears = [j for j in range(n) if rms(held[:, j]) > BORNE * np.abs(torque[:, j]).max() > 0]
    for j in bears:
        m, i = torque[at_rest, j], current[at_rest, j]
        out[j] = m @ i / max(i @ i, 1e-30)
    for j in set(range(n)) - set(bears):
        out[j] = _in_motion(torque[:, j], current[:, j], velocity[:, j])
    if not np.all(out > 0):
        lost = listed([f"J{j + 1}" for j in range(n) if not out[j] > 0])
        words = " ".join(f"{c:.4g}" if c > 0 else "?" for c in out)
        remedy = f'state all, N m/A at the joints; the log gives `--torque "current: {words}"`'
        raise BayescalError(f"the log does not give the torque constants of {lost}", "--torque", remedy)
    how = "from target torque over target current at rest"
    if moving := [f"J{j + 1}" for j in range(n) if j not in bears]:
        how += f", of {', '.join(moving)}, which bear no torque at rest, in motion beside friction"
    return [float(f"{c:.4g}") for c in out], how


def _in_motion(torque: np.ndarray, current: np.ndarray, velocity: np.ndarray) -> float:
    """Torque constant, N m/A, of current = torque / constant + friction in motion; nan if undetermined."""
    go = np.abs(velocity) > MOVING
    if go.sum() < FEW or not torque.any():
        return np.nan
    friction = np.column_stack([np.ones(go.sum()), np.sign(velocity[go]), velocity[go]])
    both = np.column_stack([torque[go], current[go]])
    m, i = (both - friction @ np.linalg.lstsq(friction, both, rcond=None)[0]).T
    if rms(m) < BORNE * rms(torque[go]):
        return np.nan
    slope = m @ i / (m @ m)
    u = rms(i - slope * m) / np.sqrt(m @ m)
    return float(1 / slope) if slope > 0 and u < U_CONSTANT * slope / 2 else np.nan


def contradiction(rows: Rows, coupling: np.ndarray, limits: np.ndarray) -> str:
    """What contradicts the stated units or joints, in words; "" if nothing does."""
    position, stated = rows.cells["position"], rows.cells.get("velocity")
    step = float(np.median(np.diff(rows.time)))
    if not STEPS[0] < step < STEPS[1]:
        return f"a row each {step:.3g} s: is the unit of time right?"
    if stated is not None:
        took = np.diff(rows.time)[:, None]
        turned = np.cumsum(np.vstack([0 * stated[:1], 0.5 * (stated[1:] + stated[:-1]) * took]), axis=0)
        slopes = _slopes(rows, turned)
        wrong = [j for j, slope in enumerate(slopes) if not SLOPE[0] < slope < SLOPE[1]]
        if wrong:
            ratio = slopes[wrong[0]]
            words = {DEG: "velocities are in deg/s, not rad/s", 1 / DEG: "velocities are in rad/s, not deg/s"}
            hints = [text for factor, text in words.items() if SLOPE[0] < ratio / factor < SLOPE[1]]
            what = f"the velocity of J{wrong[0] + 1} is {ratio:.3g} times that of its positions and stamps"
            return f"{what}: {hints[0] if hints else 'are units, stamps and joints right?'}"
    for j, slope in enumerate(_slopes(rows, rows.cells["command"]) if "command" in rows.cells else ()):
        if not FOLLOWS[0] < slope < FOLLOWS[1]:
            what = f"the command of J{j + 1} changes {slope:.3g} times as much as its position"
            return f"{what}: are unit and joint of the commands right?"
    links = position @ coupling.T
    low, high = limits.T
    over = np.maximum(low - links.min(axis=0), links.max(axis=0) - high)
    if over.max() > BEYOND:
        j = int(np.argmax(over))
        span = f"{DEG * links[:, j].min():.4g} to {DEG * links[:, j].max():.4g} deg"
        what = f"J{j + 1} moves from {span}, {DEG * over[j]:.3g} deg beyond its limits"
        return f"{what}: are the unit and the order of joints right?"
    if 0 < (most := float(np.ptp(position, axis=0).max())) < LEAST:
        return f"no joint moves more than {DEG * most:.2g} deg: are angles in rad stated as deg?"
    return ""


def _slopes(rows: Rows, turned: np.ndarray) -> list[float]:
    """Changes of other angles (N, n) over those of the positions, by joint; 1 of joints that do not move.

    Of changes over `SPAN`, so that stamps may scatter, as those of reception do; none over missing rows.
    """
    step, position = float(np.median(np.diff(rows.time))), rows.cells["position"]
    wide = max(round(SPAN / step), 1)
    took = rows.time[wide:] - rows.time[:-wide]
    same = (rows.motion[wide:] == rows.motion[:-wide]) & (took < 2 * wide * step)
    moved, others = ((x[wide:] - x[:-wide])[same] for x in (position, turned))
    out = []
    for m, t in zip(moved.T, others.T, strict=True):
        go = np.abs(m) > max(10 * MOVING * SPAN, 0.3 * np.abs(m).max(initial=0.0))
        out.append(float(t[go] @ m[go] / (m[go] @ m[go])) if go.sum() > 10 else 1.0)
    return out


def misread(values: np.ndarray, unit: str) -> str:
    """What contradicts the unit of angles (N, n), as they are written, in words; "" if nothing does.

    Numbers of at most 2 pi are rad. The steps of servos are those of one turn: in deg they are alike, and in
    normalised values, where each joint has its own range, they differ.
    """
    most = float(np.nanmax(np.abs(values), initial=0.0))
    if unit == "deg" and 0 < most < FULL:
        return f"no angle is beyond {most:.2g} deg: are angles in rad stated as deg?"
    steps = [step for column in values.T if (step := _step(column)) > 0]
    if len(steps) < 2 or unit not in ("deg", NORMALISED):
        return ""
    alike = max(steps) < (1 + ALIKE) * min(steps)
    if unit == "deg" and not alike and min(steps) >= 200 / 4096 and most <= 100:
        text = f"{min(steps):.3g} to {max(steps):.3g}"
        return f"steps of the joints differ, {text} deg: are normalised values (-100 to 100) stated as deg?"
    if unit == NORMALISED and alike and abs(steps[0] / TURN - 1) < ALIKE:
        return f"all joints have steps of {steps[0]:.3g}, 4096 a turn of 360: are deg stated as {unit}?"
    return ""


def _step(column: np.ndarray) -> float:
    """The step of which all changes (N - 1,) of a column are multiples; 0 if there is none."""
    changes = np.abs(np.diff(column))
    changes = changes[changes > 1e-6 * max(float(np.nanmax(np.abs(column))), 1e-9)]
    if len(changes) < FEW:
        return 0.0
    small = changes[changes < 1.5 * changes.min()]
    step = float(np.mean(small))
    parts = changes[changes < 20.5 * step] / step
    return step if np.abs(parts - np.round(parts)).max() < EVEN and len(small) >= FEW // 5 else 0.0
