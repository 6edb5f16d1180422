"""What a file holds of a fitted arm, and what it lacks.

A file of constant geometry holds displacements of frames, as frames of the joints at zero readings. The size
of what a file lacks is that at the poses of the session.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.chain import Robot, chain_of, displaced, frames, link_angles
from bayescal.arm.motion import CERTIFICATE, CONTACT, Term
from bayescal.arm.transforms import AXES, rigid
from bayescal.effects import ALWAYS, Parameter
from bayescal.exporting.written import Format, Item, item
from bayescal.fitted.arm import FittedArm
from bayescal.model import Model
from bayescal.storage.reading import table_beside

STATE = ("time", "temperature", "event")
"""Drivers whose value at one row of the session is a constant of the file."""


def changes(p: Parameter) -> bool:
    """Whether a constant parameter has another value in other rows: in time, or in other sessions."""
    return any(np.ndim(t.driver) for t in p.terms)


def constant(p: Parameter) -> bool:
    """Whether a parameter displaces frames of the arm by constants, at least in one state of the session."""
    if p.effect in ALWAYS or any(t.frame < 0 for t in p.terms):
        return False
    # of several sessions, each has a base of its own: its driver is 1 in the rows of its session
    fixed = p.driver.kind == "constant" and all(np.all(np.isin(t.driver, (0.0, 1.0))) for t in p.terms)
    return fixed or p.driver.kind in STATE or not changes(p)


def holds_constants(arm: FittedArm, k: int) -> bool:
    """Whether a file of constant geometry alone can hold a parameter."""
    return constant(arm.model.parameters[k])


def at_state(p: Parameter, state: int) -> Parameter:
    """A constant parameter with its drivers as they are in one row of the session."""

    def fixed(t: Term) -> Term:
        return t if np.ndim(t.driver) == 0 else replace(t, driver=float(np.asarray(t.driver)[state]))

    return replace(p, terms=tuple(map(fixed, p.terms)))


def constant_displacements(model: Model, values: np.ndarray, state: int | None = None) -> np.ndarray:
    """Constant displacements of the frames, (n + 2, 6), rad and m; the last, of the tool, are zero.

    Parameters
    ----------
    model : Model
    values : np.ndarray, shape (P,)
        Deviations of its parameters, SI.
    state : int, optional
        Row of the session whose state holds; without it, what changes during the session is left out.
    """
    n = model.scene.chain.n
    out = np.zeros((n + 2, 6))
    for value, p in zip(values, model.parameters, strict=True):
        if not constant(p) or (state is None and changes(p)):
            continue
        for t in p.terms if state is None else at_state(p, state).terms:
            if t.frame <= n:
                out[t.frame, AXES.index(t.axis)] += value * float(t.driver)
    return out


def transform_of(delta: np.ndarray, parts: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
    """Transform (4, 4) of some parts of a displacement (6,): 0 is Rz Tz, 1 Rx Tx, 2 Ry Ty."""
    selected = np.where(np.isin(np.arange(6) // 2, parts), delta, 0.0)
    corners = displaced(np.vstack([np.zeros(3), np.eye(3)]), selected)
    return rigid((corners[1:] - corners[0]).T, corners[0])


def zero_frames(robot: Robot, delta: np.ndarray | None = None) -> np.ndarray:
    """Frames 1 to n and the flange (n + 1, 4, 4) in F0, at zero readings, with displacements (n + 2, 6).

    Frame k turns about its z axis with joint k; it is behind the joint's offset and d, and carries the link.
    """
    moved = None if delta is None else delta[None]
    return frames(chain_of(robot), link_angles(robot, np.zeros((1, robot.n))), moved)[0, 1:]


def steps(frames_: np.ndarray, root: np.ndarray | None = None) -> np.ndarray:
    """Transforms (N, 4, 4) to the first of N frames from F0 (or a root in it), and from each to the next."""
    before = np.concatenate([(np.eye(4) if root is None else root)[None], frames_[:-1]])
    return np.linalg.inv(before) @ frames_


def carries(t: Term) -> int:
    """Number (from 0) of the step that a displacement acts in: a frame's tilts are behind its joint."""
    behind = t.axis not in ("rz", "tz") or t.frame == 0
    return t.frame if behind else t.frame - 1


def items(arm: FittedArm, places: list[tuple[str, str]]) -> list[Item]:
    """All constant parameters that act in a step with a place (element, attribute) in the file."""
    constants = ((k, p) for k, p in enumerate(arm.model.parameters) if constant(p))
    acts = ((k, step) for k, p in constants for step in dict.fromkeys(map(carries, p.terms)))
    return [item(arm, k, *places[step]) for k, step in acts if step < len(places)]


def centre_in_frame(robot: Robot, delta: np.ndarray, k: int) -> np.ndarray:
    """Centre of mass of link `k` (from 0) in the frame of its joint, (3,), m; see `zero_frames`.

    In standard DH it is stated behind the whole row, with the displacements (n + 2, 6) of the joint's frame.
    Zero where it is not stated.
    """
    centre = np.zeros(3) if robot.centres_of_mass is None else robot.centres_of_mass[k]
    if robot.convention == "mdh" or robot.centres_of_mass is None:
        return centre
    behind = chain_of(robot).link[k + 1]
    centre = behind[:3, :3] @ centre + behind[:3, 3]
    return displaced(centre, np.where(np.arange(6) < 2, 0.0, delta[k + 1]))


