"""A fitted arm that can be evaluated at any pose, with all its fitted effects.

A pose is a row appended to the session in which the arm was fitted (`unmodelled.posed_rows`). The drivers of
its effects are therefore those of the model: gravity moments at the deflected pose, torques, angles,
direction of motion, payload, time. What a pose does not state is that of a row of the session, its *state*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.chain import frames
from bayescal.arm.motion import Motion
from bayescal.assess.inputs import Basis
from bayescal.dataset import Dataset
from bayescal.effects import ALWAYS, Parameter
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.solver import root
from bayescal.fitted import gate
from bayescal.fitted.gate import NOTHING, Use
from bayescal.fitted.unmodelled import Circumstance, Unmodelled, posed_rows, source_rows
from bayescal.model import ARM, USUAL, FitOptions, Model
from bayescal.model.equilibrium import standing_model
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import by_points

if TYPE_CHECKING:
    from bayescal.calibration import Fit
    from bayescal.gap.result import Gap

NOMINAL = "nominal"


@dataclass(frozen=True)
class Origin:
    """How an arm was fitted: what a refit repeats."""

    command: str = "fit"
    options: FitOptions = USUAL


@dataclass(frozen=True)
class Poses:
    """C poses of an arm, in F0, SI: rows (C,) of a model of its session, to which they are appended."""

    arm: FittedArm
    circumstance: Circumstance
    model: Model
    rows: np.ndarray

    @classmethod
    def of(cls, arm: FittedArm, circumstance: Circumstance) -> Poses:
        """The poses of an arm in a circumstance."""
        return cls(arm, circumstance, *posed_rows(arm.model, arm.values, circumstance))

    def again(self, some: np.ndarray | None = None, **columns: Any) -> Poses:
        """Some of the poses (all by default) with other values of columns of the measurements."""
        rows = np.arange(len(self.rows)) if some is None else some
        return Poses.of(self.arm, self.circumstance.again(rows, **columns))

    @cached_property
    def motion(self) -> Motion:
        """The motion of these rows, by deviations of the arm's P parameters."""
        return self.model.motion(self.rows)

    @property
    def readings(self) -> np.ndarray:
        """Readings (C, n), rad."""
        return self.model.scene.dataset.measurements.readings[self.rows]

    @cached_property
    def points(self) -> np.ndarray:
        """Positions (C, 3), m, of the tool."""
        return self.motion.points(self.arm.values).T

    @cached_property
    def flange(self) -> np.ndarray:
        """Poses (C, 4, 4) of the flange."""
        delta = self.motion.displacements(self.arm.values)
        delta[:, -1] = 0.0  # the tool's own offset
        return frames(self.model.scene.chain, self.model.scene.q[self.rows], delta)[:, -1]

    def tool_frames(self, axes: np.ndarray) -> np.ndarray:
        """Poses (C, 4, 4) of the frame of the tool, whose axes in the flange are (3, 3)."""
        out = self.flange.copy()
        out[:, :3, :3] = out[:, :3, :3] @ axes
        out[:, :3, 3] = self.points
        return out

    @cached_property
    def by_parameters(self) -> np.ndarray:
        """Derivatives of the points by the arm's parameters, (C, 3, P), SI, at constant gravity moments."""
        return slopes_of(self.motion, self.arm.values)

    @cached_property
    def errors(self) -> tuple[Parameter, ...]:
        """The K errors beyond the parameters, which move the points as well."""
        driven = partial(self.circumstance.driven, self.arm.dataset.measurements)
        return self.arm.beyond.errors(self.model, self.arm.values, driven)

    def slopes_with(self, further: Sequence[Parameter]) -> np.ndarray:
        """Derivatives (C, 3, P + K) by the parameters, and displacements, m, by the sd of K further ones."""
        wide = replace(self.model, parameters=(*self.model.parameters, *further))
        values = np.append(self.arm.values, np.zeros(len(further)))
        units = np.append(np.ones(len(self.arm.values)), [p.sd for p in further])
        return slopes_of(wide.motion(self.rows), values) * units

    @cached_property
    def by_all(self) -> np.ndarray:
        """Derivatives (C, 3, P + K) by the parameters, and displacements by the K unit errors."""
        return self.slopes_with(self.errors)

    @property
    def covariance(self) -> np.ndarray:
        """Stated covariance of each point, (C, 3, 3), m2."""
        return self.spread_by(self.by_all)

    def spread_by(self, by: np.ndarray) -> np.ndarray:
        """Covariance (C, 3, 3), m2, of points with derivatives (C, 3, P + K); see `by_all`."""
        errors = self.errors_by(by)
        return errors @ np.swapaxes(errors, -1, -2) + self.arm.beyond.excess**2 * np.eye(3)

    def errors_by(self, by: np.ndarray) -> np.ndarray:
        """Displacements (C, 3, P + K), m, by independent errors of unit variance that all points share."""
        by_parameters, by_errors = np.split(by, [len(self.arm.values)], axis=-1)
        beyond = by_errors - by_parameters @ self.arm.beyond.shifts
        return np.concatenate([by_parameters @ root(self.arm.spread), beyond], axis=-1)

    def dof_by(self, by: np.ndarray, total: np.ndarray) -> np.ndarray:
        """Effective degrees of freedom (C,) of the variances `total` (C,) of these points."""
        squares = np.sum(self.errors_by(by)[..., len(self.arm.values) :] ** 2, axis=1)
        names = np.array([p.name for p in self.errors], str)
        parts = {name: squares[:, names == name].sum(axis=1) for name in dict.fromkeys(names.tolist())}
        return self.arm.beyond.dof_of(total, parts, by[..., : len(self.arm.values)])


