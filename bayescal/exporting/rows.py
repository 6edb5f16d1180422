"""Poses as rows appended to a session, and the equilibrium of an arm under gravity in all its rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.append import appended
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.model import Model
from bayescal.model.equilibrium import settled_model

MOVING = ("joint speed", "remaining motion")
"""Drivers that are zero for an arm that stands still."""


@dataclass(frozen=True)
class Circumstance:
    """The state of C poses: the row of the session that each repeats, and values that replace its own."""

    source: np.ndarray  # (C,) int
    values: Mapping[str, Any]
    moves: bool  # whether the session records velocities

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        count: int,
        tool: str | None,
        payload_kg: np.ndarray | float,
        time: np.ndarray | float | None,
        row: str | int | None,
    ) -> Circumstance:
        """The state of `count` poses; arguments as of `FittedArm.at`."""
        for value, option, unit in ((payload_kg, "--payload-kg", "kg"), (time, "--at-time-s", "s")):
            if value is not None and not np.all(np.isfinite(value)):
                raise BayescalError("is not a finite number", option, f"give a number of {unit}")
        m = dataset.measurements
        values: dict[str, Any] = {}
        if m.payload is not None or np.any(payload_kg):
            values["payload"] = payload_kg
        if tool is not None:
            names = [t.name for t in dataset.tools]
            if tool not in names:
                raise BayescalError(f"there is no tool `{tool}`", "", f"tools: {', '.join(names)}")
            values["tool"] = names.index(tool)
        source = np.full(count, _row(dataset, row))
        if time is not None:
            if m.time is None:
                what = "the session records no time_s"
                raise BayescalError(what, "", "choose a row instead")
            at = np.broadcast_to(np.asarray(time, float), (count,))
            values["time"] = at
            order = np.argsort(m.time, kind="stable")
            source = order[np.maximum(np.searchsorted(m.time[order], at, side="right") - 1, 0)]
            if m.temperature is not None:
                values["temperature"] = np.interp(at, m.time[order], m.temperature[order])
        return cls(source, values, m.velocity is not None)

    def changed(self, readings: np.ndarray, direction: np.ndarray | None) -> dict[str, Any]:
        """Values that replace those of the rows, for readings (C, n) and a direction of their motion."""
        out = {**self.values, "readings": readings, "command": readings}
        if self.moves:
            out["velocity"] = np.zeros(readings.shape) if direction is None else np.asarray(direction, float)
        return out


def state_row(dataset: Dataset, time: float | None = None, row: str | int | None = None) -> int:
    """Index of the row whose state holds at a time, s, or that is named; default: the last fitted row."""
    if time is not None and row is not None:
        raise BayescalError("a time and a row are given", "--at-time-s", "give one of them")
    return int(Circumstance.of(dataset, 1, None, 0.0, time, row).source[0])


def _row(dataset: Dataset, row: str | int | None) -> int:
    """Index of a row by its id or index; the last row to fit by default."""
    m = dataset.measurements
    if row is None:
        return int(np.flatnonzero(m.role == "calibrate")[-1])
    if isinstance(row, str):
        if row not in m.ids:
            raise BayescalError(f"there is no row `{row}`", "measurements.csv", "give the id of a row")
        return m.ids.index(row)
    if not -len(m.ids) <= row < len(m.ids):
        raise BayescalError(f"there is no row {row}", "measurements.csv", f"it has {len(m.ids)} rows")
    return int(row) % len(m.ids)


def posed_rows(
    model: Model, values: np.ndarray, source: np.ndarray, changed: Mapping[str, Any], still: bool
) -> tuple[Model, np.ndarray]:
    """A model of the session with rows appended, and these rows (C,).

    Parameters
    ----------
    model : Model
        In equilibrium (`standing_model`).
    values : np.ndarray, shape (P,)
        Deviations of its parameters, SI.
    source : np.ndarray of int, shape (C,)
        The row that each new row repeats.
    changed : mapping
        New values of columns (C, ...), by their name.
    still : bool
        Whether the arm stands still in the new rows: then the speed has only a direction.
    """
    scene, count = model.scene, len(model.scene.q)
    rows = count + np.arange(len(source))
    m = scene.dataset.measurements
    dataset = replace(scene.dataset, measurements=appended(m, source, changed, [f"pose {k}" for k in rows]))
    stance = None if scene.stance is None else scene.stance.at(np.concatenate([np.arange(count), source]))

    own = driven_by(m, source, still)
    return settled_model(model, replace(scene, dataset=dataset, stance=stance), values, own), rows


def driven_by(m: Measurements, source: np.ndarray, still: bool) -> Callable[[Parameter], Parameter]:
    """What `posed_rows` makes of the drivers of a parameter of the session `m` with rows appended."""

    def own(p: Parameter) -> Parameter:
        """The parameter; the state of the source rows where its driver is an event or the row's number."""
        if p.driver.kind == "event" or (p.driver.kind == "time" and m.time is None):
            return _driven(p, len(m.ids), source)
        return _driven(p, len(m.ids), None) if still and p.driver.kind in MOVING else p

    return own


def _driven(p: Parameter, count: int, source: np.ndarray | None) -> Parameter:
    """The parameter with drivers of some of the first `count` rows (or none: 0) in the rows behind them."""

    def driver(values: np.ndarray | float) -> np.ndarray | float:
        if np.ndim(values) == 0:
            return values
        own = np.asarray(values)[:count]
        more = np.zeros(len(np.asarray(values)) - count) if source is None else own[source]
        return np.concatenate([own, more])

    return replace(p, terms=tuple(replace(t, driver=driver(t.driver)) for t in p.terms))
