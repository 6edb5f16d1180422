"""What moves the points of a fitted arm beyond its parameters: errors that the stated uncertainty contains.

Three kinds, all independent: the functions of the model discrepancy, each with its variance; errors of the
stated masses; and an error of each coordinate that neither explains. Functions and masses also moved the
fitted parameters: with G the displacements of a point by unit errors, J those by the parameters, S their
covariance without these errors, and A what each error added to the parameters, a point has the covariance

    J S J' + (G - J A)(G - J A)' + s^2 1        (Kennedy and O'Hagan 2001; `estimate.discrepancy.stated`)

A compliance that is too small for masses that are too large deflects the arm as before: the uncertainty of
the point is less than that of the compliances.

A point at other poses is that of rows appended to the session (`posed_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from bayescal.assess.budget import MOST_DOF
from bayescal.assess.inputs import NOISE, READINGS, Basis
from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.write import appended
from bayescal.effects import Parameter
from bayescal.effects.gravity import masses
from bayescal.errors import BayescalError
from bayescal.estimate.discrepancy import MASSES, mixed, sized
from bayescal.estimate.families import compliant, families
from bayescal.model import ARM, Block, Model
from bayescal.model.equilibrium import settled_model


def no_masses() -> np.ndarray:
    """Mixing of no errors of masses."""
    return np.zeros((0, 0))


@dataclass(frozen=True)
class Unmodelled:
    """K functions of a discrepancy and L errors of masses, of unit variance, and an error of coordinates.

    Parameters
    ----------
    shifts : np.ndarray, shape (P, K + L)
        What each adds to the arm's parameters, SI.
    variances, dof : mapping
        Of the families of the discrepancy: variance, and its effective degrees of freedom.
    mixing : np.ndarray, shape (L, L)
        Makes the errors of masses of those of `effects.gravity`.
    excess, excess_dof : float
        m, standard deviation of the error of each coordinate, and its effective degrees of freedom.
    noise : mapping
        Of the groups of measurements: their noise, with the excess, over the stated one.
    by_noise : mapping
        Of the groups of noise: the covariance (P, P), SI, that it gives to the arm's parameters, and the
        effective degrees of freedom of its variance.
    """

    shifts: np.ndarray
    variances: Mapping[str, float] = field(default_factory=dict)
    dof: Mapping[str, float] = field(default_factory=dict)
    mixing: np.ndarray = field(default_factory=no_masses)
    excess: float = 0.0
    excess_dof: float = inf
    noise: Mapping[str, float] = field(default_factory=dict)
    by_noise: Mapping[str, tuple[np.ndarray, float]] = field(default_factory=dict)

    @classmethod
    def of(cls, basis: Basis) -> Unmodelled:
        """What a fit states."""
        stated = basis.stated
        arm = stated.plain.model.slices[ARM]
        names = stated.families
        biases = [np.sqrt(stated.variances[name]) * stated.slopes[name] for name in names]
        by = np.concatenate([*biases, stated.inputs.slopes @ stated.inputs.mixing], axis=1)
        to_arm = stated.plain.model.sd[:, None] * stated.limit[arm]
        by_noise: dict[str, tuple[np.ndarray, float]] = {}
        for p in basis.propagated:
            if p.input.group in (NOISE, READINGS):  # of one estimated variance, by `scale`
                slopes = to_arm @ p.by[stated.index]
                before, _ = by_noise.get(p.input.scale, (0.0, 0.0))
                by_noise[p.input.scale] = (before + slopes @ slopes.T, p.input.dof)
        return cls(
            to_arm @ by,
            {name: stated.variances[name] for name in names},
            {name: stated.dof[name] for name in names},
            stated.inputs.mixing if stated.inputs.names else no_masses(),
            basis.excess,
            basis.excess_dof,
            {group: float(k * np.sqrt(stated.white)) for group, k in stated.plain.weights.scale.items()},
            by_noise,
        )

    @classmethod
    def read(cls, record: Mapping[str, Any], parameters: int) -> Unmodelled:
        """From the entries of `record` in arm.json; None or missing where there is none."""
        nothing: dict[str, Any] = {"mixing": no_masses(), "shifts_si": no_masses(), "families": {}}
        of_masses = record.get("masses") or nothing
        of_discrepancy = record.get("discrepancy") or nothing
        each, dof = of_discrepancy["families"], of_discrepancy.get("unexplained_dof")
        shifts = [np.array(of["shifts_si"], float) for of in (of_discrepancy, of_masses)]
        return cls(
            np.concatenate([x.reshape(parameters, -1) for x in shifts], axis=1),
            {name: float(entry["variance"]) for name, entry in each.items()},
            {name: float(entry["dof"]) for name, entry in each.items()},
            np.array(of_masses["mixing"], float),
            1e-6 * of_discrepancy.get("unexplained_um", 0.0),
            inf if dof is None else float(dof),
            {group: float(scale) for group, scale in record.get("noise_scale", {}).items()},
            {
                group: (np.array(of["covariance_si"], float).reshape(parameters, -1), float(of["dof"]))
                for group, of in record.get("by_noise", {}).items()
            },
        )

    def record(self) -> dict[str, Any]:
        """The entries of arm.json."""
        count = self.shifts.shape[1] - len(self.mixing)
        each = {name: {"variance": self.variances[name], "dof": self.dof[name]} for name in self.variances}
        return {
            "masses": {"mixing": self.mixing.tolist(), "shifts_si": self.shifts[:, count:].tolist()}
            if len(self.mixing)
            else None,
            "discrepancy": {
                "families": each,
                "shifts_si": self.shifts[:, :count].tolist(),
                "unexplained_um": 1e6 * self.excess,
                "unexplained_dof": None if np.isinf(self.excess_dof) else self.excess_dof,
            },
            "noise_scale": dict(self.noise),
            "by_noise": {
                group: {"dof": dof, "covariance_si": covariance.tolist()}
                for group, (covariance, dof) in self.by_noise.items()
            },
        }

    def without(self, covariance: np.ndarray) -> np.ndarray:
        """A covariance (P, P) of the parameters without the part of these errors."""
        values, vectors = np.linalg.eigh(covariance - self.shifts @ self.shifts.T)
        return (vectors * np.maximum(values, 0.0)) @ vectors.T

    def errors(
        self, model: Model, values: np.ndarray, driven: Callable[[Parameter], Parameter] = lambda p: p
    ) -> tuple[Parameter, ...]:
        """The K + L errors as parameters with the name of their family, for the arm's values (P,).

        `driven` is as `Circumstance.driven`.

        Raises
        ------
        BayescalError
            If the functions are not those of the fit: a torque that varied there does not vary here.
        """
        around = model.scene.circumstances(model.scene.rows("calibrate"))
        every = []
        for family in families(around) if self.variances else ():
            if family.name in self.variances:
                every += [replace(p, name=family.name) for p in sized([family], self.variances)]
        if len(self.mixing):
            inputs = mixed(masses(compliant(around, model, values)), self.mixing)
            every += [replace(p, name=MASSES) for p in inputs]
        if len(every) != self.shifts.shape[1]:
            what = f"the model discrepancy has {len(every)} functions at these poses, and in the fit"
            remedy = "choose other poses, or repeat the fit with this version"
            raise BayescalError(f"{what} {self.shifts.shape[1]}", "arm.json", remedy)
        return tuple(map(driven, every))

    def noise_of(self, block: Block) -> np.ndarray:
        """Noise (C,), m or rad, of a residual of the rows of a block, as the fit found it."""
        if block.group in self.noise:
            return self.noise[block.group] * block.sigma
        return np.hypot(block.sigma, self.excess)

    def dof_of(
        self, total: np.ndarray, parts: Mapping[str, np.ndarray], by_parameters: np.ndarray
    ) -> np.ndarray:
        """Effective degrees of freedom (C,) of the variances `total` of C points (Welch and Satterthwaite).

        `parts` (C,) are the variances by family; those by noise follow from the derivatives of the points by
        the parameters, (C, 3, P). Certificates, priors and stated masses are known.
        """
        below = np.full(len(total), (3.0 * self.excess**2) ** 2 / self.excess_dof)
        for covariance, dof in self.by_noise.values():
            below += np.einsum("cip,pq,ciq->c", by_parameters, covariance, by_parameters) ** 2 / dof
        for name in parts.keys() & self.dof.keys():
            below += parts[name] ** 2 / self.dof[name]
        few = below > total**2 / MOST_DOF
        return np.divide(total**2, below, out=np.full(len(total), MOST_DOF), where=few)


MOVING = ("joint speed", "remaining motion")
"""Drivers that are zero for an arm that stands still."""


@dataclass(frozen=True)
class Circumstance:
    """C poses: the row of the session that each repeats, and what replaces its own values.

    `columns` has values (C, ...), or one for all, of columns by their name; one that the session lacks is
    not used. An arm that stands `still` has a speed only for its direction.
    """

    source: np.ndarray  # (C,) int
    columns: Mapping[str, Any]
    still: bool = True

    def again(self, some: np.ndarray, **columns: Any) -> Circumstance:
        """Some of the poses, with other values of columns."""
        mine = {name: x if np.ndim(x) == 0 else np.asarray(x)[some] for name, x in self.columns.items()}
        return Circumstance(self.source[some], mine | columns, self.still)

    def driven(self, m: Measurements, p: Parameter) -> Parameter:
        """A parameter of the session `m` with the poses appended, with the drivers that it has there.

        An event or a row number is that of the source rows; an arm that stands still does not move on.
        """
        if p.driver.kind == "event" or (p.driver.kind == "time" and m.time is None):
            return _driven(p, len(m.ids), self.source)
        return _driven(p, len(m.ids), None) if self.still and p.driver.kind in MOVING else p


def source_rows(
    dataset: Dataset, count: int, time: np.ndarray | float | None, row: str | int | None
) -> np.ndarray:
    """Rows (count,) whose state holds at times, s, or the row that is named; default: the last fitted row."""
    named, recorded = _row(dataset, row), dataset.measurements.time
    if time is None:
        return np.full(count, named)
    if not np.all(np.isfinite(time)):
        raise BayescalError("is not a finite number", "--at-time-s", "give a number of s")
    if recorded is None:
        raise BayescalError("the session records no time_s", "", "choose a row instead")
    order = np.argsort(recorded, kind="stable")
    times = np.broadcast_to(np.asarray(time, float), (count,))
    least, most = min(float(np.min(recorded)), 0.0), float(np.max(recorded))
    if np.any((times < least) | (times > most)):
        what = "is no time of the session: what changes with time is not known there"
        raise BayescalError(what, "--at-time-s", f"give {least:g} to {most:.6g} s")
    return order[np.maximum(np.searchsorted(recorded[order], times, side="right") - 1, 0)]


def state_row(dataset: Dataset, time: float | None = None, row: str | int | None = None) -> int:
    """Index of the row whose state holds at a time, s, or that is named; default: the last fitted row."""
    if time is not None and row is not None:
        raise BayescalError("a time and a row are given", "--at-time-s", "give one of them")
    return int(source_rows(dataset, 1, time, row)[0])


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


def posed_rows(model: Model, values: np.ndarray, poses: Circumstance) -> tuple[Model, np.ndarray]:
    """A model of the session with the rows of C poses appended, and these rows (C,).

    Parameters
    ----------
    model : Model
        In equilibrium (`standing_model`).
    values : np.ndarray, shape (P,)
        Deviations of its parameters, SI.
    poses : Circumstance
    """
    scene, count = model.scene, len(model.scene.q)
    rows = count + np.arange(len(poses.source))
    m = scene.dataset.measurements
    longer = appended(m, poses.source, poses.columns, [f"pose {k}" for k in rows])
    before = np.concatenate([np.arange(count), poses.source])
    stance = None if scene.stance is None else scene.stance.at_rows(before)
    posed = replace(scene, dataset=replace(scene.dataset, measurements=longer), stance=stance)
    return settled_model(model, posed, values, partial(poses.driven, m)), rows


def _driven(p: Parameter, count: int, source: np.ndarray | None) -> Parameter:
    """The parameter with drivers of some of the first `count` rows (or none: 0) in the rows behind them."""

    def driver(values: np.ndarray | float) -> np.ndarray | float:
        if np.ndim(values) == 0:
            return values
        fitted = np.asarray(values)[:count]
        more = np.zeros(len(np.asarray(values)) - count) if source is None else fitted[source]
        return np.concatenate([fitted, more])

    return replace(p, terms=tuple(replace(t, driver=driver(t.driver)) for t in p.terms))
