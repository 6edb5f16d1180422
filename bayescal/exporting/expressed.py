"""What a file cannot hold of a fitted arm, and its size at the poses of the session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.motion import CERTIFICATE, CONTACT
from bayescal.effects import Parameter
from bayescal.effects.tool import TOOL
from bayescal.exporting.geometry import at_state, changes, constant
from bayescal.exporting.written import Format
from bayescal.fitted.arm import FittedArm
from bayescal.model import Model

WHY = {
    "torque": "depends on the gravity torque",
    "bending moment": "depends on the gravity moment of the link",
    "base moment": "depends on the gravity moment on the base",
    "mass": "acts through the compliances",
    "angle": "varies with the angle of a joint",
    "reading": "varies with the reading",
    "direction": "depends on the direction of motion",
    "flank": "depends on the direction of motion and the gravity torque",
    "joint speed": "depends on the speed of a joint",
    "remaining motion": "depends on the remaining motion",
}
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
    held = np.array([p.effect == TOOL.name or format_.holds(arm, k) for k, p in enumerate(parameters)], bool)
    kept = tuple(
        at_state(p, state) if h and constant(p) else p for p, h in zip(parameters, held, strict=True)
    )
    rows = np.flatnonzero(~np.isin(arm.dataset.measurements.ids, arm.rejected))
    full = _points(model, parameters, arm.values, rows)
    negative = [p.positive and p.nominal + v < 0 for p, v in zip(parameters, arm.values, strict=True)]
    upright = replace(arm, values=np.where(negative, -arm.values, arm.values))
    out = []
    for effect in dict.fromkeys(p.effect for p in parameters):
        own = np.array([p.effect == effect for p in parameters])
        lost = own & ~held
        frozen = tuple(
            p.name for p, h in zip(parameters, own & held, strict=True) if h and constant(p) and changes(p)
        )
        names = tuple(p.name for p, off in zip(parameters, lost, strict=True) if off)
        if not names and not frozen:
            continue
        mixed = tuple(k if o else p for p, k, o in zip(parameters, kept, own, strict=True))
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
    index, drivers = arm.model.driven(CONTACT, "normal", len(arm.model.scene.q))
    own = lost[index]
    if not np.any(own):
        return float("nan"), float("nan")
    off = arm.values[index[own]] @ drivers[own][:, rows]
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
