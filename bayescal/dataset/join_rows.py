"""The rows of several sessions, one session after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from bayescal.dataset.types import Dataset, Measurements

PAUSE = 3600.0
"""s between the clocks of two sessions, which is unknown (assumed)."""
NAMED = ("stop", "repeat")
"""Columns of labels, called by their session."""
EMPTY: Mapping[str, float] = {
    "velocity": 0.0,
    "payload": 0.0,
    "xyz": np.nan,
    "rpy": np.nan,
    "length": np.nan,
    "u": np.nan,
}
"""What a session without an optional column has in it: what the reader makes of empty cells."""


def called(session: Dataset, name: str) -> str:
    """The name that something of a session has among those of others."""
    return f"{session.name}:{name}"


def column(session: Dataset, name: str, width: tuple[int, ...] = ()) -> np.ndarray:
    """A copy of an optional column (N, *width), or what stands for a missing one."""
    m = session.measurements
    given = getattr(m, name)
    return np.full((len(m.ids), *width), EMPTY[name]) if given is None else np.array(given)


def _telling(sessions: Sequence[Dataset]) -> list[Dataset]:
    """The sessions whose temperature may drive the arm; where none does, those that record an artefact's."""
    recorded = [s for s in sessions if s.measurements.temperature is not None]
    return [s for s in recorded if s.temperature_of != "artefact"] or recorded


def temperature_of(sessions: Sequence[Dataset]) -> str | None:
    """What the temperatures of the rows joined are of."""
    return next((s.temperature_of for s in _telling(sessions)), None)


def measurements(
    sessions: Sequence[Dataset], u: Sequence[np.ndarray], tool_of: Sequence[np.ndarray]
) -> Measurements:
    """All rows, session after session."""
    before = np.cumsum([0, *(len(s.targets) for s in sessions[:-1])])
    own = [s.measurements for s in sessions]
    columns: dict[str, Any] = {
        "ids": tuple(called(s, name) for s in sessions for name in s.measurements.ids),
        "target": np.concatenate([m.target + at for m, at in zip(own, before, strict=True)]),
        "tool": np.concatenate([index[m.tool] for m, index in zip(own, tool_of, strict=True)]),
        "u": None if all(np.isnan(values).all() for values in u) else np.concatenate(list(u)),
        "time": _clock(own),
        "temperature": _temperature(sessions),
    }
    for field in fields(Measurements):
        name = field.name
        if name in columns:
            continue
        given = [getattr(m, name) for m in own]
        known = next((values for values in given if values is not None), None)
        if known is None:
            columns[name] = None
        elif name in NAMED:
            columns[name] = np.concatenate([_labels(s, name) for s in sessions])
        elif name in EMPTY:
            columns[name] = np.concatenate([column(s, name, known.shape[1:]) for s in sessions])
        else:  # a column that no value stands for counts only where every session has it
            columns[name] = None if any(values is None for values in given) else np.concatenate(given)
    return Measurements(**columns)


def _labels(session: Dataset, name: str) -> np.ndarray:
    """Stops or repeats (N,), called by their session; "" where there are none."""
    labels = getattr(session.measurements, name)
    if labels is None:
        return np.full(len(session.measurements.ids), "")
    return np.array([called(session, str(label)) if label else "" for label in labels])


def _clock(own: Sequence[Measurements]) -> np.ndarray | None:
    """Times (N,), s: those of each session after those of the one before; of one without, one moment."""
    if all(m.time is None for m in own):
        return None
    out: list[np.ndarray] = []
    end = 0.0
    for m in own:
        time = np.zeros(len(m.ids)) if m.time is None else m.time
        out.append(time + (end + PAUSE - min(0.0, float(time.min())) if out else 0.0))
        end = float(out[-1].max())
    return np.concatenate(out)


def _temperature(sessions: Sequence[Dataset]) -> np.ndarray | None:
    """Temperatures (N,), degC, of arm or air; a session without any stays at the mean of the others."""
    known = {s.name: s.measurements.temperature for s in _telling(sessions)}
    if not known:
        return None
    mean = float(np.mean(np.concatenate([values for values in known.values() if values is not None])))
    return np.concatenate(
        [known.get(s.name, np.full(len(s.measurements.ids), mean)) for s in sessions],
    )