def coupled(joint_from_reading: np.ndarray) -> list[str]:
    """A note where the joint values (n,) of a file are not the readings, but a matrix (n, n) times these."""
    note = "joint values of the file are joint_from_reading times the controller's readings (see the sidecar)"
    return [] if np.array_equal(joint_from_reading, np.eye(len(joint_from_reading))) else [note]


WHY = table_beside(__file__, "reasons.toml")
"""Why an effect is no constant of the arm, by the kind of its driver."""
NEGATIVE = "is negative: no spring turns against its torque"
PROBE, ARTEFACT = "belongs to the probe, not to the arm", "belongs to the artefact, not to the arm"


@dataclass(frozen=True)
class Missing:
    """A part of the model that a file does not hold; m, `nan` where it moves no TCP."""

    effect: str
    why: str
    rms: float
    maximum: float
    parameters: tuple[str, ...]


def not_expressed(arm: FittedArm, format_: Format, state: int) -> tuple[tuple[Missing, ...], Missing]:
    """Effects, or parts of them, that a file does not hold, and all of them together.

    Parameters
    ----------
    arm : FittedArm
    format_ : Format
    state : int
        Row of the session whose state the file holds.

    Returns
    -------
    tuple
        By effect, and the total: lengths of the displacements of TCP positions in the rows of the session
        that are no outliers.
    """
    model, parameters = arm.model, arm.model.parameters
    held = np.array([p.effect in ALWAYS or format_.holds(arm, k) for k, p in enumerate(parameters)], bool)
    each = zip(parameters, held, strict=True)
    kept = tuple(at_state(p, state) if h and constant(p) else p for p, h in each)
    rows = np.flatnonzero(~np.isin(arm.dataset.measurements.ids, arm.rejected))
    full = _points(model, parameters, arm.values, rows)
    negative = [p.positive and p.nominal + v < 0 for p, v in zip(parameters, arm.values, strict=True)]
    upright = replace(arm, values=np.where(negative, -arm.values, arm.values))
    out = []
    for effect in dict.fromkeys(p.effect for p in parameters):
        of_effect = np.array([p.effect == effect for p in parameters])
        lost = of_effect & ~held
        here = [parameters[k] for k in np.flatnonzero(of_effect & held)]
        frozen = tuple(p.name for p in here if constant(p) and changes(p))
        names = tuple(parameters[k].name for k in np.flatnonzero(lost))
        if not names and not frozen:
            continue
        mixed = tuple(k if o else p for p, k, o in zip(parameters, kept, of_effect, strict=True))
        off = full - _points(model, mixed, np.where(lost, 0.0, arm.values), rows)
        size = _lengths(off) if not _elsewhere(parameters, lost) else _at_contact(arm, lost, rows)
        why = "changes during the session: the file has one state"
        if names:
            spring = any(format_.holds(upright, int(k)) for k in np.flatnonzero(lost))
            why = NEGATIVE if spring else _why(parameters, lost, format_)
        out.append(Missing(effect, why, *size, names or frozen))
    total = full - _points(model, kept, np.where(held, arm.values, 0.0), rows)
    every = tuple(name for m in out for name in m.parameters)
    return tuple(out), Missing("all", "", *_lengths(total), every)


def _points(
    model: Model, parameters: tuple[Parameter, ...], values: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """TCP positions (3, C) with the drivers of some parameters, at gravity moments of the complete model."""
    return replace(model, parameters=parameters, blocks=(), constraints=()).motion(rows).points(values)


def _lengths(off: np.ndarray) -> tuple[float, float]:
    """RMS and maximum of the lengths of vectors (3, C)."""
    square = np.sum(off**2, axis=0)
    return float(np.sqrt(np.mean(square))), float(np.sqrt(np.max(square, initial=0.0)))


def _elsewhere(parameters: Sequence[Parameter], lost: np.ndarray) -> bool:
    """Whether all lost parameters act at the contact or on a certificate, not on the arm."""
    frames = [t.frame for p, off in zip(parameters, lost, strict=True) if off for t in p.terms]
    return bool(frames) and all(frame in (CONTACT, CERTIFICATE) for frame in frames)


def _at_contact(arm: FittedArm, lost: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """RMS and maximum of what lost parameters change at the contacts, m; nan if they change no contact."""
    index, drivers = arm.model.driven(CONTACT, ("normal",), len(arm.model.scene.q))
    changed = lost[index]
    if not np.any(changed):
        return float("nan"), float("nan")
    off = arm.values[index[changed]] @ drivers[changed, 0][:, rows]
    return _lengths(off[None])


def _why(parameters: Sequence[Parameter], lost: np.ndarray, format_: Format) -> str:
    first = next(p for p, off in zip(parameters, lost, strict=True) if off)
    frames = {t.frame for t in first.terms}
    if CERTIFICATE in frames or first.driver.kind == "face":
        return ARTEFACT
    if CONTACT in frames:
        return PROBE
    reason = WHY.get(first.driver.kind, "")
    return f"{reason}; {format_.limits}" if reason else format_.limits