def slopes_of(motion: Motion, values: np.ndarray) -> np.ndarray:
    """Derivatives (C, 3, P) of the points of a motion by its parameters, at their values (P,), SI."""
    p = motion.points(values)
    if not p.shape[1]:
        return np.zeros((0, 3, len(values)))
    return np.transpose(by_points(motion, values, p), (2, 0, 1))


@dataclass(frozen=True)
class FittedArm:
    """A model with the values of its arm's parameters.

    Parameters
    ----------
    model : Model
        Of the session; its gravity moments are those of the arm as it stands for `values`.
    values : np.ndarray, shape (P,)
        Deviations from nominal, SI, in the order of `model.parameters`.
    covariance : np.ndarray, shape (P, P)
        Their stated covariance, with the model discrepancy.
    effects : tuple of str
        The model, in the form of ``--model``.
    states : mapping
        Displacement of each fitted target, SI, in the order of its kind's parts.
    rejected : tuple of str
        Rows of the session that the fit excluded, by their ids.
    origin : Origin
    use : Use
        What may be used of it: reasons against it, what a user should know, what was changed.
    unmodelled : Unmodelled, optional
        Errors beyond the parameters, of which the covariance has a part; default: none.
    solved : np.ndarray, shape (P, P), optional
        Covariance of the solver, without the discrepancy; None of an arm of an earlier version.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    effects: tuple[str, ...]
    states: Mapping[str, np.ndarray]
    rejected: tuple[str, ...] = ()
    origin: Origin = Origin()
    use: Use = NOTHING
    unmodelled: Unmodelled | None = None
    solved: np.ndarray | None = None

    @property
    def dataset(self) -> Dataset:
        """The session."""
        return self.model.scene.dataset

    def at(
        self,
        readings: np.ndarray,
        *,
        tool: str | None = None,
        payload_kg: np.ndarray | float = 0.0,
        direction: np.ndarray | None = None,
        time: np.ndarray | float | None = None,
        row: str | int | None = None,
    ) -> Poses:
        """TCP positions and flange of an arm that stands at any poses.

        Parameters
        ----------
        readings : np.ndarray, shape (C, n)
            rad, as the controller shows them.
        tool : str, optional
            Name; default: that of the state.
        payload_kg : float or np.ndarray, shape (C,)
            kg, beyond the tool.
        direction : np.ndarray, shape (n,) or (C, n), optional
            Sign of the motion of each reading before the pose; 0: in the middle of the lost motion.
        time : float or np.ndarray, shape (C,), optional
            s since the session began: the state is that of the last row before.
        row : str or int, optional
            id or index of the row whose state applies: time, temperature, events, tool; default:
            the last fitted row.

        Raises
        ------
        BayescalError
            For a tool or a row that the session does not have, or an arm without equilibrium under gravity.
        """
        readings, m = np.atleast_2d(np.asarray(readings, float)), self.dataset.measurements
        if not np.all(np.isfinite(payload_kg)):
            raise BayescalError("is not a finite number", "--payload-kg", "give a number of kg")
        if np.any(np.asarray(payload_kg) < 0):
            raise BayescalError("is negative", "--payload-kg", "give a mass of 0 or more")
        way = np.broadcast_to(0.0 if direction is None else np.asarray(direction, float), readings.shape)
        columns: dict[str, Any] = {"readings": readings, "command": readings, "velocity": way}
        if m.payload is not None or np.any(payload_kg):
            columns["payload"] = payload_kg
        if tool is not None:
            names = [t.name for t in self.dataset.tools]
            if tool not in names:
                raise BayescalError(f"there is no tool `{tool}`", "", f"tools: {', '.join(names)}")
            columns["tool"] = names.index(tool)
        source = source_rows(self.dataset, len(readings), time, row)
        if time is not None:
            columns["time"] = times = np.broadcast_to(np.asarray(time, float), (len(readings),))
            if m.time is not None and m.temperature is not None:
                order = np.argsort(m.time, kind="stable")
                columns["temperature"] = np.interp(times, m.time[order], m.temperature[order])
        return Poses.of(self, Circumstance(source, columns))

    def at_rows(self, rows: np.ndarray) -> Poses:
        """TCP positions and flange in rows (C,) of the session, with all that was measured there."""
        return Poses.of(self, Circumstance(np.asarray(rows, int), {}, still=False))

    @property
    def beyond(self) -> Unmodelled:
        """Errors beyond the parameters; none where the arm has none."""
        return self.unmodelled or Unmodelled(np.zeros((len(self.values), 0)))

    @cached_property
    def spread(self) -> np.ndarray:
        """Covariance (P, P) of the parameters without the part of these errors."""
        return self.covariance if self.unmodelled is None else self.unmodelled.without(self.covariance)

    @property
    def levels(self) -> tuple[str, ...]:
        """Model levels: nominal, the first effect, then each effect in addition to those before."""
        return (NOMINAL, *(name if k == 0 else f"+ {name}" for k, name in enumerate(self.effects)))

    def level(self, name: str) -> FittedArm:
        """The arm of a model level: parameters of further effects are at their nominal values.

        All levels have the fitted tool, except nominal.
        """
        if name not in self.levels:
            raise BayescalError(f"there is no level `{name}`", "", f"levels: {', '.join(self.levels)}")
        count = self.levels.index(name)
        used = {plain(e) for e in self.effects[:count]} | (set(ALWAYS) if count else set())
        return self.valued(np.where([p.effect in used for p in self.model.parameters], self.values, 0.0))

    def valued(self, values: np.ndarray) -> FittedArm:
        """The arm with other values (P,) of its parameters, in equilibrium."""
        return replace(self, model=standing_model(self.model, values), values=values)


def of_estimate(estimate: Estimate, covariance: np.ndarray, origin: Origin = Origin()) -> FittedArm:
    """The arm of an estimate; `covariance` (D, D) is the stated one of its z."""
    model = estimate.model
    arm = model.slices[ARM]
    values = model.deviations(estimate.z[arm])
    return FittedArm(
        standing_model(model, values),
        values,
        covariance[arm, arm] * np.outer(model.sd, model.sd),
        model.effects,
        {b.target: b.state(estimate.z[model.slices[b.target]]) for b in model.states},
        tuple(model.scene.dataset.measurements.ids[row] for row in estimate.rejected),
        origin,
    )


def of_basis(basis: Basis, origin: Origin = Origin()) -> FittedArm:
    """The arm of a fit with its stated uncertainty."""
    stated, model = basis.stated, basis.stated.plain.model
    solved = stated.plain.covariance[model.slices[ARM], model.slices[ARM]] * np.outer(model.sd, model.sd)
    arm = of_estimate(stated.plain, stated.limited, origin)
    return replace(arm, unmodelled=Unmodelled.of(basis), solved=solved)


def of_fit(fit: Fit) -> FittedArm:
    """The arm of a calibration."""
    return replace(of_basis(fit.basis, Origin("fit", fit.options)), use=gate.of_fit(fit))


def of_gap(gap: Gap, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """The arm of a diagnosis: its refit with the named effects that the validation data confirm.

    With `with_` or `without`, that of a fit with other effects; see `refitted`.
    """
    from bayescal.calibration import basis_of

    assert gap.arm is not None, "a diagnosis has its refit"
    origin = Origin("gap", replace(gap.options, without=gap.still_without))
    arm = replace(of_basis(basis_of(gap.arm, gap.options.seed), origin), use=gate.of_gap(gap))
    return refitted(arm, with_, without) if with_ or without else arm


def refitted(arm: FittedArm, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """Fit the session of an arm again, with further effects, or without some of its effects or their parts.

    Parameters
    ----------
    arm : FittedArm
    with_ : sequence of str
        Effects, in the form of ``--model``.
    without : sequence of str
        Effects of the model, or parts of them that stay nominal: 'geometry at joint 4'.

    Raises
    ------
    BayescalError
        If the model has an effect already, or does not have it, or the session cannot be fitted so.
    """
    from bayescal.calibration import fit

    names = [plain(name) for name in arm.effects]
    for name in with_:
        if plain(name) in names:
            raise BayescalError(f"the model has {plain(name)} already", f"--with {name}", "leave it out")
    whole = [name for name in without if name in names or name in arm.effects]
    effects = [name for name in arm.effects if name not in whole and plain(name) not in whole]
    options = arm.origin.options
    parts = (*options.omitted, *(name for name in without if name not in whole))
    calibration = fit(arm.dataset, (*effects, *with_), options, without=parts, samples=0)
    refit = of_fit(calibration)
    against = (*refit.use.against, *gate.not_gained(_gains(calibration, with_)))
    origin = Origin(arm.origin.command, calibration.options)
    return replace(refit, origin=origin, use=replace(refit.use, against=against))


def _gains(fit: Fit, names: Sequence[str]) -> list[tuple[str, float]]:
    """Gain of log density of the validation measurements, nats, by each of the last effects of a fit."""
    if not names:
        return []
    from bayescal.gap.search.gate import gain

    errors = [validation_errors(e.estimate, strict=False) for e in fit.levels[-len(names) - 1 :]]
    return [
        (name, gain(errors[0], less, more))
        for name, less, more in zip(names, errors, errors[1:], strict=False)
    ]
